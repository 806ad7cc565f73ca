"""The level at which photographs clip, where that is not the end of the range of their files."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.frames import Frames, levels_at


class Pile(NamedTuple):
    """A raw level at which samples pile up, and the share of the samples that have it."""

    level: float
    share: float

    def __str__(self) -> str:
        return f"{100 * self.share:.2g} % of the samples are exactly {self.shown}"

    @property
    def shown(self) -> str:
        """The level as it is written in settings, in as many digits as single precision needs."""
        return str(np.float32(self.level)).removesuffix(".0")


def pile_of_frames(frames: Frames) -> Pile | None:
    """The pile of the samples of all frames, each of which is read once."""
    pixels = int(np.prod(frames.shape))
    chosen = np.random.default_rng(0).permutation(pixels)[: max(1, (1 << 22) // frames.count)]
    return find_pile(levels_at(frames, np.sort(chosen)))


def find_pile(raw: NDArray[Any]) -> Pile | None:
    """The highest raw level at which samples (S, K) pile up, as where a camera clips, if any.

    Unclipped samples are spread by texture and noise, so that a level occurs about as often as
    those below it. A few samples may lie above the pile, as those of hot pixels do.
    """
    # Four million samples show it.
    most = max(1, (1 << 22) // raw.shape[1])
    if len(raw) > most:
        raw = raw[np.random.default_rng(0).permutation(len(raw))[:most]]
    levels, sizes = np.unique(raw, return_counts=True)
    above = raw.size - np.cumsum(sizes)
    # A pile lies in the upper half of the range, with the eight levels below it, where they occur
    # at all. Where there are just a few levels, as without noise, every level is a pile.
    sizes_if_bright = np.where(levels > levels[-1] / 2, sizes, 0)
    for k in range(len(levels) - 1, 3, -1):
        near = sizes_if_bright[max(0, k - 8) : k].sum() / 8
        # Levels at which captures clipped occurred at least 21 times as often as those below them,
        # levels of unclipped captures at most 6.4 times.
        if sizes_if_bright[k] >= 12 * max(near, above[k], 1):
            return Pile(float(levels[k]), float(sizes[k] / raw.size))
    return None
