"""Images that Pillow decodes and encodes, as arrays."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def decode_image(source: bytes | Path, *, index: int = 0, mode: str | None = None) -> NDArray[Any]:
    """The pixels of an image, or of one of its pages, (rows, cols[, channels]).

    Palettes become colours, unless a mode of Pillow is named, such as "P" for the indices. Pillow
    may raise nearly anything if the image is damaged.
    """
    with Image.open(io.BytesIO(source) if isinstance(source, bytes) else source) as opened:
        opened.seek(index)
        image: Image.Image = opened
        if mode is not None:
            image = opened.convert(mode)
        elif opened.mode == "P" and opened.palette is not None:
            image = opened.convert(opened.palette.mode)
        elif opened.format == "PNG" and opened.mode == "I":
            # Older versions of Pillow read 16 bits as 32.
            image = opened.convert("I;16")
        return np.array(image)


def encode_image(pixels: NDArray[Any], kind: str, **options: Any) -> bytes:
    """An image as the bytes of a file of some kind, such as "png", with options of Pillow."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()
