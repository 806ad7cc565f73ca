"""Stacks of images, read one at a time: the files of a folder in natural order, or pages of one.

A file that holds several images is a TIFF of several pages, or npy or npz of (K, rows, cols[, 3]).
A page is opened when it is read, so that a stack may be larger than memory. Only npz files, which
may be compressed, are read at once.
"""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import InputError
from lightmatrix.files import images as image_files
from lightmatrix.files.numpy_files import map_npy, read_npz
from lightmatrix.files.reading import check_image_size, regular_file
from lightmatrix.paths import as_path
from lightmatrix.reprs import ShortRepr

tifffile = lazy_loader.load("tifffile")

# Endings of files that may hold several images, and their formats in words.
STACKS = (".tif", ".tiff", ".npy", ".npz")
STACK_FORMATS = "a TIFF of several pages, npy or npz"


@dataclass(frozen=True)
class Page:
    """One image, number `index` from 0, of a file that holds several."""

    file: Path
    index: int
    # Reads an image of the file by its number, and does not check it.
    reader: Callable[[int], NDArray[Any]] = field(compare=False, repr=False)

    @property
    def name(self) -> str:
        """How messages distinguish it from other images of its file."""
        return f"{self.file.name}, image {self.index}"

    def __str__(self) -> str:
        return f"{self.file}, image {self.index}"

    def read(self) -> NDArray[Any]:
        """The image, as `read_image` returns one."""
        with image_files.as_image_error(str(self)):
            image = self.reader(self.index)
        return image_files.as_stored(str(self), image)


def read_entry(entry: Path | Page, *, mosaic: bool = False) -> NDArray[Any]:
    """An image from a file of its own or from a stack; see `read_image`."""
    return entry.read() if isinstance(entry, Page) else image_files.read_image(entry, mosaic=mosaic)


def is_stack(path: str | Path) -> bool:
    """Whether a file is named like one that may hold several images."""
    return Path(path).suffix.lower() in STACKS


def holds_several(file: Path) -> bool:
    """Whether an image file holds several; False also of damaged ones, which say so when read."""
    try:
        if file.suffix.lower() == ".npy":
            shape = map_npy(file).shape
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
    with image_files.as_image_error(str(file)):
        reader: Callable[[int], NDArray[Any]]
        if suffix == ".npz":
            arrays = read_npz(file)
            if len(arrays) != 1:
                named = ", ".join(list(arrays)[:5]) or "nothing"
                hint = "save one array of (K, rows, cols) in it, or give an npy file"
                raise InputError(f"{file}: holds {len(arrays)} arrays ({named})", hint=hint)
            array = _checked(file, *arrays.values())
            count, reader = len(array), partial(np.take, array, axis=0)
        elif suffix == ".npy":
            count, reader = len(_checked(file, map_npy(file))), partial(_mapped_page, map_npy, file)
        elif (images := _contiguous(file)) is not None:
            count, reader = len(_checked(file, images)), partial(_mapped_page, _contiguous, file)
        else:
            with tifffile.TiffFile(file) as tiff:
                count, reader = len(tiff.pages), partial(_tiff_page, file)
    return [Page(file, index, reader) for index in range(count)]


def _tiff_page(file: Path, index: int) -> NDArray[Any]:
    with tifffile.TiffFile(file) as tiff:
        return image_files.read_page(file, tiff.pages[index].aspage())


def _mapped_page(opened: Callable[[Path], Any], file: Path, index: int) -> NDArray[Any]:
    # A copy: the file must not stay open, and the image must not change with it.
    return np.array(opened(file)[index])


def _contiguous(file: Path) -> NDArray[Any] | None:
    """Images after the description of a single one, as ImageJ and tifffile may write them."""
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        few = len(tiff.pages) > 1 or not (tiff.is_imagej or tiff.is_shaped)
        if few or tiff.series[0].size == page.size:
            return None
        image_files.check_page(file, page)
    mapped: NDArray[Any] = tifffile.memmap(file, mode="r")
    return mapped.reshape(-1, *page.shape)


def _checked(file: Path, array: NDArray[Any]) -> NDArray[Any]:
    """The array of a file, if it is a stack of images."""
    shape = array.shape
    # A last axis of three means colours: no projector and no camera is three pixels wide.
    fits = (len(shape) == 3 and shape[-1] != 3) or (len(shape) == 4 and shape[-1] in (1, 3))
    if not fits or not shape[0]:
        raise InputError(
            f"{file}: holds an array of shape {tuple(shape)}, no stack of images",
            hint="give (K, rows, cols), or (K, rows, cols, 3) in colour",
        )
    check_image_size(file, shape[1:])
    return array


def list_images(folder: str | Path) -> list[Path]:
    """The image files of a folder in natural order (frame 2 before frame 10), all of one format.

    Hidden files and others are ignored; broken links, pipes and devices with image names refused.
    """
    place = as_path(folder)
    if not place.exists():
        raise InputError(f"{place}: no such folder", hint="check the name")
    if not place.is_dir():
        hint = f"give the folder that holds it, or a stack: {STACK_FORMATS}"
        raise InputError(f"{place}: is a file, not a folder of images", hint=hint)
    files = [entry for entry in place.iterdir() if not entry.is_dir() and entry.name[0] != "."]
    images = sorted(
        (file for file in files if file.suffix.lower() in image_files.READABLE), key=natural_order
    )
    for file in images:
        # A link that leads nowhere is a missing frame, not a file to ignore.
        regular_file(file)
    if not images:
        other = sorted({file.suffix for file in files if file.suffix})
        only = f", only {', '.join(other)} files" if other else ""
        raise InputError(
            f"{place}: holds no images{only}", hint=f"convert them to {image_files.FORMATS}"
        )
    suffixes = sorted({file.suffix.lower() for file in images})
    if len(suffixes) > 1:
        raise InputError(
            f"{place}: holds images of several formats ({', '.join(suffixes)})",
            hint="keep one image a frame, all in one format",
        )
    return images


def list_entries(source: str | Path) -> list[Path | Page]:
    """The images of a folder in natural order, or those of a file (or a folder's only file)."""
    place = as_path(source)
    if is_stack(place) and not place.is_dir():
        return list(pages(place))
    files = list_images(place)
    if len(files) == 1 and is_stack(files[0]) and holds_several(files[0]):
        return list(pages(files[0]))
    return list(files)


def nonlinear_tag(path: str | Path | Page) -> str | None:
    """Why a file is probably not linear: "JPEG", "tagged sRGB", ... (not gamma 1), or None."""
    file = path.file if isinstance(path, Page) else Path(path)
    if file.suffix.lower() in image_files.JPEG:
        return "JPEG"
    if file.suffix.lower() != ".png":
        return None
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(file) as image:
            tags = image.info
    # Image libraries raise nearly anything on damaged files.
    except Exception:
        return None
    if "srgb" in tags:
        return "tagged sRGB"
    if "icc_profile" in tags:
        return "tagged with a colour profile"
    gamma = tags.get("gamma", 1)
    return f"tagged with gamma {1 / gamma:.2g}" if gamma not in (0, 1) else None


@dataclass(frozen=True, repr=False)
class ImageStack(ShortRepr):
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

    @classmethod
    def open(
        cls, source: str | Path | Sequence[Path | Page], *, mosaic: bool = False
    ) -> "ImageStack":
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
        if self.grey and image.ndim == 3:
            if not image_files.is_grey(image):
                raise InputError(
                    f"{path}: is in colour, but other images of the folder are grey in three "
                    "channels",
                    hint="save all of them in grey, or all in colour",
                )
            image = np.ascontiguousarray(image[..., 0])
        if image.shape != self.shape:
            raise InputError(
                f"{path}: is {_words(image.shape)}, but {self.paths[0].name} is "
                f"{_words(self.shape)}",
                hint="all images of a folder must have one size; move others elsewhere, or turn "
                "the pixels, since EXIF orientation is not followed",
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

    def select(self, index: Sequence[int]) -> "ImageStack":
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
        if image.ndim != 3 or not image_files.is_grey(image):
            return False
        varied += bool(np.ptp(image) > 0)
    return varied > len(samples) // 2


def _words(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]}" + (f" with {shape[2]} channels" if len(shape) == 3 else "")


def natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """The key by which file names are sorted, frame 2 before frame 10."""
    # Only ASCII digits count: Python takes a superscript two for a digit, too.
    parts = re.split(r"([0-9]+)", path.name.casefold())
    key = [(0, int(p), "") if p[0] in "0123456789" else (1, 0, p) for p in parts if p]
    return key, path.name
