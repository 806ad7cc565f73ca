"""Image files: 8/16-bit PNG, TIFF and npy, grey or colour, one image a file.

Pixels come back as they were stored (uint8, uint16 or float32); what they mean is the business of
`lightmatrix.camera`. Stacks are folders of images in natural order, read one image at a time.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import tifffile
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files import png16
from lightmatrix.files.outputs import atomic_file, check_output

READABLE = (".png", ".tif", ".tiff", ".npy", ".jpg", ".jpeg", ".bmp")


WRITABLE = (".png", ".tif", ".tiff", ".npy")


FORMATS = "PNG, TIFF, npy, JPEG or BMP"


def read_image(path: str | Path) -> NDArray[Any]:
    """Read one image as it is stored.

    Parameters
    ----------
    path : str or Path
        A PNG, TIFF, npy, JPEG or BMP file. Black-and-white images become 0/255, an alpha channel
        that is opaque everywhere is dropped.

    Returns
    -------
    (rows, cols) or (rows, cols, 3) uint8, uint16 or float32
        Float values are finite.

    Raises
    ------
    InputError
        If the file is missing, a folder, empty, truncated, not an image, not 2-D, or not finite.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("image.png", np.eye(3, dtype=np.uint8))
    >>> lm.read_image("image.png")[0]
    array([1, 0, 0], dtype=uint8)
    """
    file = Path(path)
    _check_file(file)
    try:
        image = _READERS.get(file.suffix.lower(), _read_common)(file)
    except InputError:
        raise
    # Image libraries raise nearly anything on damaged files, among them SyntaxError.
    except Exception as error:
        # Reading past the end, and formats that no reader knows, are told without helpful words.
        reason = " ".join(str(error).split())[:120]
        if isinstance(error, (IndexError, struct.error)) or "given uri" in reason:
            reason = ""
        raise InputError(
            f"{file}: cannot be read as an image, damaged or truncated"
            + (f" ({reason})" if reason else ""),
            hint="copy or export the file again",
        ) from error
    return _as_stored(file, image)


def read_grey(path: str | Path) -> NDArray[np.float32]:
    """Read one pattern: grey values in [0, 1].

    Returns
    -------
    (rows, cols) float32
        Integer images over their full range; colour images only if their channels agree.

    Raises
    ------
    InputError
        As for `read_image`, and for coloured images or float values outside [0, 1].

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("grey.png", np.array([[0, 51, 255]], np.uint8))
    >>> lm.read_grey("grey.png")
    array([[0. , 0.2, 1. ]], dtype=float32)
    """
    image = read_image(path)
    if image.ndim == 3:
        if (image != image[..., :1]).any():
            raise InputError(
                f"{path}: a coloured pattern",
                hint="save patterns in grey; a colour projector is three projectors",
            )
        image = image[..., 0]
    if image.dtype == np.float32:
        if image.min() < 0 or image.max() > 1:
            raise InputError(
                f"{path}: pattern values from {image.min():g} to {image.max():g}",
                hint="scale the pattern to [0, 1]",
            )
        return image
    return (image / np.float32(np.iinfo(image.dtype).max)).astype(np.float32)


def write_image(
    path: str | Path, image: NDArray[Any], *, bits: int = 8, overwrite: bool = False
) -> None:
    """Write one image, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .png, .tif, .tiff or .npy.
    image : (rows, cols) or (rows, cols, 1 or 3)
        uint8 and uint16 are written as they are. Float values are written as float32, except to
        PNG: there [0, 1] becomes the full range and what lies outside is cut off.
    bits : {8, 16}
        Bits of a float image written as PNG.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    InputError
        If the image is not an image or not finite.
    OutputError
        If the file exists, has another ending or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_image("half.png", np.full((2, 2), 0.5))
    >>> lm.read_image("half.png")[0]
    array([128, 128], dtype=uint8)
    """
    check_output(path, overwrite=overwrite, suffixes=WRITABLE)
    with atomic_file(path, overwrite=overwrite) as part:
        fill_image(part, image, bits=bits)


def fill_image(path: Path, image: NDArray[Any], *, bits: int = 8) -> None:
    """Write one image as `write_image` does, at once: for folders that are atomic as a whole.

    Raises
    ------
    InputError
        If the image is not an image or not finite.
    """
    pixels = np.asarray(image)
    if pixels.ndim == 3 and pixels.shape[-1] == 1:
        pixels = pixels[..., 0]
    if pixels.ndim not in (2, 3) or pixels.size == 0 or (pixels.ndim == 3 and len(pixels.T) != 3):
        raise InputError(
            f"an image of shape {pixels.shape}", hint="give (rows, cols) or (rows, cols, 3)"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        pixels = pixels.astype(np.float32)
        if not np.isfinite(pixels).all():
            raise InputError("the image has values that are not finite")
    suffix = path.suffix.lower()
    if suffix == ".npy":
        np.save(path, pixels)
    elif suffix in (".tif", ".tiff"):
        tifffile.imwrite(path, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
    else:
        levels = _to_levels(pixels, bits)
        if levels.ndim == 3 and levels.dtype == np.uint16:
            png16.write(path, levels)
        else:
            # Encoded first: given a file, Pillow's plugin trips over a full disk twice.
            encoded = imageio.imwrite("<bytes>", levels, extension=".png", plugin="pillow")
            path.write_bytes(encoded)


def _check_file(file: Path) -> None:
    if not file.exists():
        raise InputError(f"{file}: no such file", hint="check the name")
    if file.is_dir():
        raise InputError(f"{file}: is a folder, not an image file", hint="give one image file")
    if file.suffix.lower() not in READABLE:
        raise InputError(
            f"{file}: files ending in {file.suffix or 'nothing'} are not read",
            hint=f"convert it to {FORMATS}",
        )
    if file.stat().st_size == 0:
        raise InputError(f"{file}: is empty (0 bytes)", hint="copy or export the file again")


def _read_common(file: Path) -> NDArray[Any]:
    with file.open("rb") as opened:
        header = opened.read(33)
    if png16.is_colour16(header):
        return png16.read(file.read_bytes())
    return np.asarray(imageio.imread(file, plugin="pillow", index=0))


def _read_npy(file: Path) -> NDArray[Any]:
    return np.asarray(np.load(file, allow_pickle=False))


def _read_tiff(file: Path) -> NDArray[Any]:
    with tifffile.TiffFile(file) as tiff:
        if len(tiff.pages) != 1:
            raise InputError(f"{file}: holds {len(tiff.pages)} pages", hint="save one image a file")
        page = tiff.pages.first
        # tifffile fills what is missing with zeros; a truncated image must not look dark.
        ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if not ends or max(ends) > file.stat().st_size:
            raise ValueError("the file ends early")
        if page.compression == 1 or page.compression in (8, 32946):
            image = np.asarray(page.asarray())
        else:
            # Other compressions are Pillow's, as far as it keeps the depth.
            image = np.asarray(imageio.imread(file, plugin="pillow"))
            if image.dtype != page.dtype:
                kind = int(page.compression)
                raise InputError(
                    f"{file}: {page.dtype} values with compression {kind} are not read",
                    hint="save it uncompressed or as PNG",
                )
        if page.photometric == 0 and image.dtype.kind == "u":
            image = np.iinfo(image.dtype).max - image
        return image


_READERS = {".npy": _read_npy, ".tif": _read_tiff, ".tiff": _read_tiff}


def _as_stored(file: Path, image: NDArray[Any]) -> NDArray[Any]:
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    if image.ndim == 3 and image.shape[-1] in (2, 4):
        image = _without_alpha(file, image)
    if image.ndim == 3 and image.shape[-1] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[-1] != 3) or image.size == 0:
        raise InputError(
            f"{file}: holds an array of shape {image.shape}",
            hint="save one image a file, (rows, cols) or (rows, cols, 3)",
        )
    if image.dtype.kind == "f":
        if not np.isfinite(image).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(image))[0])
            raise InputError(
                f"{file}: the value at {at} is {image[at]}",
                hint="replace it, and mask the pixel if it is broken in every frame",
            )
        return image.astype(np.float32)
    if image.dtype == np.int32 and image.min() >= 0 and image.max() <= 65535:
        # How Pillow hands over some 16-bit images.
        return image.astype(np.uint16)
    if image.dtype.newbyteorder("=") not in (np.uint8, np.uint16):
        raise InputError(
            f"{file}: holds {image.dtype} values", hint="save it as uint8, uint16 or float32"
        )
    return np.ascontiguousarray(image, image.dtype.newbyteorder("="))


def _without_alpha(file: Path, image: NDArray[Any]) -> NDArray[Any]:
    opaque = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
    if (image[..., -1] != opaque).any():
        raise InputError(
            f"{file}: is partly transparent", hint="save the image without an alpha channel"
        )
    return image[..., :-1]


def _to_levels(pixels: NDArray[Any], bits: int) -> NDArray[Any]:
    if pixels.dtype != np.float32:
        return pixels
    if bits not in (8, 16):
        raise InputError(f"{bits} bits for a PNG file", hint="use 8 or 16")
    top = 2**bits - 1
    return np.rint(pixels.clip(0, 1) * np.float64(top)).astype(f"u{bits // 8}")
