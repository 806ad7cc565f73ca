"""OpenEXR files: pictures in linear float, read and written by OpenEXR's own library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.reading import check_image_size

_COLOURS = ("R", "G", "B")
_ALPHA = "A"


def read_exr(file: Path) -> NDArray[Any]:
    """Read an unreduced one-part float picture: (rows, cols[, 2 to 4]) float16 or float32."""
    library = _library()
    with library.File(str(file), header_only=True) as opened:
        if len(opened.parts) != 1:
            raise InputError(
                f"{file}: holds {len(opened.parts)} parts", hint="save one image a file"
            )
        header = opened.header()
        names = _channel_order(file, [str(channel.name) for channel in header["channels"]])
        first, last = header["dataWindow"]
        cols, rows = (int(n) for n in last - first + 1)
        if any((a != b).any() for a, b in zip((first, last), header["displayWindow"], strict=True)):
            raise InputError(
                f"{file}: stores only a part of its picture, or more than it",
                hint="save it with a data window that is the display window",
            )
        check_image_size(file, (rows, cols, len(names)))
    with library.File(str(file), separate_channels=True) as opened:
        pixels = [np.array(opened.channels()[name].pixels) for name in names]
    for name, values in zip(names, pixels, strict=True):
        if values.shape != (rows, cols) or values.dtype.kind != "f":
            raise InputError(
                f"{file}: channel {name} holds {values.shape[0]} x {values.shape[-1]} values of "
                f"{values.dtype}, in a picture of {rows} x {cols}",
                hint="save all channels as half or float, none of them reduced",
            )
    return pixels[0] if len(pixels) == 1 else np.stack(pixels, axis=-1)


def write_exr(file: Path, pixels: NDArray[np.float32]) -> None:
    """Write an image, (rows, cols) or (rows, cols, 3), as 32-bit float without loss."""
    library = _library()
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    names = ("Y",) if pixels.ndim == 2 else _COLOURS
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    channels = {
        name: np.ascontiguousarray(planes[..., k], np.float32) for k, name in enumerate(names)
    }
    with library.File(header, channels) as made:
        made.write(str(file))


def _channel_order(file: Path, names: list[str]) -> list[str]:
    """The channels of a file in the order of an image."""
    colours = [name for name in names if name != _ALPHA]
    alpha = [_ALPHA] if _ALPHA in names else []
    if sorted(colours) == sorted(_COLOURS):
        return [*_COLOURS, *alpha]
    if len(colours) == 1:
        return [*colours, *alpha]
    raise InputError(
        f"{file}: has the channels {', '.join(names[:8])}", hint="save it in grey or RGB"
    )


def _library() -> Any:
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError(
            "EXR files need the OpenEXR library",
            hint='install the extra: pip install "lightmatrix[exr]"',
        ) from error
    return OpenEXR
