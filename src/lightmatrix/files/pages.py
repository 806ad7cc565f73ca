"""Files that hold several images: TIFF of several pages, npy and npz of (K, rows, cols[, 3]).

A page is opened when it is read, so that a stack may be larger than memory. Only npz files, which
may be compressed, are read at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import tifffile
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.images import as_image_error, as_stored, read_image
from lightmatrix.files.numpy_files import read_npy_header, read_npz
from lightmatrix.files.reading import check_image_size, regular_file
from lightmatrix.files.tiff import check_page, is_inverted, read_page, turned_back

# Endings of files that may hold several images, and their formats in words.
STACKS = (".tif", ".tiff", ".npy", ".npz")
STACK_FORMATS = "a TIFF of several pages, npy or npz"


class _Source(Protocol):
    """A file of several images, read one at a time."""

    @property
    def count(self) -> int:
        """Number of images."""

    def read(self, index: int) -> NDArray[Any]:
        """One image, not checked yet."""


@dataclass(frozen=True)
class Page:
    """One image, number `index` from 0, of a file that holds several."""

    file: Path
    index: int
    source: _Source = field(compare=False, repr=False)

    @property
    def name(self) -> str:
        """How messages distinguish it from other images of its file."""
        return f"{self.file.name}, image {self.index}"

    def __str__(self) -> str:
        return f"{self.file}, image {self.index}"

    def read(self) -> NDArray[Any]:
        """The image, as `read_image` returns one."""
        with as_image_error(str(self)):
            image = self.source.read(self.index)
        return as_stored(str(self), image)


def read_entry(entry: Path | Page, *, mosaic: bool = False) -> NDArray[Any]:
    """An image from a file of its own or from a stack; see `read_image`."""
    return entry.read() if isinstance(entry, Page) else read_image(entry, mosaic=mosaic)


def is_stack(path: str | Path) -> bool:
    """Whether a file is named like one that may hold several images."""
    return Path(path).suffix.lower() in STACKS


def holds_several(file: Path) -> bool:
    """Whether an image file holds several; False also of damaged ones, which say so when read."""
    try:
        if file.suffix.lower() == ".npy":
            with regular_file(file).open("rb") as stream:
                shape = read_npy_header(stream).shape
            return len(shape) == 4 or (len(shape) == 3 and shape[-1] > 4)
        with tifffile.TiffFile(file) as tiff:
            return len(tiff.pages) > 1 or _contiguous(file) is not None
    # Libraries raise nearly anything on damaged files.
    except Exception:
        return False


def pages(path: str | Path) -> list[Page]:
    """The images of a TIFF, npy or npz; a damaged page is noticed when it is read."""
    file = regular_file(path)
    suffix = file.suffix.lower()
    if suffix not in STACKS:
        raise InputError(f"{file}: is no stack of images", hint=f"give {STACK_FORMATS}")
    with as_image_error(str(file)):
        source: _Source
        if suffix == ".npz":
            source = _Array(_single_array(file))
        elif suffix == ".npy":
            source = _npy(file)
        else:
            source = _contiguous(file) or _tiff(file)
    return [Page(file, index, source) for index in range(source.count)]


@dataclass(frozen=True, eq=False)
class _Array:
    array: NDArray[Any]

    @property
    def count(self) -> int:
        return len(self.array)

    def read(self, index: int) -> NDArray[Any]:
        image: NDArray[Any] = self.array[index]
        return image


@dataclass(frozen=True, eq=False)
class _Mapped:
    """Images that follow each other in a file, uncompressed."""

    file: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    offset: int
    fortran: bool = False
    inverted: bool = False

    @property
    def count(self) -> int:
        return self.shape[0]

    def read(self, index: int) -> NDArray[Any]:
        order = "F" if self.fortran else "C"
        mapped = np.memmap(self.file, self.dtype, "r", self.offset, self.shape, order)  # type: ignore[call-overload]
        # A copy: the file must not stay open, and the image must not change with it.
        image = np.array(mapped[index])
        return turned_back(image) if self.inverted else image


@dataclass(frozen=True, eq=False)
class _TiffPages:
    """Pages of a TIFF file, each with its own description."""

    file: Path
    count: int

    def read(self, index: int) -> NDArray[Any]:
        with tifffile.TiffFile(self.file) as tiff:
            return read_page(self.file, tiff.pages[index].aspage(), index)


def _npy(file: Path) -> _Mapped:
    with file.open("rb") as stream:
        header = read_npy_header(stream)
        offset = stream.tell()
    if header.bytes != file.stat().st_size - offset:
        raise ValueError("its size does not fit its header")
    _check_shape(file, header.shape)
    return _Mapped(file, header.shape, header.dtype, offset, header.fortran)


def _tiff(file: Path) -> _TiffPages:
    with tifffile.TiffFile(file) as tiff:
        return _TiffPages(file, len(tiff.pages))


def _contiguous(file: Path) -> _Mapped | None:
    """Images after the description of a single one, as ImageJ and tifffile may write them."""
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        if len(tiff.pages) > 1 or not (tiff.is_imagej or tiff.is_shaped):
            return None
        series = tiff.series[0]
        if series.size == page.size:
            return None
        check_page(file, page)
        count, left = divmod(series.size, page.size)
        if series.dataoffset is None or left or series.dtype is None:
            raise ValueError("images that do not follow one another")
        dtype = series.dtype.newbyteorder(tiff.byteorder)
        shape = (count, *page.shape)
        _check_shape(file, shape)
        if series.dataoffset + series.size * dtype.itemsize > file.stat().st_size:
            raise ValueError("the file ends early")
        inverted = is_inverted(page)
        return _Mapped(file, shape, dtype, series.dataoffset, inverted=inverted)


def _single_array(file: Path) -> NDArray[Any]:
    """The one array of an npz file."""
    arrays = read_npz(file)
    if len(arrays) != 1:
        named = ", ".join(list(arrays)[:5]) or "nothing"
        raise InputError(
            f"{file}: holds {len(arrays)} arrays ({named})",
            hint="save one array of (K, rows, cols) in it, or give an npy file",
        )
    (array,) = arrays.values()
    _check_shape(file, array.shape)
    return array


def _check_shape(file: Path, shape: Sequence[int]) -> None:
    # A last axis of three means colours: no projector and no camera is three pixels wide.
    fits = (len(shape) == 3 and shape[-1] != 3) or (len(shape) == 4 and shape[-1] in (1, 3))
    if not fits or not shape[0]:
        raise InputError(
            f"{file}: holds an array of shape {tuple(shape)}, no stack of images",
            hint="give (K, rows, cols), or (K, rows, cols, 3) in colour",
        )
    check_image_size(file, shape[1:])
