"""D2 and D3: damaged images, odd kinds of images, and images that are bombs."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import tifffile

from ..case import Case, Limits, Prepare, Ran
from ..checks import every, if_accepted, within
from ..put import array, both, chunk, copy, cut, endless_zeros, flip, pipe, png, text
from ..zygote import run_command

# The T of one.zarr is the identity, so that what `relight` writes is what was read of its picture.
LINE = "relight one.zarr {} -o out.npy"
GIB = 1 << 30


def reads(name: str, wanted: Callable[[Path], np.ndarray]) -> Callable[[Path, Ran], str | None]:
    """The picture was read as it should be."""

    def check(folder: Path, ran: Ran) -> str | None:
        found = np.load(folder / "out.npy")
        error = float(np.abs(found - wanted(folder)).max())
        return None if error < 0.01 else f"{name} was read wrong by {error:.2g} of the range"

    return check


def grey(folder: Path) -> np.ndarray:
    """The picture that the faults are put into, in [0, 1]; noise, so that every bit counts."""
    return np.random.default_rng(5).permutation(256)[:64].reshape(8, 8) / 255.0


def levels(depth: int) -> np.ndarray:
    """The same in levels."""
    return np.rint(grey(Path()) * (2**depth - 1)).astype(f"u{depth // 8}")


def _scanned(pixels: np.ndarray) -> bytes:
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1)
    return b"".join(b"\0" + row.tobytes() for row in rows)


def _written(name: str, **options: object) -> Prepare:
    return lambda folder: tifffile.imwrite(folder / name, levels(16), **options) and None  # type: ignore[arg-type]


def _encoded(name: str, pixels: np.ndarray, **options: object) -> Prepare:
    def fault(folder: Path) -> None:
        (folder / name).write_bytes(
            imageio.imwrite("<bytes>", pixels, extension=Path(name).suffix, **options)  # type: ignore[call-overload]
        )

    return fault


def _case(name: str, file: str, put: Prepare, *, code: int | tuple[int, ...] = (0, 2)) -> Case:
    """A picture that is read right or refused by its name."""
    codes = code if isinstance(code, tuple) else (code,)
    return Case(
        name,
        LINE.format(f"'{file}'"),
        () if 0 in codes else file,
        put,
        code=code,
        makes=("out.npy",),
        check=if_accepted(reads(file, grey)),
    )


def _plain_png(name: str, depth: int = 8, colour: int = 0, channels: int = 1) -> Prepare:
    pixels = np.repeat(levels(depth)[..., None], channels, axis=2)
    if colour in (4, 6):
        pixels[..., -1] = 2**depth - 1
    return text(name, png((8, 8), depth, colour, _scanned(pixels)))


def _kinds() -> list[Case]:
    # Entry 63 - i of the palette is the grey of pixel i.
    palette = np.stack([levels(8).ravel()[::-1]] * 3, axis=1).tobytes()
    index = np.arange(63, -1, -1, dtype=np.uint8).reshape(8, 8)
    cases = []
    for depth in (8, 16):
        for colour, channels, words in (
            *((0, 1, "grey"), (2, 3, "colour")),
            *((4, 2, "grey and alpha"), (6, 4, "colour and alpha")),
        ):
            cases.append(
                _case(
                    f"PNG of {depth} bits, {words}",
                    "a.png",
                    _plain_png("a.png", depth, colour, channels),
                    # Opaque alpha is dropped; to refuse it by name is as good.
                    code=(0, 2) if colour in (4, 6) else 0,
                )
            )
    interlaced = bytearray(png((8, 8), 8, 0, _scanned(levels(8))))
    interlaced[28] = 1
    interlaced[29:33] = struct.pack(">I", zlib.crc32(bytes(interlaced[12:29])))
    return [
        *cases,
        _case(
            "PNG with a palette",
            "a.png",
            text("a.png", png((8, 8), 8, 3, _scanned(index), chunk(b"PLTE", palette))),
        ),
        _case(
            "PNG with an index beyond its palette",
            "a.png",
            text("a.png", png((8, 8), 8, 3, _scanned(index), chunk(b"PLTE", palette[:30]))),
            code=2,
        ),
        _case("PNG said to be interlaced", "a.png", text("a.png", bytes(interlaced)), code=2),
        _case("TIFF, plain", "a.tif", _written("a.tif"), code=0),
        _case("TIFF, deflated", "a.tif", _written("a.tif", compression="zlib"), code=0),
        _case("TIFF, big-endian", "a.tif", _written("a.tif", byteorder=">"), code=0),
        _case(
            "TIFF, white is zero",
            "a.tif",
            lambda folder: tifffile.imwrite(
                folder / "a.tif", 65535 - levels(16), photometric="miniswhite"
            ),
            code=0,
        ),
        _case(
            "TIFF with a palette",
            "a.tif",
            lambda folder: tifffile.imwrite(
                folder / "a.tif", index, photometric="palette", colormap=_colours(palette)
            ),
        ),
        _case(
            "TIFF with strips of 0 bytes",
            "a.tif",
            both(_written("a.tif"), _tag("a.tif", "StripByteCounts", 0)),
            code=2,
        ),
        _case(
            "TIFF with strips beyond its end",
            "a.tif",
            both(_written("a.tif"), _tag("a.tif", "StripOffsets", 10**6)),
            code=2,
        ),
        _case(
            "TIFF with a strip too short",
            "a.tif",
            both(_written("a.tif"), _tag("a.tif", "StripByteCounts", 40)),
            code=2,
        ),
        _case(
            "TIFF whose tags are its pixels",
            "a.tif",
            both(_written("a.tif"), _tag("a.tif", "StripOffsets", 0)),
            code=2,
        ),
        _case(
            "TIFF that claims a huge size",
            "a.tif",
            both(_written("a.tif"), _tag("a.tif", "ImageLength", 10**6)),
            code=2,
        ),
        _case(
            "TIFF of signed numbers",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", levels(8).astype(np.int16)),
            code=2,
        ),
        _case(
            "TIFF of complex numbers",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", grey(folder).astype(np.complex64)),
            code=2,
        ),
        _case(
            "TIFF of two pages",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", np.stack([levels(8)] * 2)),
            code=2,
        ),
        _case(
            "TIFF of 5 channels",
            "a.tif",
            lambda folder: tifffile.imwrite(
                folder / "a.tif",
                np.stack([levels(8)] * 5, axis=2),
                photometric="minisblack",
                planarconfig="contig",
            ),
            code=2,
        ),
        _case("a TIFF called PNG", "a.png", both(_written("b.tif"), copy("b.tif", "a.png"))),
        _case("a PNG called TIFF", "a.tif", both(_plain_png("b.png"), copy("b.png", "a.tif"))),
        _case(
            "a PNG called npy", "a.npy", both(_plain_png("b.png"), copy("b.png", "a.npy")), code=2
        ),
        _case("a GIF called PNG", "a.png", _renamed_gif),
        _case("a BMP", "a.bmp", _encoded("a.bmp", levels(8)), code=0),
        _case(
            "a BMP cut off", "a.bmp", both(_encoded("a.bmp", levels(8)), cut("a.bmp", 600)), code=2
        ),
        _case(
            "a JPEG cut off", "a.jpg", both(_encoded("a.jpg", levels(8)), cut("a.jpg", 200)), code=2
        ),
    ]


def _colours(palette: bytes) -> np.ndarray:
    table = np.zeros((3, 256), np.uint16)
    table[:, :64] = np.frombuffer(palette, np.uint8).reshape(64, 3).T.astype(np.uint16) * 257
    return table


def _renamed_gif(folder: Path) -> None:
    stream = io.BytesIO()
    imageio.imwrite(stream, levels(8), extension=".gif")
    (folder / "a.png").write_bytes(stream.getvalue())


def _tag(name: str, tag: str, value: int) -> Prepare:
    """One number of a TIFF's first page set."""

    def fault(folder: Path) -> None:
        with tifffile.TiffFile(folder / name) as tiff:
            held = tiff.pages.first.tags[tag]
            place, order = held.valueoffset, tiff.byteorder
            short = int(held.dtype) == 3
        with (folder / name).open("r+b") as opened:
            opened.seek(place)
            opened.write(
                struct.pack(
                    order + ("H" if short else "I"),
                    value % 65536 if short else value,
                )
            )

    return fault


def _arrays() -> list[Case]:
    picture = grey(Path())
    wrong: dict[str, np.ndarray] = {
        "of 1e300": np.full((8, 8), 1e300),
        "with infinity": np.where(picture > 0.9, np.inf, picture),
        "with nan": np.where(picture > 0.9, np.nan, picture),
        "of objects": np.full((8, 8), None, object),
        "of text": np.full((8, 8), "a"),
        "of complex numbers": picture.astype(complex),
        "of dates": np.zeros((8, 8), "M8[s]"),
        "of int64": levels(8).astype(np.int64),
        "of records": np.zeros((8, 8), [("a", "f4"), ("b", "f4")]),
        "without any dimension": np.float32(0.5) * np.ones(()),
        "of one dimension": np.zeros(64, np.float32),
        "of five dimensions": np.zeros((1, 8, 8, 1, 1), np.float32),
        "of 0 rows": np.zeros((0, 8), np.float32),
        "of 7 channels": np.zeros((8, 8, 7), np.float32),
        "of negative light": -picture,
        "of light above 1": 2 * picture,
    }
    cases = [
        _case(f"npy {what}", "a.npy", array("a.npy", values), code=2)
        for what, values in wrong.items()
    ]
    header = b"\x93NUMPY\x01\x00v\x00"
    for what, shape in (("a huge size", "(99999999, 99999999)"), ("a negative size", "(-8, -8)")):
        words = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
        cases.append(
            _case(
                f"npy that claims {what}",
                "a.npy",
                text("a.npy", header + words.ljust(117).encode() + b"\n" + bytes(256)),
                code=2,
            )
        )
    fine = {
        "of float64": picture,
        "of float16": picture.astype(np.float16),
        "in Fortran order": np.asfortranarray(picture.astype(np.float32)),
        "big-endian": levels(16).astype(">u2"),
    }
    cases += [
        _case(f"npy {what}", "a.npy", array("a.npy", values), code=0)
        for what, values in fine.items()
    ]
    return [
        *cases,
        _case(
            "npy with a damaged header",
            "a.npy",
            both(array("a.npy", picture), flip("a.npy", 0.03, 3)),
            code=2,
        ),
        _case("npy cut off", "a.npy", both(array("a.npy", picture), cut("a.npy", 300)), code=2),
        _case("npy of 0 bytes", "a.npy", text("a.npy", ""), code=2),
        _case("a picture that is a pipe", "a.png", pipe("a.png"), code=2),
        _case(
            "a picture that is a socket's name",
            "a.png",
            text("a.png", b"\x89PNG\r\n\x1a\n"),
            code=2,
        ),
    ]


def _damaged() -> list[Case]:
    cases = []
    kinds = {"8": (8, 0, 1), "16": (16, 0, 1), "16 colour": (16, 2, 3)}
    for words, (depth, colour, channels) in kinds.items():
        data = len(png((8, 8), depth, colour, b""))
        put = _plain_png("a.png", depth, colour, channels)
        for share in (0.35, 0.5, 0.65, 0.8):
            cases.append(
                _case(
                    f"PNG of {words} bits, a bit flipped at {share}",
                    "a.png",
                    both(put, flip("a.png", share, 5)),
                )
            )
        cases.append(
            _case(
                f"PNG of {words} bits cut off", "a.png", both(put, cut("a.png", data + 10)), code=2
            )
        )
    pixels = _scanned(levels(8))
    sound = png((8, 8), 8, 0, pixels)
    two = sound[:33] + chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)) + sound[33:]
    bad_sum = bytearray(sound)
    bad_sum[-13] ^= 1
    more = {
        "with a wrong checksum": bytes(bad_sum),
        "with two headers": two,
        "without its end": sound[:-12],
        "with too few rows": png((8, 8), 8, 0, pixels[:36]),
        "with too many rows": png((8, 8), 8, 0, pixels * 2),
        "with an unknown filter": png((8, 8), 8, 0, b"\x09" + pixels[1:]),
        "of no pixels": png((0, 0), 8, 0, b""),
        "of 3 bits": png((8, 8), 3, 0, pixels),
        "of an unknown colour type": png((8, 8), 8, 5, pixels),
        "that claims 2^31 columns": png((8, 2**31 - 1), 8, 0, pixels),
        "of noise": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    }
    for words, data_bytes in more.items():
        strict = words not in ("without its end", "with too many rows", "with two headers")
        cases.append(
            _case(f"PNG {words}", "a.png", text("a.png", data_bytes), code=2 if strict else (0, 2))
        )
    return cases


def _bombs() -> list[Case]:
    quick = within(15)
    room = Limits(memory=GIB)

    def bomb(shape: tuple[int, int], depth: int, colour: int, channels: int) -> Prepare:
        def fault(folder: Path) -> None:
            size = shape[0] * (1 + shape[1] * channels * depth // 8)
            sound = png(shape, depth, colour, b"")
            body = sound[:33] + chunk(b"IDAT", endless_zeros(size)) + chunk(b"IEND", b"")
            (folder / "a.png").write_bytes(body)

        return fault

    cases = []
    for words, parts in {
        "16-bit colour": ((26000, 26000), 16, 2, 3),
        "16-bit grey": ((46000, 46000), 16, 0, 1),
        "8-bit grey": ((64000, 64000), 8, 0, 1),
        "1-bit": ((180000, 180000), 1, 0, 1),
    }.items():
        put = bomb(*parts)
        cases += [
            Case(
                f"a bomb, PNG of {words}, relit",
                "relight scene.zarr a.png -o out.npy",
                "a.png|memory",
                put,
                code=(2, 3),
                limits=room,
                check=quick,
            ),
            Case(
                f"a bomb, PNG of {words}, as black frame",
                "estimate --patterns projected --images photos --black a.png -o new.zarr",
                "a.png|memory",
                put,
                code=(2, 3),
                limits=room,
                check=quick,
            ),
        ]

    def small_claim(folder: Path) -> None:
        # More data than the size says: what is too much must not be inflated.
        sound = png((8, 8), 16, 2, b"")
        body = sound[:33] + chunk(b"IDAT", endless_zeros(3 * GIB)) + chunk(b"IEND", b"")
        (folder / "a.png").write_bytes(body)

    def deflated(folder: Path) -> None:
        tifffile.imwrite(folder / "a.tif", np.zeros((8, 8), np.uint16), compression="zlib")
        for tag, value in (("ImageWidth", 65535), ("ImageLength", 65535), ("RowsPerStrip", 65535)):
            _tag("a.tif", tag, value)(folder)

    cases += [
        Case(
            "a bomb, PNG of 8 x 8 with 3 GiB of data",
            "relight scene.zarr a.png -o out.npy",
            "a.png|memory",
            small_claim,
            code=(0, 2, 3),
            limits=room,
            check=quick,
        ),
        Case(
            "a bomb, TIFF",
            "relight scene.zarr a.tif -o out.npy",
            "a.tif|memory",
            deflated,
            code=(2, 3),
            limits=room,
            check=quick,
        ),
        Case(
            "a text chunk that is a bomb",
            "relight scene.zarr a.png -o out.npy",
            (),
            lambda folder: (folder / "a.png").write_bytes(
                png(
                    (8, 8),
                    8,
                    0,
                    _scanned(levels(8)),
                    chunk(b"zTXt", b"a\0\0" + endless_zeros(2 * GIB)),
                    chunk(b"iCCP", b"a\0\0" + endless_zeros(2 * GIB)),
                )
            ),
            code=(0, 2, 3),
            limits=room,
            check=every(quick),
        ),
    ]
    return cases


def _meaning() -> list[Case]:
    """Frames that are sound, but do not mean what they seem to."""

    def twelve_bits(folder: Path) -> None:
        for file in sorted((folder / "photos").glob("*.png")):
            frame = imageio.imread(file).astype(np.uint16)
            bright = np.minimum(frame * 64, 4095).astype(np.uint16)
            file.write_bytes(imageio.imwrite("<bytes>", bright, extension=".png"))

    def not_empty(folder: Path, ran: Ran) -> str | None:
        told = run_command("info new.zarr --json", folder)
        return None if '"entries": 0,' not in told.out else "the estimate has 0 entries"

    def unit(folder: Path, ran: Ran) -> str | None:
        """T in the camera's unit, whatever the room's light: the norm is that of the truth."""
        from ..checks import whole_matrix
        from ..work import matrix

        found = whole_matrix(folder / "new.zarr").sum()
        wanted = float(matrix().sum()) * 0.8 * 0.95
        ratio = found / wanted
        return None if abs(ratio - 1) < 0.02 else f"T is {ratio:.3f} times what it should be"

    folders = "estimate --patterns projected --no-coherent"
    return [
        Case(
            "12-bit levels in 16-bit files without --clip",
            f"{folders} --images photos -o new.zarr",
            "--clip",
            twelve_bits,
            code=(0, 2),
            check=if_accepted(not_empty),
        ),
        Case(
            "the unit of T under room light",
            # The frames are just dark, which is refused until it is said.
            f"{folders} --images lit/images --black lit/black.png --clip 65535 -o new.zarr",
            code=0,
            needs=("lit",),
            check=unit,
        ),
    ]


# What of the work folder its cases are given.
NEEDS = ("one.zarr", "scene.zarr", "photos", "projected", "shown.png")

CASES = [*_kinds(), *_arrays(), *_damaged(), *_bombs(), *_meaning()]
