"""Inflating zlib data of a known size: never more than that, and with its checksum."""

from __future__ import annotations

import zlib

# Bytes that are inflated at once where only their number is of interest.
_AT_ONCE = 1 << 20


def inflate(packed: bytes, size: int) -> bytes:
    """Inflate pixel data; a ValueError says if it is damaged or has another size."""
    stream = zlib.decompressobj()
    try:
        # Room for one byte more, so that the checksum behind the last byte is read too.
        raw = stream.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(f"damaged pixel data: {error}") from error
    if len(raw) != size or not stream.eof:
        raise ValueError("damaged pixel data: its length does not fit")
    return raw


def inflated_size(packed: bytes, most: int) -> int:
    """The size of pixel data once inflated, not kept; a ValueError above `most` or if damaged."""
    stream, seen = zlib.decompressobj(), 0
    try:
        while not stream.eof and seen <= most:
            piece = stream.decompress(packed, _AT_ONCE)
            packed = stream.unconsumed_tail
            seen += len(piece)
            if not piece and not packed:
                break
    except zlib.error as error:
        raise ValueError(f"damaged pixel data: {error}") from error
    if seen > most or not stream.eof:
        raise ValueError("damaged pixel data: its length does not fit")
    return seen
