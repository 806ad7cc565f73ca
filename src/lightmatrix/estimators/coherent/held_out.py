"""Which frames are held out of the last round, so that the others cannot predict them anyway.

A photograph of a pattern that was shown twice, or whose inverse was shown, follows from the others
whatever T is. Such frames are held out together. If that leaves too few others, nothing is tested.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.estimators.coherent.row_errors import held_out_frames
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import is_separable

# A held-out frame tests an estimate if the remaining patterns leave at least half as much of its
# contrast unexplained as they leave of a random pattern. Chosen on 60 small captures.
_NEW = 0.5
# At most a quarter of the frames is held out: the rows need the others. Chosen by hand.
_MOST = 4
# Frames are compared with all others. If there are more than this, only about so many are compared
# that are most like those to hold out, which bounds the time to a few seconds.
_COMPARED = 1024
# The contrast is computed from this many projector pixels, or from four for each frame.
_SAMPLED_PIXELS, _PIXELS_PER_FRAME = 4096, 4
# Patterns whose squared cosine exceeds this are the same, or inverses of each other.
_SAME = 0.99
# Pixels whose values, less the mean of their pattern, differ by less than this never vary. Patterns
# of one pixel each have means that differ by a pixel's share.
_VARIES = 0.1
# Contrasts below this share of the largest one are rounding.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The frames that are held out, and those among them by which the error is judged.

    A frame that repeats or inverts a judged one is held out with it; it adds no knowledge.
    """

    frames: NDArray[np.int64]
    judged: NDArray[np.int64]

    @classmethod
    def choose(cls, patterns: PatternSet, judged: int | None = None) -> HeldOut:
        """The frames to hold out of some patterns; none if they could test nothing.

        About every eighth frame is judged, or as few as `judged`, which is at least 2.
        """
        nothing = np.zeros(0, np.int64)
        usual = held_out_frames(patterns.count)
        # A code of stripes needs each of its bits, so nothing can be held out.
        if not len(usual) or is_separable(patterns):
            return cls(nothing, nothing)
        if judged is not None and judged < len(usual):
            usual = usual[np.linspace(0, len(usual) - 1, judged).astype(int)]
        values = _values(patterns)
        compared = _most_alike(values, usual)
        chosen = cls._among(values[compared], np.searchsorted(compared, usual))
        return cls(compared[chosen.frames], compared[chosen.judged])

    @classmethod
    def _among(cls, values: NDArray[np.float64], usual: NDArray[np.int64]) -> HeldOut:
        """The frames to hold out of centred patterns, (K, n), if these are the usual ones."""
        nothing = np.zeros(0, np.int64)
        gram, pixels = values @ values.T, values.shape[1]
        most = max(len(values) // _MOST, len(usual))
        firsts, groups = [int(k) for k in usual], dict[int, list[int]]()
        # Frames that were not held out in the end may explain others.
        while firsts != [*groups]:
            firsts = [*groups] or firsts
            groups = _complete(firsts, gram, pixels, len(usual), most)
            if not groups:
                break
        frames = np.unique(np.concatenate([nothing, *groups.values()]))
        judged = np.array(sorted(groups), np.int64)
        # One frame alone has no variance.
        if len(judged) < 2 or _show_only_their_own(values, frames, judged):
            return cls(nothing, nothing)
        return cls(frames, judged)


def _most_alike(values: NDArray[np.float64], usual: NDArray[np.int64]) -> NDArray[np.int64]:
    """The usual frames, and all others or those that are most like one of them, in order."""
    if len(values) <= _COMPARED:
        return np.arange(len(values))
    spread = np.linalg.norm(values, axis=1)
    cosines = np.abs(values @ values[usual].T) / np.maximum(spread[:, None] * spread[usual], 1e-300)
    each = _COMPARED // len(usual)
    nearest = np.argpartition(-cosines, each, axis=0)[:each]
    return np.union1d(nearest.ravel(), usual)


def _complete(
    firsts: list[int], gram: NDArray[np.float64], pixels: int, usual: int, most: int
) -> dict[int, list[int]]:
    """Groups of frames, each of the first with all that predict it; those that fit into `most`.

    They hold about as many frames as are usual, and are two at least.
    """
    contrast = np.diag(gram)
    least = _ROUNDING * contrast.max()
    complete: dict[int, list[int]] = {}
    others = [k for k in firsts if contrast[k] > least]
    while others and not _enough(complete, usual):
        first = others.pop(0)
        taken = [k for group in complete.values() for k in group]
        if first in taken:
            continue
        # Twins among the usual frames are one group.
        alike = gram[first, others] ** 2 > _SAME * contrast[first] * contrast[others]
        group = [first, *np.array(others, np.int64)[alike].tolist()]
        while len(taken) + len(group) <= most:
            # The frames still to come may be held out as well.
            rest = np.setdiff1d(np.arange(len(gram)), [*taken, *group, *others])
            share, strongest, rank = _unexplained(gram, first, rest)
            if share >= _NEW * (1 - rank / max(pixels - 1, 1)) - 1e-6:
                complete[first] = group
                break
            group.append(strongest)
    return complete


def _enough(groups: dict[int, list[int]], usual: int) -> bool:
    return len(groups) > 1 and sum(map(len, groups.values())) >= usual


def _unexplained(
    gram: NDArray[np.float64], frame: int, rest: NDArray[np.int64]
) -> tuple[float, int, int]:
    """The share of a frame's contrast that the rest leaves, what explains most, and their rank."""
    values, vectors = np.linalg.eigh(gram[np.ix_(rest, rest)])
    used = values > _ROUNDING * max(values[-1], 1e-300)
    across = gram[rest, frame]
    projected = vectors[:, used].T @ across
    explained = float((projected**2 / values[used]).sum())
    coefficients = vectors[:, used] @ (projected / values[used])
    weight = np.abs(coefficients) * np.sqrt(np.diag(gram)[rest])
    return 1 - explained / gram[frame, frame], int(rest[weight.argmax()]), int(used.sum())


def _show_only_their_own(
    values: NDArray[np.float64], frames: NDArray[np.int64], judged: NDArray[np.int64]
) -> bool:
    """Whether the contrast of frames is mostly in pixels that the frames not held out never vary.

    Then T is right where it is known, and nothing can be predicted: one pixel at a time, say.
    """
    rest = np.delete(values, frames, axis=0)
    off = (values[judged] - rest.mean(axis=0)) ** 2
    never = np.ptp(rest, axis=0) < _VARIES
    return bool(off[:, never].sum() > off.sum() / 2)


def _values(patterns: PatternSet) -> NDArray[np.float64]:
    """The patterns, each less its mean, at some pixels, (K, n)."""
    most = max(_SAMPLED_PIXELS, _PIXELS_PER_FRAME * patterns.count)
    pixels = np.sort(np.random.default_rng(0).permutation(patterns.pixels)[:most])
    values = patterns.columns(pixels).astype(np.float64)
    return np.asarray(values - values.mean(axis=1, keepdims=True))
