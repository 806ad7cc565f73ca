"""Stacks of images, read one at a time: the files of a folder in natural order, or pages of one."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files import png
from lightmatrix.files.images import FORMATS, READABLE, is_grey
from lightmatrix.files.pages import STACK_FORMATS, Page, holds_several, is_stack, pages, read_entry
from lightmatrix.files.reading import regular_file
from lightmatrix.reprs import short_repr


def list_images(folder: str | Path) -> list[Path]:
    """The image files of a folder in natural order (frame 2 before frame 10), all of one format.

    Hidden files and others are ignored; broken links, pipes and devices with image names refused.
    """
    place = Path(folder)
    if not place.exists():
        raise InputError(f"{place}: no such folder", hint="check the name")
    if not place.is_dir():
        raise InputError(
            f"{place}: is a file, not a folder of images",
            hint=f"give the folder that holds it, or a stack: {STACK_FORMATS}",
        )
    files = [entry for entry in place.iterdir() if not entry.is_dir() and entry.name[0] != "."]
    images = sorted((file for file in files if file.suffix.lower() in READABLE), key=_natural)
    for file in images:
        # A link that leads nowhere is a missing frame, not a file to ignore.
        regular_file(file)
    if not images:
        other = sorted({file.suffix for file in files if file.suffix})
        only = f", only {', '.join(other)} files" if other else ""
        raise InputError(f"{place}: holds no images{only}", hint=f"convert them to {FORMATS}")
    suffixes = sorted({file.suffix.lower() for file in images})
    if len(suffixes) > 1:
        raise InputError(
            f"{place}: holds images of several formats ({', '.join(suffixes)})",
            hint="keep one image a frame, all in one format",
        )
    return images


def list_entries(source: str | Path) -> list[Path | Page]:
    """The images of a folder in natural order, or those of a file (or a folder's only file)."""
    place = Path(source)
    if is_stack(place) and not place.is_dir():
        return list(pages(place))
    files = list_images(place)
    if len(files) == 1 and is_stack(files[0]) and holds_several(files[0]):
        return list(pages(files[0]))
    return list(files)


def nonlinear_tag(path: str | Path | Page) -> str | None:
    """Why a file is probably not linear: "JPEG", "tagged sRGB", ... (not gamma 1), or None."""
    file = path.file if isinstance(path, Page) else Path(path)
    if file.suffix.lower() in (".jpg", ".jpeg"):
        return "JPEG"
    if file.suffix.lower() != ".png":
        return None
    try:
        chunks = png.read_chunks(file.read_bytes())
    except (ValueError, OSError):
        return None
    for name, words in ((b"sRGB", "tagged sRGB"), (b"iCCP", "tagged with a colour profile")):
        if name in chunks:
            return words
    if b"cICP" in chunks:
        return "tagged with a video colour space"
    gamma = chunks.get(b"gAMA", b"")
    if len(gamma) == 4 and (value := struct.unpack(">I", gamma)[0]) not in (0, 100000):
        return f"tagged with gamma {100000 / value:.2g}"
    return None


@dataclass(frozen=True)
class ImageStack:
    """Images of one shape and type, read one at a time."""

    # The files, or the pages of one, in the order of the frames.
    paths: tuple[Path | Page, ...]
    # (rows, cols) or (rows, cols, 3) of uint8, uint16 or float32.
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    # Read three equal channels, as in many grey cameras' JPEG files, as one channel.
    grey: bool = False
    # Read raw camera files as they are; see `read_image`.
    mosaic: bool = False

    __repr__ = short_repr

    @classmethod
    def open(
        cls, source: str | Path | Sequence[Path | Page], *, mosaic: bool = False
    ) -> ImageStack:
        """Open the images of a folder (natural order), of one file, or of a list (its order).

        Only the first image is checked now, the others when they are read.
        """
        paths = list_entries(source) if isinstance(source, (str, Path)) else list(source)
        if not paths:
            raise InputError("an empty list of images", hint="give at least one file")
        first = read_entry(paths[0], mosaic=mosaic)
        if first.ndim == 3 and _all_grey(paths):
            return cls(tuple(paths), first.shape[:2], first.dtype, True)
        return cls(tuple(paths), first.shape, first.dtype, mosaic=mosaic)

    @property
    def count(self) -> int:
        """Number of images K."""
        return len(self.paths)

    def read(self, index: int) -> NDArray[Any]:
        """Image number `index`, which must have the shape and type of the first one."""
        path = self.paths[index]
        image = read_entry(path, mosaic=self.mosaic)
        if self.grey:
            image = _one_channel(path, image)
        if image.shape != self.shape:
            raise InputError(
                f"{path}: is {_words(image.shape)}, but {self.paths[0].name} is "
                f"{_words(self.shape)}",
                hint="all images of a folder must have one size; move others elsewhere",
            )
        if image.dtype != self.dtype:
            raise InputError(
                f"{path}: is {image.dtype}, but {self.paths[0].name} is {self.dtype}",
                hint="save all images of a folder with the same bit depth",
            )
        return image

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return (self.read(index) for index in range(self.count))

    def name(self, index: int) -> str:
        """The file's name."""
        return self.paths[index].name

    def select(self, index: Sequence[int]) -> ImageStack:
        """The stack of the images with these indices."""
        return replace(self, paths=tuple(self.paths[i] for i in index))


def _all_grey(paths: Sequence[Path | Page]) -> bool:
    """Whether files of three channels are grey, by four of them; single levels do not count."""
    samples = [paths[k] for k in sorted({0, len(paths) // 3, 2 * len(paths) // 3, len(paths) - 1})]
    varied = 0
    for path in samples:
        try:
            image = read_entry(path)
        except InputError:
            # Reading it in its turn names the damage.
            return False
        if image.ndim != 3 or not is_grey(image):
            return False
        varied += bool(np.ptp(image) > 0)
    return varied > len(samples) // 2


def _one_channel(path: Path | Page, image: NDArray[Any]) -> NDArray[Any]:
    """A grey image stored in one or three channels as one."""
    if image.ndim == 2:
        return image
    if not is_grey(image):
        raise InputError(
            f"{path}: is in colour, but other images of the folder are grey in three channels",
            hint="save all of them in grey, or all in colour",
        )
    return np.ascontiguousarray(image[..., 0])


def _words(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]}" + (f" with {shape[2]} channels" if len(shape) == 3 else "")


def _natural(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    # Only ASCII digits count: Python takes a superscript two for a digit, too.
    parts = re.split(r"([0-9]+)", path.name.casefold())
    key = [(0, int(p), "") if p[0] in "0123456789" else (1, 0, p) for p in parts if p]
    return key, path.name
