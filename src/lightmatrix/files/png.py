"""PNG containers: chunks and checksums, which Pillow does not verify in pixel data."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6
CHANNELS = {GREY: 1, RGB: 3, PALETTE: 1, GREY_ALPHA: 2, RGBA: 4}
_DEPTHS = {
    GREY: (1, 2, 4, 8, 16),
    RGB: (8, 16),
    PALETTE: (1, 2, 4, 8),
    GREY_ALPHA: (8, 16),
    RGBA: (8, 16),
}
# The passes of interlaced files (PNG specification, section 8.2): first column, first row, steps.
_PASSES = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4)),
    *((0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
_INFLATED_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class Header:
    """What IHDR says.

    Parameters
    ----------
    rows, cols : int
        At least 1.
    bits : int
        Of a channel: 1, 2, 4, 8 or 16.
    colour : int
        GREY, RGB, PALETTE, GREY_ALPHA or RGBA.
    interlaced : bool
    """

    rows: int
    cols: int
    bits: int
    colour: int
    interlaced: bool

    @property
    def inflated_bytes(self) -> int:
        """Size of the pixel data once inflated: lines, each with the number of its filter."""
        if not self.interlaced:
            return self.rows * self._line_bytes(self.cols)
        total = 0
        for col, row, across, down in _PASSES:
            cols, rows = -(-(self.cols - col) // across), -(-(self.rows - row) // down)
            if cols > 0 and rows > 0:
                total += rows * self._line_bytes(cols)
        return total

    def _line_bytes(self, cols: int) -> int:
        return 1 + (cols * CHANNELS[self.colour] * self.bits + 7) // 8


def read_chunks(data: bytes) -> dict[bytes, bytes]:
    """The chunks of a PNG file by name, those of the same name joined (IDAT).

    Raises
    ------
    ValueError
        If the file is not a PNG file, ends early, or a checksum does not fit.
    """
    if not data.startswith(SIGNATURE):
        raise ValueError("not a PNG file")
    found: dict[bytes, list[memoryview]] = {}
    at, whole = len(SIGNATURE), memoryview(data)
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(whole[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise ValueError("a checksum does not fit")
        found.setdefault(name, []).append(whole[at + 8 : end])
        at = end + 4
        if name == b"IEND":
            return {name: b"".join(parts) for name, parts in found.items()}
    raise ValueError("the file ends early")


def read_header(chunks: dict[bytes, bytes]) -> Header:
    """What the file announces.

    Raises
    ------
    ValueError
        If IHDR is missing or says what PNG does not have.
    """
    content = chunks.get(b"IHDR", b"")
    if len(content) != 13:
        raise ValueError("no header")
    cols, rows, bits, colour, packing, filters, interlaced = struct.unpack(">IIBBBBB", content)
    known = bits in _DEPTHS.get(colour, ()) and (packing, filters) == (0, 0) and interlaced < 2
    if not known or rows < 1 or cols < 1:
        raise ValueError("a header that PNG does not have")
    return Header(rows, cols, bits, colour, bool(interlaced))


def inflate(packed: bytes, size: int) -> bytes:
    """Inflate pixel data of a known size, never more of it.

    Raises
    ------
    ValueError
        If it is damaged, its checksum does not fit, or it has another size.
    """
    stream = zlib.decompressobj()
    try:
        # With room for one byte more, so that the checksum behind the last one is read too.
        raw = stream.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(f"damaged pixel data: {error}") from error
    if len(raw) != size or not stream.eof:
        raise ValueError("damaged pixel data: its length does not fit")
    return raw


def verify_pixels(packed: bytes, size: int) -> None:
    """Check pixel data and its checksum as `inflate` does, without keeping it.

    Raises
    ------
    ValueError
        As for `inflate`.
    """
    stream, seen = zlib.decompressobj(), 0
    try:
        while not stream.eof and seen <= size:
            piece = stream.decompress(packed, _INFLATED_AT_ONCE)
            packed = stream.unconsumed_tail
            seen += len(piece)
            if not piece and not packed:
                break
    except zlib.error as error:
        raise ValueError(f"damaged pixel data: {error}") from error
    if seen != size or not stream.eof:
        raise ValueError("damaged pixel data: its length does not fit")


def verify_indices(pixels: NDArray[np.uint8], palette: bytes) -> None:
    """Check that every pixel of a palette image has a colour.

    Raises
    ------
    ValueError
        If an index lies beyond the palette, three bytes a colour.
    """
    count, top = len(palette) // 3, int(pixels.max(initial=0))
    if top >= count:
        raise ValueError(f"a pixel of colour {top}, but {count} colours")


def write_chunks(*chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG file of the given chunks (name, content), IEND included."""
    parts = [SIGNATURE]
    for name, content in (*chunks, (b"IEND", b"")):
        parts += [struct.pack(">I", len(content)), name, content]
        parts.append(struct.pack(">I", zlib.crc32(content, zlib.crc32(name))))
    return b"".join(parts)
