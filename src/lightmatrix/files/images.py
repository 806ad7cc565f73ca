"""Image files: 8/16-bit PNG, TIFF and npy, grey or colour, one image a file.

Pixels stay as they were stored (uint8, uint16 or float32); `lightmatrix.camera` says what they
mean. Stacks of images are in `image_stack.py`.
"""

from __future__ import annotations

import io
import math
import struct
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from lightmatrix.errors import InputError, LightMatrixError, warn
from lightmatrix.files import png
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.exr import read_exr, write_exr
from lightmatrix.files.numpy_files import as_float32, read_npy
from lightmatrix.files.pgm import read_pgm
from lightmatrix.files.pillow_images import decode_image, encode_image
from lightmatrix.files.raw import RAW, read_raw
from lightmatrix.files.reading import check_image_size, regular_file
from lightmatrix.files.tiff import read_tiff
from lightmatrix.outputs.kinds import IMAGE
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.ranges import real_array

# The endings of files that are read, and their formats in words.
READABLE = (".png", ".tif", ".tiff", ".npy", ".jpg", ".jpeg", ".bmp", ".pgm", ".exr", *RAW)
FORMATS = "PNG, TIFF, npy, EXR, DNG and other raw files, JPEG, BMP or PGM"
# The gamma by which pictures of light are coded, since displays undo it (IEC 61966-2-1 is close).
DISPLAY_GAMMA = 2.2
# The highest levels of images of 8, 10, 12 and 14 bits, whose files may have 16.
HIGHEST_LEVELS = (255, 1023, 4095, 16383)
# Filters of warnings belong to the whole process, in which several threads may read images.
_filters = threading.Lock()


def read_image(path: str | Path, *, mosaic: bool = False) -> NDArray[Any]:
    """Read one image as it is stored.

    Parameters
    ----------
    path : str or Path
        A PNG, TIFF, npy, EXR, JPEG, BMP or (binary) PGM file. Black-and-white images become 0/255,
        an alpha channel that is opaque everywhere is dropped. Raw camera files (DNG, CR2, NEF, ARW,
        ...) come as light from 0, black, to 1, where the sensor clips, without white balance.
    mosaic : bool
        Whether raw files are read as they are, one sample a pixel, not interpolated to colours.

    Returns
    -------
    (rows, cols) or (rows, cols, 3) uint8, uint16 or float32
        Float values are finite.

    Raises
    ------
    InputError
        If the file is missing, no regular file, empty, truncated, damaged (checksums of PNG are
        verified), not an image, larger than 2^28 values, not 2-D, or not finite in float32.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("image.png", np.eye(3, dtype=np.uint8))
    >>> lm.read_image("image.png")[0]
    array([1, 0, 0], dtype=uint8)
    """
    file = Path(path)
    _check_file(file)
    suffix = file.suffix.lower()
    with as_image_error(str(file)):
        image = read_raw(file, mosaic=mosaic) if suffix in RAW else _READERS[suffix](file)
    return as_stored(str(file), image)


@contextmanager
def as_image_error(name: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged image into an InputError that names it."""
    try:
        yield
    except (LightMatrixError, MemoryError):
        raise
    except PermissionError as error:
        raise InputError(
            f"{name}: cannot be read ({error.strerror})", hint="check its permissions"
        ) from error
    # Libraries raise nearly anything, among them SyntaxError.
    except Exception as error:
        # Their words do not help where the file ends early, or where no reader knows the format.
        reason = " ".join(str(error).split())[:120]
        if isinstance(error, (IndexError, struct.error, UnidentifiedImageError)):
            reason = ""
        raise InputError(
            f"{name}: cannot be read as an image, damaged or truncated"
            + (f" ({reason})" if reason else ""),
            hint="copy or export the file again",
        ) from error


def read_grey(path: str | Path) -> NDArray[np.float32]:
    """Read one pattern: grey values in [0, 1].

    Returns
    -------
    (rows, cols) float32
        Integer images over their full range; colour images only if their channels agree, or only
        one is lit at all.

    Raises
    ------
    InputError
        As for `read_image`, and for images of several colours or float values outside [0, 1].

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("grey.png", np.array([[0, 51, 255]], np.uint8))
    >>> lm.read_grey("grey.png")
    array([[0. , 0.2, 1. ]], dtype=float32)
    """
    image = read_image(path)
    _warn_of_depth(str(path), image)
    return as_grey(str(path), image)


def as_grey(name: str, image: NDArray[Any]) -> NDArray[np.float32]:
    """The pattern that an image from `read_image` shows; see `read_grey`."""
    if image.ndim == 3:
        lit = [bool(image[..., channel].any()) for channel in range(3)]
        if sum(lit) > 1 and not is_grey(image):
            raise InputError(
                f"{name}: a pattern of several colours",
                hint="make it grey; a colour projector counts as three: show and photograph all "
                "patterns in red, then in green, then in blue, and estimate each by itself",
            )
        image = image[..., lit.index(True) if any(lit) else 0]
    return _as_light(name, image)


def is_grey(image: NDArray[Any]) -> bool:
    """Whether the channels of an image, (rows, cols, channels), are all the same."""
    return bool((image == image[..., :1]).all())


def read_light(path: str | Path) -> NDArray[np.float32]:
    """Read one pattern: (rows, cols) or (rows, cols, 3) float32 in [0, 1]; see `read_grey`."""
    image = read_image(path)
    _warn_of_depth(str(path), image)
    return _as_light(str(path), image)


def _warn_of_depth(name: str, image: NDArray[Any]) -> None:
    """Warn of a pattern of fewer bits in a file of 16, which is shown nearly black."""
    top = int(image.max())
    if image.dtype == np.uint16 and 0 < top <= HIGHEST_LEVELS[-1]:
        white = next(level for level in HIGHEST_LEVELS if level >= top)
        warn(
            f"{name}: has 16 bits, but no level above {top}, so that it is shown "
            f"{65535 / white:.4g} times darker than a pattern of {white.bit_length()} bits; "
            "save it over the full range if it is one",
        )


def _as_light(name: str, image: NDArray[Any]) -> NDArray[np.float32]:
    if image.dtype == np.float32:
        if image.min() < 0 or image.max() > 1:
            raise InputError(
                f"{name}: pattern values from {image.min():.9g} to {image.max():.9g}",
                hint="scale the pattern to [0, 1]",
            )
        return image
    return (image / np.float32(np.iinfo(image.dtype).max)).astype(np.float32)


def colour_of(image: NDArray[Any]) -> str:
    """The colour of a pattern: "grey", "red", "green", "blue", or "" if all of it is black."""
    if image.ndim == 2:
        return "grey" if image.any() else ""
    lit = [name for channel, name in enumerate(COLOURS) if image[..., channel].any()]
    return lit[0] if len(lit) == 1 else "grey" if lit else ""


def write_image(
    path: str | Path, image: NDArray[Any], *, bits: int = 8, overwrite: bool = False
) -> None:
    """Write one image, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .png, .tif, .tiff, .npy or .exr.
    image : (rows, cols) or (rows, cols, 1 or 3)
        uint8 and uint16 are written as they are, to EXR as float. Float values are written as
        float32, except to PNG: there [0, 1] becomes the full range and what lies outside is cut
        off.
    bits : {8, 16}
        Bits of a float image written as PNG.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    InputError
        If the image is not an image or not finite.
    OutputError
        If the file exists, is no image, has another ending or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("half.png", np.full((2, 2), 0.5))
    >>> lm.read_image("half.png")[0]
    array([128, 128], dtype=uint8)
    """
    with atomic_file(path, IMAGE, overwrite=overwrite) as part:
        fill_image(part, image, bits=bits)


def fill_image(path: Path, image: NDArray[Any], *, bits: int = 8, missing: bool = False) -> None:
    """Write one image as `write_image` does, but in place: for folders that are atomic.

    With `missing`, pixels may be NaN, which a PNG cannot hold.
    """
    pixels = real_array("an image", image)
    if pixels.ndim == 3 and pixels.shape[-1] == 1:
        pixels = pixels[..., 0]
    if pixels.ndim not in (2, 3) or pixels.size == 0 or (pixels.ndim == 3 and len(pixels.T) != 3):
        raise InputError(
            f"an image of shape {pixels.shape}", hint="give (rows, cols) or (rows, cols, 3)"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        pixels = as_float32(pixels)
        if not missing and not np.isfinite(pixels).all():
            raise InputError("the image has values that are not finite")
    suffix = path.suffix.lower()
    if suffix == ".npy":
        # NumPy would add its own ending to a name whose ending is in capitals.
        with path.open("wb") as stream:
            np.save(stream, pixels)
    elif suffix == ".exr":
        write_exr(path, np.asarray(pixels, np.float32))
    elif suffix in (".tif", ".tiff"):
        tifffile.imwrite(path, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
    else:
        levels = _to_levels(pixels, bits)
        if levels.ndim == 3 and levels.dtype == np.uint16:
            png.write_deep_colour(path, levels)
        else:
            # Encoded in memory first: Pillow fails twice if the disk is full.
            path.write_bytes(encode_image(levels, "png"))


def _check_file(file: Path) -> None:
    if file.is_dir():
        raise InputError(f"{file}: is a folder, not an image file", hint="give one image file")
    regular_file(file)
    if file.suffix.lower() not in READABLE:
        raise InputError(
            f"{file}: files ending in {file.suffix or 'nothing'} are not read",
            hint=f"convert it to {FORMATS}",
        )
    if file.stat().st_size == 0:
        raise InputError(f"{file}: is empty (0 bytes)", hint="copy or export the file again")


def _read_png(file: Path) -> NDArray[Any]:
    data = file.read_bytes()
    chunks = png.read_chunks(data)
    header = png.read_png_header(chunks)
    check_image_size(file, (header.rows, header.cols, png.CHANNELS[header.colour]))
    if header.is_deep_colour:
        return png.decode_deep_colour(chunks)
    # Pillow stops at the last pixel and does not verify the checksum behind it.
    png.verify_pixels(chunks.get(b"IDAT", b""), header.inflated_bytes)
    pixels = header.rows * header.cols
    if header.colour == png.PALETTE:
        # Pillow turns indices into colours, and indices without a colour into black.
        png.verify_indices(_read_by_pillow(data, pixels, mode="P"), chunks.get(b"PLTE", b""))
    return _read_by_pillow(data, pixels)


def _read_jpeg(file: Path) -> NDArray[Any]:
    return _read_signed(file, b"\xff\xd8\xff", "JPEG")


def _read_bmp(file: Path) -> NDArray[Any]:
    return _read_signed(file, b"BM", "BMP")


def _read_signed(file: Path, signature: bytes, kind: str) -> NDArray[Any]:
    """Read an image only if it begins like the format of its name."""
    data = file.read_bytes()
    if not data.startswith(signature):
        raise ValueError(f"not a {kind} file")
    with Image.open(io.BytesIO(data)) as opened:
        cols, rows = opened.size
        # An image with a palette becomes one of three channels.
        channels = 3 if opened.mode == "P" else len(opened.getbands())
        check_image_size(file, (rows, cols, channels))
        if opened.mode == "CMYK":
            raise InputError(f"{file}: has printing colours (CMYK)", hint="save it in grey or RGB")
    return _read_by_pillow(data, rows * cols)


def _read_by_pillow(data: bytes, pixels: int, mode: str | None = None) -> NDArray[Any]:
    if pixels <= (Image.MAX_IMAGE_PIXELS or math.inf):
        return decode_image(data, mode=mode)
    with _filters, warnings.catch_warnings():
        # Pillow warns of large images, whose size was checked.
        warnings.filterwarnings("ignore", message=".*decompression bomb", category=Warning)
        return decode_image(data, mode=mode)


_READERS = {
    ".png": _read_png,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".npy": read_npy,
    ".jpg": _read_jpeg,
    ".jpeg": _read_jpeg,
    ".bmp": _read_bmp,
    ".pgm": read_pgm,
    ".exr": read_exr,
}


def as_stored(name: str, image: NDArray[Any]) -> NDArray[Any]:
    """Convert what a library read to a shape and type of `read_image`, or refuse it by name."""
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    if image.ndim == 3 and image.shape[-1] in (2, 4):
        image = _without_alpha(name, image)
    if image.ndim == 3 and image.shape[-1] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[-1] != 3) or image.size == 0:
        raise InputError(
            f"{name}: holds an array of shape {image.shape}",
            hint="save one image a file, (rows, cols) or (rows, cols, 3)",
        )
    if image.dtype.kind == "f":
        values = as_float32(image)
        if not np.isfinite(values).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise InputError(
                f"{name}: the value at {at} is {image[at]}",
                hint="replace it, and mask the pixel if it is broken in every frame",
            )
        return np.ascontiguousarray(values)
    if image.dtype == np.int32 and image.min() >= 0 and image.max() <= 65535:
        # Pillow returns some 16-bit images in 32 bits.
        return image.astype(np.uint16)
    if image.dtype.newbyteorder("=") not in (np.uint8, np.uint16):
        raise InputError(
            f"{name}: holds {image.dtype} values", hint="save it as uint8, uint16 or float32"
        )
    return np.ascontiguousarray(image, image.dtype.newbyteorder("="))


def _without_alpha(name: str, image: NDArray[Any]) -> NDArray[Any]:
    opaque = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
    if (image[..., -1] != opaque).any():
        raise InputError(
            f"{name}: is partly transparent", hint="save the image without an alpha channel"
        )
    return image[..., :-1]


def _to_levels(pixels: NDArray[Any], bits: int) -> NDArray[Any]:
    if pixels.dtype != np.float32:
        return pixels
    if bits not in (8, 16):
        raise InputError(f"{bits} bits for a PNG file", hint="use 8 or 16")
    top = 2**bits - 1
    return np.rint(pixels.clip(0, 1) * np.float64(top)).astype(f"u{bits // 8}")
