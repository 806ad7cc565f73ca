"""Pictures with known pixels to put faults into, and whether they were read right."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile

from .case import Case, Prepare, Ran
from .checks import if_accepted
from .put import png, text

# The T of one.zarr is the identity, so that what `relight` writes is what was read of its picture.
LINE = "relight one.zarr {} -o out.npy"


def reads(name: str, wanted: Callable[[Path], np.ndarray]) -> Callable[[Path, Ran], str | None]:
    """The picture was read as it should be."""

    def check(folder: Path, ran: Ran) -> str | None:
        image = np.load(folder / "out.npy")
        error = float(np.abs(image - wanted(folder)).max())
        return None if error < 0.01 else f"{name} was read wrong by {error:.2g} of the range"

    return check


def grey(folder: Path) -> np.ndarray:
    """The picture that the faults are put into, in [0, 1]; noise, so that every bit counts."""
    return np.random.default_rng(5).permutation(256)[:64].reshape(8, 8) / 255.0


def levels(depth: int) -> np.ndarray:
    """The same in levels."""
    return np.rint(grey(Path()) * (2**depth - 1)).astype(f"u{depth // 8}")


def scanned(pixels: np.ndarray) -> bytes:
    """Grey or colour pixels as the scan lines of a PNG file, none filtered."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1)
    return b"".join(b"\0" + row.tobytes() for row in rows)


def case(name: str, file: str, put: Prepare, *, code: int | tuple[int, ...] = (0, 2)) -> Case:
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


def plain_png(name: str, depth: int = 8, colour: int = 0, channels: int = 1) -> Prepare:
    """A PNG file of the picture, with that many equal channels; alpha is opaque."""
    pixels = np.repeat(levels(depth)[..., None], channels, axis=2)
    if colour in (4, 6):
        pixels[..., -1] = 2**depth - 1
    return text(name, png((8, 8), depth, colour, scanned(pixels)))


def set_tag(name: str, tag: str, value: int) -> Prepare:
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
