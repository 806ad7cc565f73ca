"""D2: odd kinds of images, and sound ones that do not mean what they seem to."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from lightmatrix.files.images import decode_image, encode_image

from ..case import Case, Prepare, Ran
from ..checks import if_accepted
from ..pictures import case, grey, levels, plain_png, scanned, set_tag
from ..put import array, both, chunk, copy, cut, flip, pipe, png, text
from ..zygote import run_command


def _written(name: str, **options: object) -> Prepare:
    return lambda folder: tifffile.imwrite(folder / name, levels(16), **options) and None  # type: ignore[arg-type]


def _encoded(name: str, pixels: np.ndarray) -> Prepare:
    def fault(folder: Path) -> None:
        Image.fromarray(pixels).save(folder / name)

    return fault


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
                case(
                    f"PNG of {depth} bits, {words}",
                    "a.png",
                    plain_png("a.png", depth, colour, channels),
                    # Opaque alpha is dropped; to refuse it by name is as good.
                    code=(0, 2) if colour in (4, 6) else 0,
                )
            )
    interlaced = bytearray(png((8, 8), 8, 0, scanned(levels(8))))
    interlaced[28] = 1
    interlaced[29:33] = struct.pack(">I", zlib.crc32(bytes(interlaced[12:29])))
    return [
        *cases,
        case(
            "PNG with a palette",
            "a.png",
            text("a.png", png((8, 8), 8, 3, scanned(index), chunk(b"PLTE", palette))),
        ),
        case("PNG that claims to be interlaced", "a.png", text("a.png", bytes(interlaced)), code=2),
        case("TIFF, plain", "a.tif", _written("a.tif"), code=0),
        case("TIFF, deflated", "a.tif", _written("a.tif", compression="zlib"), code=0),
        case("TIFF, big-endian", "a.tif", _written("a.tif", byteorder=">"), code=0),
        case(
            "TIFF, white is zero",
            "a.tif",
            lambda folder: tifffile.imwrite(
                folder / "a.tif", 65535 - levels(16), photometric="miniswhite"
            ),
            code=0,
        ),
        case(
            "TIFF with a palette",
            "a.tif",
            lambda folder: tifffile.imwrite(
                folder / "a.tif", index, photometric="palette", colormap=_colours(palette)
            ),
        ),
        case(
            "TIFF with strips of 0 bytes",
            "a.tif",
            both(_written("a.tif"), set_tag("a.tif", "StripByteCounts", 0)),
            code=2,
        ),
        case(
            "TIFF with strips beyond its end",
            "a.tif",
            both(_written("a.tif"), set_tag("a.tif", "StripOffsets", 10**6)),
            code=2,
        ),
        case(
            "TIFF with a strip too short",
            "a.tif",
            both(_written("a.tif"), set_tag("a.tif", "StripByteCounts", 40)),
            code=2,
        ),
        case(
            "TIFF whose tags are its pixels",
            "a.tif",
            both(_written("a.tif"), set_tag("a.tif", "StripOffsets", 0)),
            code=2,
        ),
        case(
            "TIFF that claims a huge size",
            "a.tif",
            both(_written("a.tif"), set_tag("a.tif", "ImageLength", 10**6)),
            code=2,
        ),
        case(
            "TIFF of signed numbers",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", levels(8).astype(np.int16)),
            code=2,
        ),
        case(
            "TIFF of complex numbers",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", grey(folder).astype(np.complex64)),
            code=2,
        ),
        case(
            "TIFF of two pages",
            "a.tif",
            lambda folder: tifffile.imwrite(folder / "a.tif", np.stack([levels(8)] * 2)),
            code=2,
        ),
        case(
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
        case("a TIFF called PNG", "a.png", both(_written("b.tif"), copy("b.tif", "a.png"))),
        case("a PNG called TIFF", "a.tif", both(plain_png("b.png"), copy("b.png", "a.tif"))),
        case("a PNG called npy", "a.npy", both(plain_png("b.png"), copy("b.png", "a.npy")), code=2),
        case("a GIF called PNG", "a.png", _renamed_gif),
        case("a BMP", "a.bmp", _encoded("a.bmp", levels(8)), code=0),
        case(
            "a BMP cut off", "a.bmp", both(_encoded("a.bmp", levels(8)), cut("a.bmp", 600)), code=2
        ),
        case(
            "a JPEG cut off", "a.jpg", both(_encoded("a.jpg", levels(8)), cut("a.jpg", 200)), code=2
        ),
    ]


def _colours(palette: bytes) -> np.ndarray:
    table = np.zeros((3, 256), np.uint16)
    table[:, :64] = np.frombuffer(palette, np.uint8).reshape(64, 3).T.astype(np.uint16) * 257
    return table


def _renamed_gif(folder: Path) -> None:
    (folder / "a.png").write_bytes(encode_image(levels(8), "gif"))


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
        case(f"npy {what}", "a.npy", array("a.npy", values), code=2)
        for what, values in wrong.items()
    ]
    header = b"\x93NUMPY\x01\x00v\x00"
    for what, shape in (("a huge size", "(99999999, 99999999)"), ("a negative size", "(-8, -8)")):
        words = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
        cases.append(
            case(
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
        case(f"npy {what}", "a.npy", array("a.npy", values), code=0)
        for what, values in fine.items()
    ]
    return [
        *cases,
        case(
            "npy with a damaged header",
            "a.npy",
            both(array("a.npy", picture), flip("a.npy", 0.03, 3)),
            code=2,
        ),
        case("npy cut off", "a.npy", both(array("a.npy", picture), cut("a.npy", 300)), code=2),
        case("npy of 0 bytes", "a.npy", text("a.npy", ""), code=2),
        case("a picture that is a pipe", "a.png", pipe("a.png"), code=2),
        case(
            "a picture that is a socket's name",
            "a.png",
            text("a.png", b"\x89PNG\r\n\x1a\n"),
            code=2,
        ),
    ]


def _meaning() -> list[Case]:
    """Frames that are sound, but do not mean what they seem to."""

    def twelve_bits(folder: Path) -> None:
        for file in sorted((folder / "photos").glob("*.png")):
            frame = decode_image(file).astype(np.uint16)
            bright = np.minimum(frame * 64, 4095).astype(np.uint16)
            file.write_bytes(encode_image(bright, "png"))

    def not_empty(folder: Path, ran: Ran) -> str | None:
        shown = run_command("info new.zarr --json", folder)
        return None if '"entries": 0,' not in shown.out else "the estimate has 0 entries"

    def unit(folder: Path, ran: Ran) -> str | None:
        """T in the camera's unit, whatever the room's light: the norm is that of the truth."""
        from ..checks import whole_matrix
        from ..work import matrix

        total = whole_matrix(folder / "new.zarr").sum()
        wanted = float(matrix().sum()) * 0.8 * 0.95
        ratio = total / wanted
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
            # The frames look dark, which is refused unless the clip level is stated.
            f"{folders} --images lit/images --black lit/black.png --clip 65535 -o new.zarr",
            code=0,
            needs=("lit",),
            check=unit,
        ),
    ]


# What its cases need of the work folder.
NEEDS = ("one.zarr", "scene.zarr", "photos", "projected", "shown.png")

CASES = [*_kinds(), *_arrays(), *_meaning()]
