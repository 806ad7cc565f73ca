"""What is looked at of a capture: all of small frames, tiles of large ones, every frame of both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.frames import CutFrames, Frames, levels_at
from lightmatrix.patterns.pattern_set import PatternSet

# Raw levels kept at once.
_MOST_LEVELS = 48 << 20
# JPEG's blocks; tiles of frames that are larger hold whole ones.
BLOCK = 8
_TILE = 4 * BLOCK
# How far from a camera pixel its neighbours are looked at.
MARGIN = 4
_CHUNK_SAMPLES = 1 << 22


@dataclass(frozen=True)
class Statistics:
    """Of each surveyed sample over the frames.

    Parameters
    ----------
    mean, spread, lowest, highest : (S,) float32
        Of the linear samples; spread is the standard deviation.
    clipped : (S,) float32
        Share of the frames in which the sample is clipped.
    first, last : (S,) float32
        Brightest sample of the first and of the last third of the frames.
    """

    mean: NDArray[np.float32]
    spread: NDArray[np.float32]
    lowest: NDArray[np.float32]
    highest: NDArray[np.float32]
    clipped: NDArray[np.float32]
    first: NDArray[np.float32]
    last: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Survey:
    """Raw levels of S camera samples in all K frames.

    Made by `take`.

    Parameters
    ----------
    patterns : PatternSet
        K patterns.
    decoder : Decoder
        Of the surveyed samples.
    raw : (S, K) uint8, uint16 or float32
        Raw levels.
    places : (S,) int64
        Which samples of a frame they are.
    grid : (tiles, rows, cols, channels)
        How they lie; S is the product.
    valid : (S,) bool
        Which of them count: not masked, and not clipped without light.
    """

    patterns: PatternSet
    decoder: Decoder
    raw: NDArray[Any]
    places: NDArray[np.int64]
    grid: tuple[int, int, int, int]
    valid: NDArray[np.bool_]

    @classmethod
    def take(
        cls,
        patterns: PatternSet,
        frames: Frames,
        decoder: Decoder,
        mask: NDArray[np.bool_] | None = None,
    ) -> Survey:
        """Read every frame once.

        Parameters
        ----------
        patterns : PatternSet
            K patterns.
        frames : Frames
            K frames.
        decoder : Decoder
            From raw levels to linear samples.
        mask : shape of a frame, bool, optional
            Which camera samples count.

        Raises
        ------
        InputError
            On a frame that cannot be read, or differs from the first in size or type.
        """
        places, grid = _places(frames.shape, _MOST_LEVELS // frames.count, _first_block(frames))
        raw = levels_at(frames, places)
        valid = np.ones(len(places), bool)
        if decoder.hot is not None:
            valid &= ~decoder.hot[places]
        if mask is not None:
            valid &= mask.reshape(-1)[places]
        if decoder.black_frame is not None:
            decoder = replace(decoder, black_frame=np.asarray(decoder.black_frame)[places])
        return cls(patterns, decoder, raw, places, grid, valid)

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.raw.shape[1]

    def select(self, frames: NDArray[np.integer], patterns: NDArray[np.integer]) -> Survey:
        """The survey of some frames, each with the pattern of the same place in the other list."""
        return replace(
            self,
            patterns=self.patterns.subset(patterns),
            decoder=self.decoder.select(frames),
            raw=self.raw[:, frames],
        )

    def samples(self, rows: NDArray[np.integer], response: Response | None = None) -> Samples:
        """Linear samples of the given rows of the survey, (m, K).

        Parameters
        ----------
        rows : (m,) int
            Rows of the survey.
        response : Response, optional
            Taken for the camera's; None means as the capture says.
        """
        return self._decoder(rows, response).decode(self.raw[rows])

    def _decoder(self, rows: NDArray[np.integer], response: Response | None) -> Decoder:
        decoder = self.decoder if response is None else replace(self.decoder, response=response)
        if decoder.black_frame is None:
            return decoder
        return replace(decoder, black_frame=np.asarray(decoder.black_frame)[rows])

    def chunks(self) -> Iterator[tuple[slice, Samples]]:
        """All samples, some rows at a time."""
        step = max(1, _CHUNK_SAMPLES // self.count)
        for start in range(0, len(self.raw), step):
            part = slice(start, min(start + step, len(self.raw)))
            yield part, self.samples(np.arange(part.start, part.stop))

    def some_frames(self, frames: NDArray[np.integer]) -> Iterator[tuple[slice, Samples]]:
        """All samples of some frames, some rows at a time."""
        part = replace(self, raw=self.raw[:, frames], decoder=self.decoder.select(frames))
        return part.chunks()

    def tiles(self) -> Iterator[tuple[int, Samples]]:
        """All samples as `capture.order` takes them: first row, and samples that count."""
        for part, tile in self.chunks():
            valid = self.valid[part, None]
            yield (
                part.start,
                replace(tile, values=tile.values * valid, clipped=tile.clipped & valid),
            )

    @cached_property
    def statistics(self) -> Statistics:
        """Means, extremes and clipping of every sample."""
        size = len(self.raw)
        found = [np.zeros(size, np.float32) for _ in range(7)]
        third = max(1, self.count // 3)
        for part, tile in self.chunks():
            values = tile.values
            some = (
                values.mean(axis=1),
                values.std(axis=1),
                values.min(axis=1),
                values.max(axis=1),
                tile.clipped.mean(axis=1),
                values[:, :third].max(axis=1),
                values[:, -third:].max(axis=1),
            )
            for whole, piece in zip(found, some, strict=True):
                whole[part] = piece
        return Statistics(*found)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Which samples have all neighbours up to `MARGIN` pixels away, (S,)."""
        inside = np.zeros(self.grid, bool)
        inside[:, MARGIN:-MARGIN, MARGIN:-MARGIN] = True
        return inside.ravel()

    def neighbour(self, rows: NDArray[np.integer], shift: tuple[int, int]) -> NDArray[np.integer]:
        """The rows of the survey that lie (down, right) of the given inner ones."""
        _, _, cols, channels = self.grid
        return np.asarray(rows + (shift[0] * cols + shift[1]) * channels)


def _first_block(frames: Frames) -> tuple[int, int]:
    """Row and column at which the first whole block of JPEG begins in frames that may be cut."""
    if not isinstance(frames, CutFrames):
        return 0, 0
    row, col = frames.region.corner
    return -row % BLOCK, -col % BLOCK


def _places(
    shape: tuple[int, ...], most: int, first: tuple[int, int]
) -> tuple[NDArray[np.int64], tuple[int, int, int, int]]:
    """Which samples of a frame are surveyed, and how they lie: evenly spread tiles."""
    rows, cols = shape[:2]
    channels = shape[2] if len(shape) == 3 else 1
    every = np.arange(rows * cols * channels).reshape(rows, cols, channels)
    if min(rows, cols) > _TILE + BLOCK:
        every = every[first[0] :, first[1] :]
        rows, cols = every.shape[:2]
    if every.size <= most or min(rows, cols) <= _TILE:
        return every.ravel(), (1, rows, cols, channels)
    tiles = max(1, most // (_TILE * _TILE * channels))
    down = max(1, min(rows // _TILE, round(np.sqrt(tiles * rows / cols))))
    right = max(1, min(cols // _TILE, tiles // down))
    tops = np.linspace(0, rows - _TILE, down).astype(int) // BLOCK * BLOCK
    lefts = np.linspace(0, cols - _TILE, right).astype(int) // BLOCK * BLOCK
    cut = [every[r : r + _TILE, c : c + _TILE] for r in tops for c in lefts]
    return np.concatenate([tile.ravel() for tile in cut]), (len(cut), _TILE, _TILE, channels)
