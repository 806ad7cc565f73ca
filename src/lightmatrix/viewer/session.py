"""What one window shows of a matrix that Python keeps, and what it has to be told."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import LightMatrixError
from lightmatrix.transport.sparse_rows import SparseRows
from lightmatrix.viewer.lights import Light
from lightmatrix.viewer.packed import Tiles, halves, packed, tile_values, tiles_above

# Messages of the page, as `line.js` writes them; nothing else is accepted.
#
# A message consists of numbers of 4 bytes, little endian, and perhaps levels of one byte: its kind,
# its own number, and what the kind needs.

_HEADER = struct.Struct("<II")
_RECTANGLE, _PLACE = struct.Struct("<IIII"), struct.Struct("<II")
HEADER_BYTES = _HEADER.size + _RECTANGLE.size


class MessageError(Exception):
    """Bytes that the page would not send."""


class MessageKind(IntEnum):
    """What a message asks for."""

    PAINT = 1
    ROW = 2
    COLUMN = 3
    COMPENSATE = 4


@dataclass(frozen=True, eq=False)
class Message:
    """What a message asks for: its kind, its number, a pixel, and levels (rows, cols)."""

    kind: MessageKind
    number: int
    # The pixel whose row or column is asked for, or the upper left one of the levels.
    row: int
    col: int
    # What is painted on the projector, or a picture that the camera is to see.
    levels: NDArray[np.uint8]


def parse(message: bytes, camera: tuple[int, int], projector: tuple[int, int]) -> Message:
    """A message of the page, checked against the sizes of camera and projector."""
    try:
        code, number = _HEADER.unpack_from(message)
        kind, rest = MessageKind(code), message[_HEADER.size :]
        if kind is MessageKind.COMPENSATE:
            return Message(kind, number, 0, 0, np.frombuffer(rest, np.uint8).reshape(camera))
        if kind is MessageKind.PAINT:
            row, col, *shape = _RECTANGLE.unpack_from(rest)
            levels = np.frombuffer(rest, np.uint8, offset=_RECTANGLE.size).reshape(shape)
        else:
            row, col = _PLACE.unpack(rest)
            levels = np.zeros((1, 1), np.uint8)
        size = camera if kind is MessageKind.ROW else projector
        if row + levels.shape[0] > size[0] or col + levels.shape[1] > size[1]:
            raise MessageError
    except (struct.error, ValueError) as error:
        raise MessageError from error
    return Message(kind, number, row, col, levels)


# A pattern that changes in more than this share of its pixels is relit as a whole.
_WHOLE = 1 / 16
# While the brush moves, parts that changed by less than this share of white wait. A quarter of what
# the page promises, and below what a screen with 8 bits shows.
_QUICK = 2.5e-4
# Then parts follow that are off by this share of their own light, as half precision is, or by this
# share of white.
_FINE, _FAINTEST = 1e-3, 1e-6
# Samples that change are sent with their places, which takes 6 bytes each, if they are less than
# this share of all. In a tile each takes 2.
_SCATTERED = 1 / 8
# Without a movement for so long, the brush rests.
REST_MILLISECONDS = 150
# Tiles of one message, of at most 512 KiB a channel, so that a stroke never waits for long.
_MOST_TILES = 64
# Computes the pattern for a picture: its levels and a few words.
PictureCompensator = Callable[[NDArray[np.uint8]], tuple[NDArray[np.uint8], str]]


class Session:
    """The pattern and the photograph of one window, and how much of it the window has.

    `light` is T, None if the page has it; `white` is the light that is shown as white.
    """

    def __init__(
        self,
        light: Light | None,
        white: float,
        camera: tuple[int, int],
        projector: tuple[int, int],
        compensator: PictureCompensator | None = None,
    ) -> None:
        self._camera, self._projector = camera, projector
        self._compensator = compensator
        self._painting = None if light is None else _Painting(light, white)

    @property
    def unfinished(self) -> bool:
        """Whether the window lacks parts of its photograph."""
        return self._painting is not None and self._painting.unfinished

    @property
    def patient(self) -> bool:
        """Whether these parts can wait until the brush rests."""
        return self._painting is not None and self._painting.resting

    def answer(self, message: Any) -> list[bytes]:
        """The answers to a message; raises MessageError if the page would not send it."""
        if not isinstance(message, bytes):
            raise MessageError
        asked = parse(message, self._camera, self._projector)
        try:
            if asked.kind is MessageKind.COMPENSATE:
                if self._compensator is None:
                    raise MessageError
                levels, words = self._compensator(asked.levels)
                header = {"kind": "pattern", "answers": asked.number, "words": words}
                return [packed(header, {"levels": levels})]
            if self._painting is None:
                raise MessageError
            paints = asked.kind is MessageKind.PAINT
            return self._painting.paint(asked) if paints else [self._painting.image(asked)]
        except LightMatrixError as error:
            words = error.message
            return [packed({"kind": "error", "answers": asked.number, "message": words}, {})]

    def finish(self) -> bytes | None:
        """The next part that the window lacks; None if there is none to send right now."""
        if self._painting is None:
            return None
        try:
            return self._painting.finish()
        except LightMatrixError as error:
            # Nothing more of this pattern is sent.
            self._painting.blocks, self._painting.unfinished = None, False
            return packed({"kind": "error", "answers": None, "message": error.message}, {})


class _Painting:
    """A pattern and its photograph."""

    def __init__(self, light: Light, white: float) -> None:
        matrix = light.matrix
        self._light, self._white = light, white
        self._levels = np.zeros(matrix.projector_shape, np.uint8)
        shape = (*matrix.camera_shape[:2], light.channels)
        # In double precision, as strokes are added for hours.
        self._photograph = np.zeros(shape, np.float64)
        # What the window has, as rounded on the way.
        self._sent = np.zeros(shape, np.float32)
        # The rows of T that a whole pattern still has to be relit with.
        self.blocks: Iterator[tuple[int, SparseRows]] | None = None
        self.unfinished = False
        # Whether what is missing is too faint to be seen while the brush moves.
        self.resting = False

    def paint(self, asked: Message) -> list[bytes]:
        """The photograph under the new levels, as far as it is quickly had."""
        rows, cols = asked.levels.shape
        window = self._levels[asked.row : asked.row + rows, asked.col : asked.col + cols]
        change = asked.levels.astype(np.float32) - window
        down, across = np.nonzero(change)
        window[...] = asked.levels
        self.unfinished = True
        self.resting = False
        if len(down) > _WHOLE * self._levels.size:
            # All of the pattern is relit, block by block.
            self.blocks = self._light.blocks()
            return [self._part([], asked.number)]
        pixels = (asked.row + down) * self._levels.shape[1] + asked.col + across
        light = self._light.columns(pixels, change[down, across] / 255)
        return self._add(light.ravel(), asked.number)

    def _add(self, light: NDArray[np.float32], number: int) -> list[bytes]:
        """Add light to the photograph; what the window is told of it at once."""
        photograph, sent = self._photograph.reshape(-1), self._sent.reshape(-1)
        lit = np.flatnonzero(light)
        photograph[lit] += light[lit]
        samples = lit[np.abs(photograph[lit] - sent[lit]) > _QUICK * self._white]
        # The rest waits until the brush rests.
        self.resting = True
        if len(samples) > _SCATTERED * len(photograph):
            tiles = tiles_above(np.abs(self._photograph - self._sent), _QUICK * self._white)
            # All of the tiles; the last message is the answer.
            cuts = range(0, max(1, len(tiles)), _MOST_TILES)
            return [
                self._part(tiles[k : k + _MOST_TILES], number if k == cuts[-1] else None)
                for k in cuts
            ]
        values, scale = halves(photograph[samples])
        sent[samples] = values.astype(np.float32) * np.float32(scale)
        header = {"kind": "samples", "answers": number, "scale": scale, "more": True}
        return [packed(header, {"samples": samples.astype(np.uint32), "values": values})]

    def image(self, asked: Message) -> bytes:
        """A row or column of T."""
        if asked.kind is MessageKind.ROW:
            image = self._light.row(asked.row, asked.col)[..., None]
        else:
            pixel = np.array([asked.row * self._levels.shape[1] + asked.col])
            image = self._light.columns(pixel, np.ones(1)).reshape(self._photograph.shape)
        tiles = tiles_above(np.abs(image), 0)
        values, scale = halves(tile_values(image, tiles))
        header = {"kind": "image", "answers": asked.number, "tiles": tiles, "scale": scale}
        return packed(header, {"values": values})

    def finish(self) -> bytes | None:
        """The next parts that the window lacks."""
        if self.blocks is not None:
            start, block = next(self.blocks, (0, None))
            if block is None:
                self.blocks = None
            else:
                # The levels of now: strokes since the pattern began count too.
                pattern = self._levels.ravel() / np.float32(255)
                light = block.coefficients @ pattern
                light += block.background @ (self._light.matrix.pooling @ pattern)
                self._photograph.reshape(-1)[start : start + block.count] = light
        missed = np.abs(self._photograph - self._sent) - _FINE * np.abs(self._photograph)
        tiles = tiles_above(missed, _FAINTEST * self._white)
        self.unfinished = self.blocks is not None or len(tiles) > _MOST_TILES
        if not tiles and self.unfinished:
            return None
        return self._part(tiles[:_MOST_TILES], None)

    def _part(self, tiles: Tiles, number: int | None) -> bytes:
        """A message with some tiles of the photograph."""
        values, scale = halves(tile_values(self._photograph, tiles))
        shown, place = values.astype(np.float32) * np.float32(scale), 0
        for top, left, rows, cols in tiles:
            window = self._sent[top : top + rows, left : left + cols]
            window[...] = shown[place : place + window.size].reshape(window.shape)
            place += window.size
        more = self.unfinished
        header = {"kind": "tiles", "answers": number, "tiles": tiles, "scale": scale, "more": more}
        return packed(header, {"values": values})
