"""16-bit colour PNG, which Pillow reads as 8 bit without a word and cannot write."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGB, _RGBA = 2, 6


def chunks(data: bytes) -> dict[bytes, bytes]:
    """The chunks of a PNG file by name, those of the same name joined (IDAT).

    Raises
    ------
    ValueError
        If the file is not a PNG file or ends early.
    """
    if not data.startswith(SIGNATURE):
        raise ValueError("not a PNG file")
    found: dict[bytes, bytes] = {}
    at = len(SIGNATURE)
    while at < len(data):
        if at + 8 > len(data):
            raise ValueError("the file ends early")
        length, name = struct.unpack(">I4s", data[at : at + 8])
        if at + 12 + length > len(data):
            raise ValueError("the file ends early")
        found[name] = found.get(name, b"") + data[at + 8 : at + 8 + length]
        at += 12 + length
        if name == b"IEND":
            return found
    raise ValueError("the file ends early")


def is_colour16(header: bytes) -> bool:
    """Whether the first 33 bytes of a PNG file announce 16-bit colour."""
    return header.startswith(SIGNATURE) and header[24] == 16 and header[25] in (_RGB, _RGBA)


def read(data: bytes) -> NDArray[np.uint16]:
    """Decode a 16-bit colour PNG file: (rows, cols, 3 or 4) uint16.

    Raises
    ------
    ValueError
        If the file is damaged or interlaced.
    """
    found = chunks(data)
    cols, rows, _, colour, _, _, interlaced = struct.unpack(">IIBBBBB", found[b"IHDR"])
    if interlaced:
        raise ValueError("interlaced 16-bit colour PNG is not supported")
    channels = 3 if colour == _RGB else 4
    try:
        raw = zlib.decompress(found.get(b"IDAT", b""))
    except zlib.error as error:
        raise ValueError(f"damaged pixel data: {error}") from error
    stride = 1 + cols * channels * 2
    if len(raw) != rows * stride:
        raise ValueError("damaged pixel data: its length does not fit")
    lines = np.frombuffer(raw, np.uint8).reshape(rows, stride)
    pixels = _unfilter(lines[:, 0], lines[:, 1:].reshape(rows, cols, channels * 2))
    return pixels.reshape(rows, cols, channels, 2).copy().view(">u2")[..., 0].astype(np.uint16)


def _unfilter(kind: NDArray[np.uint8], coded: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo the line filters (PNG specification, section 9): coded (rows, cols, bytes).

    A pixel needs the ones to its left, above, and above left, so all pixels of an antidiagonal
    are decoded at once.
    """
    rows, cols, depth = coded.shape
    if kind.max(initial=0) > 4:
        raise ValueError("damaged pixel data: unknown line filter")
    # One line and column of zeros before the image, as the specification asks.
    pixels = np.zeros((rows + 1, cols + 1, depth), np.int16)
    for diagonal in range(rows + cols - 1):
        r = np.arange(max(0, diagonal - cols + 1), min(rows, diagonal + 1))
        c = diagonal - r
        left, up, corner = pixels[r + 1, c], pixels[r, c + 1], pixels[r, c]
        estimate = left + up - corner
        to_left, to_up, to_corner = (np.abs(estimate - n) for n in (left, up, corner))
        paeth = np.where(
            (to_left <= to_up) & (to_left <= to_corner),
            left,
            np.where(to_up <= to_corner, up, corner),
        )
        choices = (np.zeros_like(left), left, up, (left + up) >> 1, paeth)
        predicted = np.choose(kind[r, None], choices)
        pixels[r + 1, c + 1] = (coded[r, c] + predicted) & 255
    return pixels[1:, 1:].astype(np.uint8)


def write(path: Path, image: NDArray[np.uint16]) -> None:
    """Write (rows, cols, 3) uint16 as a PNG file."""
    rows, cols, _ = image.shape
    lines = np.zeros((rows, 1 + cols * 6), np.uint8)
    lines[:, 1:] = image.astype(">u2").view(np.uint8).reshape(rows, -1)
    header = struct.pack(">IIBBBBB", cols, rows, 16, _RGB, 0, 0, 0)
    with path.open("wb") as file:
        file.write(SIGNATURE)
        for name, content in (
            (b"IHDR", header),
            (b"IDAT", zlib.compress(lines.tobytes(), 6)),
            (b"IEND", b""),
        ):
            file.write(struct.pack(">I", len(content)) + name + content)
            file.write(struct.pack(">I", zlib.crc32(name + content)))
