"""Pictures: odd kinds, damaged ones, bombs, and sound ones that do not mean what they seem to."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lightmatrix.files.images import decode_image, encode_image

from .case import Case, Prepare, bear
from .checks import if_accepted, whole_matrix
from .put import both, chunk, endless_zeros, pipe, png, text
from .run import Limits, Ran
from .work import matrix

NEEDS = ("one.zarr", "scene.zarr", "photos", "projected", "shown.png", "lit")
GIB = 1 << 30
BYTES = np.random.default_rng(5).integers(0, 256, (8, 8), np.uint8)


def _scanned(pixels: np.ndarray) -> bytes:
    """Grey or colour pixels as the scan lines of a PNG file, none filtered."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1)
    return b"".join(b"\0" + row.tobytes() for row in rows)


def _tiff(pixels: np.ndarray = BYTES, **options: object) -> Prepare:
    return lambda folder: tifffile.imwrite(folder / "a.tif", pixels, **options) and None  # type: ignore[arg-type]


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


def _damaged() -> list[Case]:
    """tests/files/test_images.py has all kinds of pictures, read by the same function."""
    line = "relight one.zarr {} -o out.npy"
    interlaced = bytearray(png((8, 8), 8, 0, _scanned(BYTES)))
    interlaced[28] = 1
    interlaced[29:33] = struct.pack(">I", zlib.crc32(bytes(interlaced[12:29])))
    whose_tags = both(_tiff(), _set_tag("StripOffsets", 0))
    huge = both(_tiff(), _set_tag("ImageLength", 10**6))
    faults: dict[str, tuple[str, Prepare]] = {
        "a PNG that claims to be interlaced": ("a.png", text("a.png", bytes(interlaced))),
        "a TIFF whose tags are its pixels": ("a.tif", whose_tags),
        "a TIFF that claims a huge size": ("a.tif", huge),
        "a picture that is a pipe": ("a.png", pipe("a.png")),
    }
    return [Case(name, line.format(file), file, put) for name, (file, put) in faults.items()]


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
        "of 1-bit grey": (bomb(180000, 1, 0, 180000 * 22501), "a.png", 2),
        # More data than the size says: what is too much must not be inflated.
        "of 8 x 8 with 384 MiB of data": (bomb(8, 16, 2, 3 * GIB // 8), "a.png", 0),
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
        for file in (folder / "photos").glob("*.png"):
            bright = np.minimum(decode_image(file).astype(np.uint16) * 64, 4095)
            file.write_bytes(encode_image(bright.astype(np.uint16), "png"))

    def not_empty(folder: Path, ran: Ran) -> str | None:
        return None if whole_matrix(folder / "new.zarr").any() else "the estimate has no entries"

    def unit(folder: Path, ran: Ran) -> str | None:
        """The light of T is that of the truth, in the camera's unit."""
        ratio = whole_matrix(folder / "new.zarr").sum() / (float(matrix().sum()) * 0.8 * 0.95)
        return None if abs(ratio - 1) < 0.02 else f"T is {ratio:.3f} times what it should be"

    line = "estimate --patterns projected --no-coherent -o new.zarr --images"
    # The frames look dark, which is refused unless the clip level is stated.
    lit = f"{line} lit/images --black lit/black.png --clip 65535"
    check, words = if_accepted(not_empty), "levels of 12 bits in 16 without --clip"
    return [
        Case(words, f"{line} photos", "--clip", twelve_bits, (0, 2), check=check),
        Case("the unit of T under room light", lit, code=0, check=unit),
    ]


CASES = [*_damaged(), *_bombs(), *_meaning()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_images(case: Case, work: Path) -> None:
    bear(case, work)
