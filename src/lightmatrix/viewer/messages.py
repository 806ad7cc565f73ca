"""Messages of the page, as `line.js` writes them; nothing else is accepted.

A message consists of numbers of 4 bytes, little endian, and perhaps levels of one byte: its kind,
its own number, and what the kind needs.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

_HEADER = struct.Struct("<II")
_RECTANGLE, _PLACE = struct.Struct("<IIII"), struct.Struct("<II")
HEADER_BYTES = _HEADER.size + _RECTANGLE.size


class MessageError(Exception):
    """Bytes that the page would not send."""


class Kind(IntEnum):
    """What a message asks for."""

    PAINT = 1
    ROW = 2
    COLUMN = 3
    COMPENSATE = 4


@dataclass(frozen=True, eq=False)
class Paint:
    """A rectangle of the pattern that has other levels now."""

    number: int
    top: int
    left: int
    # (rows, cols).
    levels: NDArray[np.uint8]


@dataclass(frozen=True)
class Ask:
    """A request for the row of a camera pixel, or the column of a projector pixel."""

    number: int
    kind: Kind
    row: int
    col: int


@dataclass(frozen=True, eq=False)
class Compensate:
    """A picture that the camera is to see, (rows, cols)."""

    number: int
    levels: NDArray[np.uint8]


def parse(
    message: bytes, camera: tuple[int, int], projector: tuple[int, int]
) -> Paint | Ask | Compensate:
    """A message of the page, checked against the sizes of camera and projector.

    Raises
    ------
    MessageError
        If it is none.
    """
    if len(message) < _HEADER.size:
        raise MessageError
    kind, number = _HEADER.unpack_from(message)
    rest = message[_HEADER.size :]
    if kind == Kind.PAINT:
        return _paint(number, rest, projector)
    if kind in (Kind.ROW, Kind.COLUMN):
        size = camera if kind == Kind.ROW else projector
        if len(rest) != _PLACE.size:
            raise MessageError
        row, col = _PLACE.unpack(rest)
        if row >= size[0] or col >= size[1]:
            raise MessageError
        return Ask(number, Kind(kind), row, col)
    if kind == Kind.COMPENSATE and len(rest) == camera[0] * camera[1]:
        return Compensate(number, np.frombuffer(rest, np.uint8).reshape(camera))
    raise MessageError


def _paint(number: int, rest: bytes, projector: tuple[int, int]) -> Paint:
    if len(rest) < _RECTANGLE.size:
        raise MessageError
    top, left, rows, cols = _RECTANGLE.unpack_from(rest)
    inside = top + rows <= projector[0] and left + cols <= projector[1]
    if not inside or len(rest) != _RECTANGLE.size + rows * cols:
        raise MessageError
    levels = np.frombuffer(rest, np.uint8, offset=_RECTANGLE.size).reshape(rows, cols)
    return Paint(number, top, left, levels)
