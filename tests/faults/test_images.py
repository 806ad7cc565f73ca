"""Pictures: odd kinds, damaged ones, bombs, and sound ones that do not mean what they seem to."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from lightmatrix.files.images import decode_image, encode_image

from .case import Case, Check, Prepare, bear
from .checks import if_accepted, whole_matrix
from .put import both, chunk, copy, cut, endless_zeros, pipe, png, text
from .run import Limits, Ran, run
from .work import matrix

NEEDS = ("one.zarr", "scene.zarr", "photos", "projected", "shown.png", "lit")
GIB = 1 << 30
# The picture that the faults are put into, in [0, 1]; noise, so that every bit counts.
GREY = np.random.default_rng(5).permutation(256)[:64].reshape(8, 8) / 255.0
BYTES, SHORTS = (np.rint(GREY * (2**depth - 1)).astype(f"u{depth // 8}") for depth in (8, 16))


def _case(name: str, file: str, put: Prepare, code: int | tuple[int, ...] = (0, 2)) -> Case:
    """A picture that is read right or refused by its name.

    The T of one.zarr is the identity, so that what `relight` writes is what was read.
    """

    def read_right(folder: Path, ran: Ran) -> str | None:
        error = float(np.abs(np.load(folder / "out.npy") - GREY).max())
        return None if error < 0.01 else f"{file} was read wrong by {error:.2g} of the range"

    says = file if code == 2 else ()
    line = f"relight one.zarr {file} -o out.npy"
    return Case(name, line, says, put, code=code, check=if_accepted(read_right))


def _scanned(pixels: np.ndarray) -> bytes:
    """Grey or colour pixels as the scan lines of a PNG file, none filtered."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1)
    return b"".join(b"\0" + row.tobytes() for row in rows)


def _png(name: str, depth: int = 8, colour: int = 0, channels: int = 1) -> Prepare:
    """A PNG file of the picture, with that many equal channels; alpha is opaque."""
    pixels = np.repeat((BYTES if depth == 8 else SHORTS)[..., None], channels, axis=2)
    if colour in (4, 6):
        pixels[..., -1] = 2**depth - 1
    return text(name, png((8, 8), depth, colour, _scanned(pixels)))


def _tiff(pixels: np.ndarray = SHORTS, name: str = "a.tif", **options: object) -> Prepare:
    return lambda folder: tifffile.imwrite(folder / name, pixels, **options) and None  # type: ignore[arg-type]


def _encoded(name: str) -> Prepare:
    return lambda folder: Image.fromarray(BYTES).save(folder / name)


def _set_tag(tag: str, value: int) -> Prepare:
    """One number of the first page of a.tif set."""

    def fault(folder: Path) -> None:
        with tifffile.TiffFile(folder / "a.tif") as tiff:
            held = tiff.pages.first.tags[tag]
            kind = tiff.byteorder + ("H" if int(held.dtype) == 3 else "I")
        with (folder / "a.tif").open("r+b") as opened:
            opened.seek(held.valueoffset)
            opened.write(struct.pack(kind, value % 65536 if kind.endswith("H") else value))

    return fault


def _kinds() -> list[Case]:
    # Entry 63 - i of the palette is the grey of pixel i.
    palette = np.stack([BYTES.ravel()[::-1]] * 3, axis=1).tobytes()
    index = np.arange(63, -1, -1, dtype=np.uint8).reshape(8, 8)
    colours = np.zeros((3, 256), np.uint16)
    colours[:, :64] = np.frombuffer(palette, np.uint8).reshape(64, 3).T.astype(np.uint16) * 257
    interlaced = bytearray(png((8, 8), 8, 0, _scanned(BYTES)))
    interlaced[28] = 1
    interlaced[29:33] = struct.pack(">I", zlib.crc32(bytes(interlaced[12:29])))
    with_palette = png((8, 8), 8, 3, _scanned(index), chunk(b"PLTE", palette))
    channels = {"grey": (0, 1), "colour": (2, 3), "grey, alpha": (4, 2), "colour, alpha": (6, 4)}
    tiffs: dict[str, tuple[Prepare, int | tuple[int, ...]]] = {
        "plain": (_tiff(), 0),
        "deflated": (_tiff(compression="zlib"), 0),
        "big-endian": (_tiff(byteorder=">"), 0),
        "white is zero": (_tiff(65535 - SHORTS, photometric="miniswhite"), 2),
        "with a palette": (_tiff(index, photometric="palette", colormap=colours), (0, 2)),
        "with strips of 0 bytes": (both(_tiff(), _set_tag("StripByteCounts", 0)), 2),
        "with strips beyond its end": (both(_tiff(), _set_tag("StripOffsets", 10**6)), 2),
        "with a strip too short": (both(_tiff(), _set_tag("StripByteCounts", 40)), (0, 2)),
        "whose tags are its pixels": (both(_tiff(), _set_tag("StripOffsets", 0)), 2),
        "that claims a huge size": (both(_tiff(), _set_tag("ImageLength", 10**6)), 2),
        "of signed numbers below zero": (_tiff(BYTES.astype(np.int16) - 300), 2),
        "of complex numbers": (_tiff(GREY.astype(np.complex64)), 2),
        "of two pages": (_tiff(np.stack([BYTES] * 2)), 2),
        "of 5 channels": (
            _tiff(np.stack([BYTES] * 5, 2), photometric="minisblack", planarconfig="contig"),
            2,
        ),
    }
    gif = text("a.png", encode_image(BYTES, "gif"))
    return [
        *(
            # Opaque alpha is dropped; to refuse it by name is as good.
            _case(
                f"PNG of {depth} bits, {words}",
                "a.png",
                _png("a.png", depth, colour, count),
                (0, 2) if colour in (4, 6) else 0,
            )
            for depth in (8, 16)
            for words, (colour, count) in channels.items()
        ),
        _case("PNG with a palette", "a.png", text("a.png", with_palette)),
        _case("PNG that claims to be interlaced", "a.png", text("a.png", bytes(interlaced)), 2),
        *(_case(f"TIFF, {words}", "a.tif", put, code) for words, (put, code) in tiffs.items()),
        _case("a TIFF called PNG", "a.png", both(_tiff(name="b.tif"), copy("b.tif", "a.png"))),
        _case("a PNG called TIFF", "a.tif", both(_png("b.png"), copy("b.png", "a.tif"))),
        _case("a PNG called npy", "a.npy", both(_png("b.png"), copy("b.png", "a.npy")), 2),
        _case("a GIF called PNG", "a.png", gif),
        _case("a BMP", "a.bmp", _encoded("a.bmp"), 0),
        _case("a BMP cut off", "a.bmp", both(_encoded("a.bmp"), cut("a.bmp", 600)), 2),
        _case("a JPEG cut off", "a.jpg", both(_encoded("a.jpg"), cut("a.jpg", 200)), 2),
        _case("a picture that is a pipe", "a.png", pipe("a.png"), 2),
    ]


def _bombs() -> list[Case]:
    """Small files of much data: refused in little memory."""

    def bomb(side: int, depth: int, colour: int, size: int) -> Prepare:
        def fault(folder: Path) -> None:
            header = png((side, side), depth, colour, b"")[:33]
            body = chunk(b"IDAT", endless_zeros(size)) + chunk(b"IEND", b"")
            (folder / "a.png").write_bytes(header + body)

        return fault

    def words(folder: Path) -> None:
        zeros = endless_zeros(GIB // 2)
        extra = chunk(b"zTXt", b"a\0\0" + zeros), chunk(b"iCCP", b"a\0\0" + zeros)
        (folder / "a.png").write_bytes(png((8, 8), 8, 0, _scanned(BYTES), *extra))

    def deflated(folder: Path) -> None:
        _tiff(np.zeros((8, 8), np.uint16), compression="zlib")(folder)
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            _set_tag(tag, 65535)(folder)

    cases = {
        "of 16-bit colour": (bomb(26000, 16, 2, 26000 * 156001), "a.png", 2),
        "of 16-bit grey": (bomb(46000, 16, 0, 46000 * 92001), "a.png", 2),
        "of 8-bit grey": (bomb(64000, 8, 0, 64000 * 64001), "a.png", 2),
        "of 1-bit grey": (bomb(180000, 1, 0, 180000 * 22501), "a.png", 2),
        # More data than the size says: what is too much must not be inflated.
        "of 8 x 8 with 768 MiB of data": (bomb(8, 16, 2, 3 * GIB // 4), "a.png", 0),
        "in its words": (words, "a.png", 0),
        "in TIFF": (deflated, "a.tif", 2),
    }
    as_black = "estimate --patterns projected --images photos --black a.png -o new.zarr"
    return [
        Case(
            f"a bomb {name}: {line.split()[0]}",
            line,
            f"{file}: announces" if code else (),
            put,
            code=code,
            limits=Limits(memory=GIB // 4),
        )
        for name, (put, file, code) in cases.items()
        for line in (f"relight scene.zarr {file} -o out.npy", as_black)[: 1 + ("bit" in name)]
    ]


def _meaning() -> list[Case]:
    """Frames that are sound, but do not mean what they seem to."""

    def twelve_bits(folder: Path) -> None:
        for file in sorted((folder / "photos").glob("*.png")):
            bright = np.minimum(decode_image(file).astype(np.uint16) * 64, 4095)
            file.write_bytes(encode_image(bright.astype(np.uint16), "png"))

    def not_empty(folder: Path, ran: Ran) -> str | None:
        shown = run("info new.zarr --json", folder)
        return None if '"entries": 0,' not in shown.out else "the estimate has 0 entries"

    def unit(folder: Path, ran: Ran) -> str | None:
        """T in the camera's unit, whatever the room's light: the norm is that of the truth."""
        ratio = whole_matrix(folder / "new.zarr").sum() / (float(matrix().sum()) * 0.8 * 0.95)
        return None if abs(ratio - 1) < 0.02 else f"T is {ratio:.3f} times what it should be"

    folders = "estimate --patterns projected --no-coherent -o new.zarr"
    without: Check = if_accepted(not_empty)
    return [
        Case(
            "12-bit levels in 16-bit files without --clip",
            f"{folders} --images photos",
            "--clip",
            twelve_bits,
            code=(0, 2),
            check=without,
        ),
        Case(
            "the unit of T under room light",
            # The frames look dark, which is refused unless the clip level is stated.
            f"{folders} --images lit/images --black lit/black.png --clip 65535",
            code=0,
            check=unit,
        ),
    ]


CASES = [*_kinds(), *_bombs(), *_meaning()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_images(case: Case, work: Path) -> None:
    bear(case, work)
