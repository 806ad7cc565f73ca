"""Image files: PNG, TIFF, npy, EXR, raw, JPEG, BMP and PGM, grey or colour, one image a file.

Pixels stay as they were stored (uint8, uint16 or float32); `lightmatrix.capture` says what they
mean. `stacks.py` reads many images. libpng (by imagecodecs) reads PNG and verifies its checksums,
since Pillow verifies none of the pixels and reads 16-bit colour as 8 bits without a word.
"""

import io
import math
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import imagecodecs
import lazy_loader
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from lightmatrix.errors import InputError, LightMatrixError, lacks_memory, warn
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.extras import RAW, read_exr, read_raw, write_exr
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.numpy_files import as_float32, read_npy
from lightmatrix.files.reading import MOST_VALUES, check_image_size, read_bytes, regular_file
from lightmatrix.files.writing import atomic_file
from lightmatrix.paths import as_path
from lightmatrix.ranges import real_array

tifffile = lazy_loader.load("tifffile")

# The endings of files that are read, and their formats in words.
JPEG = (".jpg", ".jpeg")
READABLE = (".png", ".tif", ".tiff", ".npy", *JPEG, ".bmp", ".pgm", ".exr", *RAW)
FORMATS = "PNG, TIFF, npy, EXR, DNG and other raw files, JPEG, BMP or PGM"
# The gamma by which pictures of light are coded, since displays undo it (IEC 61966-2-1 is close).
DISPLAY_GAMMA = 2.2
# The highest levels of images of 8, 10, 12 and 14 bits, whose files may have 16.
_HIGHEST_LEVELS = (255, 1023, 4095, 16383)
_PNG = b"\x89PNG\r\n\x1a\n"
# Channels of a PNG file by its kind of colour: grey, RGB, palette, which becomes RGB, and the first
# two with an alpha channel.
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
# Compressions of TIFF, by their number in its specification. All are decoded into as many bytes as
# the image needs, while an image within an image, such as a JPEG, may announce any size.
_COMPRESSIONS = {
    1: "none", 2: "CCITT", 3: "CCITT", 4: "CCITT", 5: "LZW", 8: "deflate",
    32773: "PackBits", 32946: "deflate", 34925: "LZMA", 50000: "Zstandard",
}  # fmt: skip
# Photometric interpretations of TIFF: black is 0, RGB, and the mosaics of raw files, in which each
# pixel is one sample. Others are refused: white is 0, a palette, ...
_PHOTOMETRIC, _REFUSED = (1, 2, 32803, 34892), {0: "white as 0", 3: "a palette"}
_BITS = (1, 8, 10, 12, 14, 16, 32, 64)
_ONE_IMAGE = "save one image a file, or give this file in place of the folder, as a stack"
# A number in the header of a PGM file, after white space and comments.
_NUMBER = rb"(?:\s|#[^\n\r]*[\n\r])+(\d{1,9})"


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
    file = as_path(path)
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
        hint = "check its permissions"
        raise InputError(f"{name}: cannot be read ({error.strerror})", hint=hint) from error
    # Libraries raise nearly anything, among them SyntaxError.
    except Exception as error:
        # Decoders that are installed cannot be loaded only where memory runs out.
        if isinstance(error, ImportError) or lacks_memory(error):
            raise MemoryError(str(error)) from error
        # Their words do not help where the file ends early, or where no reader knows the format.
        reason = " ".join(str(error).split())[:120]
        if isinstance(error, (IndexError, struct.error, UnidentifiedImageError)):
            reason = ""
        raise InputError(
            f"{name}: cannot be read as an image, damaged or truncated"
            + (f" ({reason})" if reason else ""),
            hint="copy or export the file again",
        ) from error


def given_image(what: str, image: Any, read: Callable[[str | Path], NDArray[Any]]) -> NDArray[Any]:
    """An image read from its file, or an array of real numbers; `what` names it in messages."""
    return read(image) if isinstance(image, str | Path) else real_array(what, image)


def read_grey(path: str | Path) -> NDArray[np.float32]:
    """Read one pattern: grey values (rows, cols) float32 in [0, 1], of integers the full range.

    Images in colour are an InputError unless their channels agree, or only one is lit at all.
    """
    return as_grey(str(path), _read_pattern(path))


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
    first, *others = np.moveaxis(image, -1, 0)
    return all(bool((first == other).all()) for other in others)


def read_light(path: str | Path) -> NDArray[np.float32]:
    """Read one pattern: (rows, cols) or (rows, cols, 3) float32 in [0, 1]; see `read_grey`."""
    return _as_light(str(path), _read_pattern(path))


def _read_pattern(path: str | Path) -> NDArray[Any]:
    """Warns of a pattern of fewer bits in a file of 16, which is shown nearly black."""
    image = read_image(path)
    top = int(image.max())
    if top and (white := likely_white(image.dtype, top)) is not None:
        warn(
            f"{path}: has 16 bits, but no level above {top}, so that it is shown "
            f"{65535 / white:.4g} times darker than a pattern of {white.bit_length()} bits; "
            "save it over the full range if it is one"
        )
    return image


def likely_white(dtype: np.dtype[Any], top: int) -> int | None:
    """The white of 16-bit images without a level above `top`; None if they use all bits."""
    return next((n for n in _HIGHEST_LEVELS if n >= top), None) if dtype == np.uint16 else None


def _as_light(name: str, image: NDArray[Any]) -> NDArray[np.float32]:
    if image.dtype == np.float32:
        if image.min() < 0 or image.max() > 1:
            raise InputError(
                f"{name}: pattern values from {image.min():.9g} to {image.max():.9g}",
                hint="scale the pattern to [0, 1]",
            )
        return image
    return (image / np.float32(np.iinfo(image.dtype).max)).astype(np.float32)


def fitted(image: NDArray[np.float32], shape: tuple[int, int], fit: str) -> NDArray[np.float32]:
    """An image (rows, cols[, channels]) in [0, 1] of another shape; see `compensate`.

    Pixels are averaged where it shrinks, which keeps its light.
    """
    shrinks = image.shape[0] >= shape[0] and image.shape[1] >= shape[1]
    how = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    ways: dict[str, Callable[..., Image.Image]] = {
        "cover": ImageOps.fit,
        "contain": ImageOps.pad,
        "stretch": Image.Image.resize,
    }
    channels = np.moveaxis(np.atleast_3d(image), 2, 0)
    done = [np.asarray(ways[fit](Image.fromarray(c), shape[::-1], how)) for c in channels]
    return np.stack(done, axis=-1).reshape(*shape, *image.shape[2:]).clip(0, 1)


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
        hint = "give (rows, cols) or (rows, cols, 3)"
        raise InputError(f"an image of shape {pixels.shape}", hint=hint)
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
        if pixels.dtype == np.float32:
            if bits not in (8, 16):
                raise InputError(f"{bits} bits for a PNG file", hint="use 8 or 16")
            top = np.float64(2**bits - 1)
            pixels = np.rint(pixels.clip(0, 1) * top).astype(f"u{bits // 8}")
        levels = np.ascontiguousarray(pixels)
        # OpenCV's settings (runs of bytes, differences to the left) write photographs ten times as
        # fast as the usual ones, and no larger.
        path.write_bytes(imagecodecs.png_encode(levels, 1, strategy=3, filter=16))


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


def _content(file: Path) -> bytes:
    """All bytes of a file of values of 8 or 16 bits, which no image makes so large."""
    return read_bytes(file, 4 * MOST_VALUES)


def _read_png(file: Path) -> NDArray[Any]:
    data = _content(file)
    if not data.startswith(_PNG) or data[12:16] != b"IHDR":
        raise ValueError("not a PNG file")
    cols, rows, _, colour = struct.unpack_from(">IIBB", data, 16)
    check_image_size(file, (rows, cols, _PNG_CHANNELS.get(colour, 1)))
    # The second number of this chunk (PNG, third edition) is how levels follow light: 16 is PQ, 18
    # HLG.
    described = data.find(b"cICP", 0, data.find(b"IDAT"))
    if described > 0 and data[described + 5 : described + 6] in (b"\x10", b"\x12"):
        warn(f"{file}: is in HDR, but read as SDR\n  export it in SDR, or as light (.exr)")
    image: NDArray[Any] = imagecodecs.png_decode(data)
    # libpng adds an alpha channel where one colour stands for transparent pixels, whose levels
    # are in the file all the same.
    return image[..., :-1] if colour < 4 and image.shape[2:] in ((2,), (4,)) else image


def _by_pillow(signature: bytes, kind: str) -> Callable[[Path], NDArray[Any]]:
    """The reader of a format that Pillow decodes, if the file begins like that format."""

    def read(file: Path) -> NDArray[Any]:
        data = _content(file)
        if not data.startswith(signature):
            raise ValueError(f"not a {kind} file")
        with Image.open(io.BytesIO(data)) as opened:
            cols, rows = opened.size
            # An image with a palette becomes one of three channels.
            channels = 3 if opened.mode == "P" else len(opened.getbands())
            check_image_size(file, (rows, cols, channels))
            if opened.mode == "CMYK":
                hint = "save it in grey or RGB"
                raise InputError(f"{file}: has printing colours (CMYK)", hint=hint)
        return decode_image(data)

    return read


def decode_image(source: bytes | Path) -> NDArray[Any]:
    """The pixels of an image as Pillow decodes it, (rows, cols[, channels]), palettes as colours.

    Pillow may raise nearly anything if the image is damaged.
    """
    with Image.open(io.BytesIO(source) if isinstance(source, bytes) else source) as opened:
        palette = opened.palette if opened.mode == "P" else None
        return np.array(opened if palette is None else opened.convert(palette.mode))


def encode_image(pixels: NDArray[Any], kind: str, **options: Any) -> bytes:
    """An image as the bytes of a file of some kind, such as "webp", with options of Pillow."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


def _read_tiff(file: Path) -> NDArray[Any]:
    with tifffile.TiffFile(file) as tiff:
        if len(tiff.pages) != 1:
            raise InputError(f"{file}: holds {len(tiff.pages)} pages", hint=_ONE_IMAGE)
        page = tiff.pages.first
        check_image_size(file, page.shape)
        # ImageJ and tifffile write many images behind the description of one.
        if (tiff.is_imagej or tiff.is_shaped) and tiff.series[0].size != page.size:
            raise InputError(f"{file}: holds several images", hint=_ONE_IMAGE)
        return read_page(file, page)


def read_page(file: Path, page: Any) -> NDArray[Any]:
    """Read a page of an open TIFF file as it lies there (see `orientation`)."""
    check_page(file, page)
    # Frames are read by several threads already.
    image = np.asarray(page.asarray(maxworkers=1))
    if page.axes == "SYX":
        image = np.moveaxis(image, 0, -1)
    return image


def check_page(file: Path, page: Any) -> None:
    """Refuse a page whose size, colours, axes or depth are not read, or which is not whole.

    Where strips or tiles are missing, tifffile would return zeros.
    """
    # A tile may be larger than the image.
    for shape in (page.shape, page.chunks):
        check_image_size(file, shape)
    if page.compression not in _COMPRESSIONS:
        hint = f"use one of {', '.join(dict.fromkeys(_COMPRESSIONS.values()))}, or PNG"
        raise InputError(f"{file}: compression {int(page.compression)} is not read", hint=hint)
    colours = int(page.photometric)
    if colours not in _PHOTOMETRIC:
        words = _REFUSED.get(colours, f"colours of kind {colours}")
        raise InputError(f"{file}: has {words}", hint="save it in grey, black as 0, or RGB")
    if page.axes not in ("YX", "YXS", "SYX"):
        raise InputError(f"{file}: has axes {page.axes}", hint="save one image a file")
    if page.bitspersample not in _BITS:
        hint = "save it with 8 or 16 bits"
        raise InputError(f"{file}: has {page.bitspersample} bits a value", hint=hint)
    counts, offsets = page.databytecounts, page.dataoffsets
    if not len(counts) == len(offsets) == math.prod(page.chunked):
        raise ValueError("strips are missing")
    if min(counts) < 1:
        raise ValueError("a strip of 0 bytes")
    size = file.stat().st_size
    if min(offsets) < 8 or any(o + n > size for o, n in zip(offsets, counts, strict=True)):
        raise ValueError("the file ends early")


def _read_pgm(file: Path) -> NDArray[Any]:
    """Read a binary portable graymap (P5), as machine vision cameras write them.

    A file of 12 bits says so by its largest level, 4095, and its levels stay as they are; other
    readers, Pillow among them, stretch them to 65535.
    """
    data = _content(file)
    if not data.startswith(b"P5"):
        raise ValueError("not a binary PGM file")
    # Three numbers must end within 64 KiB, comments included.
    header = re.match(b"P5" + 3 * _NUMBER, data[: 1 << 16])
    if header is None:
        raise ValueError("a header without width, height and largest level")
    (cols, rows, top), place = map(int, header.groups()), header.end()
    check_image_size(file, (rows, cols))
    if not 255 <= top <= 65535:
        raise ValueError(f"its white is {top}, not 255 or more, up to 65535")
    kind = np.dtype(np.uint8 if top < 256 else ">u2")
    # One white space stands between the header and the levels.
    content = data[place + 1 :]
    if not data[place : place + 1].isspace() or len(content) != rows * cols * kind.itemsize:
        raise ValueError("more or fewer levels than its header says")
    image = np.frombuffer(content, kind).reshape(rows, cols)
    if int(image.max()) > top:
        raise ValueError(f"a level above its largest one, {top}")
    return image.astype(kind.newbyteorder("="))


_READERS = {
    ".png": _read_png,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".npy": read_npy,
    ".jpg": _by_pillow(b"\xff\xd8\xff", "JPEG"),
    ".jpeg": _by_pillow(b"\xff\xd8\xff", "JPEG"),
    ".bmp": _by_pillow(b"BM", "BMP"),
    ".pgm": _read_pgm,
    ".exr": read_exr,
}


def as_stored(name: str, image: NDArray[Any]) -> NDArray[Any]:
    """Convert what a library read to a shape and type of `read_image`, or refuse it by name."""
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    if image.ndim == 3 and image.shape[-1] in (2, 4):
        opaque = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
        if (image[..., -1] != opaque).any():
            hint = "save the image without an alpha channel"
            raise InputError(f"{name}: is partly transparent", hint=hint)
        image = image[..., :-1]
    if image.ndim == 3 and image.shape[-1] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[-1] != 3) or image.size == 0:
        hint = "save one image a file, (rows, cols) or (rows, cols, 3)"
        raise InputError(f"{name}: holds an array of shape {image.shape}", hint=hint)
    if image.dtype.kind == "f":
        values = as_float32(image)
        if not np.isfinite(values).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            hint = "replace it, and mask the pixel if it is broken in every frame"
            raise InputError(f"{name}: the value at {at} is {image[at]}", hint=hint)
        return np.ascontiguousarray(values)
    wide = image.dtype.kind in "iu" and 1 < image.dtype.itemsize <= 4
    if wide and image.size and image.min() >= 0 and image.max() <= 65535:
        # Pillow and other programs keep some 16-bit images in other integers.
        return image.astype(np.uint16)
    if image.dtype.newbyteorder("=") not in (np.uint8, np.uint16):
        hint = "save it as uint8, uint16 or float32"
        raise InputError(f"{name}: holds {image.dtype} values", hint=hint)
    return np.ascontiguousarray(image, image.dtype.newbyteorder("="))
