"""The samples of a capture that the checks look at: all of small frames, tiles of large ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.frames import CutFrames, Frames, levels_at
from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.pattern_set import PatternSet

# A survey keeps at most 48 Mi raw levels (96 MiB of 16 bits), and decodes 4 Mi at a time.
_MOST_LEVELS, _CHUNK_SAMPLES = 48 << 20, 1 << 22
# JPEG codes blocks of 8 x 8 pixels; the tiles of large frames hold 4 x 4 whole blocks.
BLOCK = 8
_TILE = 4 * BLOCK
# Neighbours are looked at up to 4 pixels away; larger shifts between frames are not found.
MARGIN = 4
# Rows of high variance: their standard deviation exceeds 15 % of that of the most varied tenth, and
# they clip in few frames. Rows that clip in more frames are used only as long as there are too
# few others. 40 to 600 rows are wanted, as many as correlate with all projector pixels within 6e9
# multiplications (about half a second).
_VARIED = 0.15
_CLIPPED = (0.02, 0.1, 0.2, 0.3, 0.5)
_FEWEST_ROWS, _MOST_ROWS, _WORK = 40, 600, 6e9


@dataclass(frozen=True)
class Statistics:
    """Statistics of each surveyed linear sample over the frames, (S,) each.

    `spread` is the standard deviation, `clipped` the share of the frames in which the sample clips,
    `first` and `last` its maximum in the first and in the last third of the frames.
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
    """Raw levels of S camera samples in all K frames; `take` makes one."""

    patterns: PatternSet
    decoder: Decoder
    # Raw levels, (S, K) uint8, uint16 or float32.
    raw: NDArray[Any]
    # Tiles, rows, columns and channels; S is the product.
    grid: tuple[int, int, int, int]
    # Which samples count, (S,): not masked, and not clipped without light.
    valid: NDArray[np.bool_]

    @classmethod
    def take(
        cls,
        patterns: PatternSet,
        frames: Frames,
        decoder: Decoder,
        mask: NDArray[np.bool_] | None = None,
        share: float = 1,
    ) -> "Survey":
        """Read every frame once; an InputError names one that cannot be read or does not fit.

        `share` is that of the most levels which are kept.
        """
        most = int(share * _MOST_LEVELS) // frames.count
        # The first whole block of JPEG in frames that may be cut.
        row, col = frames.region.corner if isinstance(frames, CutFrames) else (0, 0)
        places, grid = _places(frames.shape, most, (-row % BLOCK, -col % BLOCK))
        raw = levels_at(frames, places)
        valid = np.ones(len(places), bool)
        if decoder.hot is not None:
            valid &= ~decoder.hot[places]
        if mask is not None:
            valid &= mask.reshape(-1)[places]
        if decoder.black_frame is not None:
            decoder = replace(decoder, black_frame=np.asarray(decoder.black_frame)[places])
        return cls(patterns, decoder, raw, grid, valid)

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.raw.shape[1]

    @property
    def one_level(self) -> float:
        """One raw level as a share of the clip level at the longest exposure; 1e-6 of floats."""
        decoder = self.decoder
        span = float(np.max(np.asarray(decoder.clip) - np.asarray(decoder.black_level)))
        longest = float(np.max(decoder.exposure))
        return 1 / (span * longest) if self.raw.dtype.kind == "u" else 1e-6 / longest

    def select_frames(self, frames: NDArray[np.integer]) -> "Survey":
        """The survey of some frames, in this order; the patterns stay."""
        return replace(self, decoder=self.decoder.select(frames), raw=self.raw[:, frames])

    def samples(self, rows: NDArray[np.integer]) -> Samples:
        """Linear samples of some rows of the survey, (m, K)."""
        decoder = self.decoder
        if decoder.black_frame is not None:
            decoder = replace(decoder, black_frame=np.asarray(decoder.black_frame)[rows])
        return decoder.decode(self.raw[rows])

    def chunks(self) -> Iterator[tuple[slice, Samples]]:
        """All samples, some rows at a time."""
        step = max(1, _CHUNK_SAMPLES // self.count)
        for start in range(0, len(self.raw), step):
            part = slice(start, min(start + step, len(self.raw)))
            yield part, self.samples(np.arange(part.start, part.stop))

    @cached_property
    def statistics(self) -> Statistics:
        """Mean, extremes, spread and clipping of every sample."""
        whole = np.zeros((7, len(self.raw)), np.float32)
        third = max(1, self.count // 3)
        for part, tile in self.chunks():
            values, clipped = tile.values, tile.clipped.mean(axis=1)
            ends = (values[:, :third].max(axis=1), values[:, -third:].max(axis=1))
            highest, lowest = values.max(axis=1), values.min(axis=1)
            usual = (values.mean(axis=1), values.std(axis=1))
            whole[:, part] = (*usual, lowest, highest, clipped, *ends)
        return Statistics(*whole)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Which samples have all neighbours up to `MARGIN` pixels away, (S,)."""
        inside = np.zeros(self.grid, bool)
        inside[:, MARGIN:-MARGIN, MARGIN:-MARGIN] = True
        return inside.ravel()


def high_variance_rows(survey: Survey) -> NDArray[np.int64]:
    """Rows that vary much and clip little, at random among equals; sorted, perhaps none."""
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.highest > known.lowest)
    if not usable.any():
        return np.empty(0, np.int64)
    work = survey.count * survey.patterns.pixels
    left = int(np.clip(_WORK / work, _FEWEST_ROWS, _MOST_ROWS))
    varied = usable & (known.spread > _VARIED * np.quantile(known.spread[usable], 0.9))
    generator = np.random.default_rng(0)
    chosen: list[NDArray[np.int64]] = []
    least = -1.0
    for most in _CLIPPED:
        rows = np.flatnonzero(varied & (known.clipped > least) & (known.clipped <= most))
        chosen.append(generator.permutation(rows)[:left])
        left, least = left - len(chosen[-1]), most
    return np.sort(np.concatenate(chosen))


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


def bright_mean(values: NDArray[np.floating]) -> float:
    """The mean of values (n,) weighted by themselves, to which few bright ones among dark count."""
    return float((values**2).sum()) / max(float(values.sum()), 1e-12)


def robust_deviation(values: NDArray[np.floating]) -> float:
    """The standard deviation of values (n,) by their median deviation, so that few count little."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def sums_by_group(values: NDArray[np.float64], group: NDArray[np.int64]) -> NDArray[np.float64]:
    """The sums (G, n) of the rows (m, n) whose number in `group` (m,) is the same."""
    sums = np.zeros((int(group.max(initial=0)) + 1, values.shape[1]))
    np.add.at(sums, group, values)
    return sums
