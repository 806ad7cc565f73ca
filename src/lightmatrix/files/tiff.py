"""TIFF files: whatever tifffile would fill with zeros, or return undecoded, is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.inflating import inflated_size
from lightmatrix.files.pillow_images import decode_image
from lightmatrix.files.reading import check_image_size

# Numbers of the TIFF specification: compressions, and photometric interpretations.
_UNCOMPRESSED, _DEFLATE = 1, (8, 32946)
_INVERTED, _PALETTE, _YCBCR = 0, 3, 6
# Grey either way, RGB, and the mosaics of raw files, in which every pixel is one sample.
_PHOTOMETRIC = (_INVERTED, 1, 2, 32803, 34892)
# The tag of the orientation, and what undoes each of them but the first, upright.
_ORIENTATION = 274
_TURNED_AGAIN: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.swapaxes(0, 1),
    6: lambda image: np.rot90(image),
    7: lambda image: image[::-1, ::-1].swapaxes(0, 1),
    8: lambda image: np.rot90(image, -1),
}
_BITS = (1, 8, 16, 32, 64)
_ONE_IMAGE = "save one image a file, or give this file in place of the folder, as a stack"


def read_tiff(file: Path) -> NDArray[Any]:
    """Read a TIFF of one page as it is stored; a ValueError says if parts are missing."""
    with tifffile.TiffFile(file) as tiff:
        if len(tiff.pages) != 1:
            raise InputError(f"{file}: holds {len(tiff.pages)} pages", hint=_ONE_IMAGE)
        page = tiff.pages.first
        check_image_size(file, page.shape)
        # ImageJ and tifffile write many images behind the description of one.
        if (tiff.is_imagej or tiff.is_shaped) and tiff.series[0].size != page.size:
            raise InputError(f"{file}: holds several images", hint=_ONE_IMAGE)
        return read_page(file, page, 0)


def read_page(file: Path, page: tifffile.TiffPage, index: int) -> NDArray[Any]:
    """Read page number `index` of an open TIFF file; see `read_tiff`."""
    check_page(file, page)
    if _is_plain(page):
        image = np.asarray(page.asarray())
        if page.axes == "SYX":
            image = np.moveaxis(image, 0, -1)
    else:
        # Pillow reads other compressions, unless it would reduce their depth.
        image = _as_it_lies(page, decode_image(file, index=index))
        if image.dtype != page.dtype:
            kind = int(page.compression)
            raise InputError(
                f"{file}: {page.dtype} values with compression {kind} are not read",
                hint="save it uncompressed or as PNG",
            )
    return turned_back(image) if is_inverted(page) else image


def is_inverted(page: tifffile.TiffPage) -> bool:
    """Whether 0 stands for white."""
    return page.photometric == _INVERTED and page.dtype is not None and page.dtype.kind == "u"


def turned_back(image: NDArray[Any]) -> NDArray[Any]:
    """The levels of an inverted image, with 0 for black."""
    return np.asarray(np.iinfo(image.dtype).max - image)


def _as_it_lies(page: tifffile.TiffPage, image: NDArray[Any]) -> NDArray[Any]:
    """The pixels in the order of the file, as other images are read.

    Pillow turns an image by the tag of its orientation, tifffile does not. A camera that writes the
    tag into some frames only would otherwise move them under the others.
    """
    tag = page.tags.get(_ORIENTATION)
    turn = _TURNED_AGAIN.get(tag.value if tag is not None else 1)
    return np.asarray(image if turn is None else np.ascontiguousarray(turn(np.asarray(image))))


def check_segments(file: Path, page: tifffile.TiffPage) -> None:
    """Check that all strips or tiles lie in the file and hold as much as the image needs."""
    counts, offsets = page.databytecounts, page.dataoffsets
    if not len(counts) == len(offsets) == math.prod(page.chunked):
        raise ValueError("strips are missing")
    if min(counts) < 1:
        raise ValueError("a strip of 0 bytes")
    size = file.stat().st_size
    if min(offsets) < 8 or any(o + n > size for o, n in zip(offsets, counts, strict=True)):
        raise ValueError("the file ends early")
    if not _is_plain(page):
        return
    rows, cols, depth = (*page.chunks, 1)[:3]
    line = (cols * depth * page.bitspersample + 7) // 8
    strips = -(-page.imagelength // rows)
    with file.open("rb") as stream:
        for index, (offset, count) in enumerate(zip(offsets, counts, strict=True)):
            held = count
            if page.compression in _DEFLATE:
                stream.seek(offset)
                held = inflated_size(stream.read(count), rows * line)
            first = rows * (index % strips)
            # The last strip may be shorter, or filled up; tiles are always whole.
            if held < line * (rows if page.is_tiled else min(rows, page.imagelength - first)):
                raise ValueError("a strip is shorter than the image needs")


def _is_plain(page: tifffile.TiffPage) -> bool:
    return page.compression in (_UNCOMPRESSED, *_DEFLATE)


def check_page(file: Path, page: tifffile.TiffPage) -> None:
    """Refuse a page whose colours, axes, depth or segments are not read."""
    check_image_size(file, page.shape)
    colours = int(page.photometric)
    # Pillow decodes the colours of JPEG in TIFF.
    if colours not in _PHOTOMETRIC and (colours != _YCBCR or _is_plain(page)):
        words = "a palette" if colours == _PALETTE else f"colours of kind {colours}"
        raise InputError(f"{file}: has {words}", hint="save it in grey or RGB")
    if page.axes not in ("YX", "YXS", "SYX"):
        raise InputError(f"{file}: has axes {page.axes}", hint="save one image a file")
    bits = page.bitspersample
    if bits not in _BITS:
        raise InputError(f"{file}: has {bits} bits a value", hint="save it with 8 or 16 bits")
    check_segments(file, page)
