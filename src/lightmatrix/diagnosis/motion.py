"""Whether the scene, the camera or the projector moved between frames.

The brightest that each camera pixel was in a third of the frames hardly depends on their patterns.
If that image lies elsewhere in the last third than in the first, something has moved: by the shift
at which the two images agree best, and from the frame on from which camera pixels that are followed
by that shift are predicted best.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.image_shift import Shift, describe_shift, find_shift
from lightmatrix.diagnosis.prediction import predict
from lightmatrix.diagnosis.survey import MARGIN, Survey

# Fewer than 9 frames have no thirds to compare, and fewer than 20 rows no reliable mean.
_FEWEST_FRAMES, _FEWEST_ROWS = 9, 20
# About 80 rows are followed, about 30 while the shift is searched; more take longer.
_ROWS, _SEARCH_ROWS = 80, 30
# If the predictions of half the rows miss less than 3 % of their variance, nothing has moved.
_STILL = 0.03
# Samples without noise may be predicted exactly; less than this share counts as this.
_LEAST_MISS = 1e-9
# The frame of the motion is searched at about 24 places, then frame by frame around the best.
_PLACES = 24
# Followed rows must be predicted better by 0.15 (mean logarithm of the miss) and by 4 standard
# errors. Chosen on simulated captures: `python -m benchmarks.frame_checks`.
_BETTER, _CERTAIN = 0.15, 4.0
# A search for the shift without outlines may take 1e11 multiplications, about ten seconds.
_MOST_WORK = 1e11


def check_motion(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """Whether frames are shifted against each other, from which one on and by how much.

    `rows` are high-variance rows; nothing is learned from `doubted` frames (K,).
    """
    if survey.count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS:
        return []
    follower = _Follower(survey, rows[:: max(1, len(rows) // _ROWS)], doubted)
    if float(np.median(follower.miss())) < np.log(_STILL):
        return []
    known = survey.statistics
    shift = find_shift(survey, known.first, known.last) or follower.likeliest_shift()
    start = None if shift is None else follower.first_shifted(shift)
    if shift is None or start is None:
        return []
    return [motion_finding(f"from {names[start]} on", start, shift, survey.count)]


def motion_finding(when: str, start: int, shift: Shift, count: int) -> Finding:
    """The finding that frames from `start` on are shifted."""
    return Finding(
        "motion",
        tuple(range(start, count)),
        f"{when}, the image lies {describe_shift(shift)}",
        "fix camera, projector and scene, and take the capture again; or use the frames before or "
        "after it alone",
    )


class _Follower:
    """Rows followed by a shift from some frame on, and how well they are predicted then."""

    def __init__(self, survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_]) -> None:
        self.survey, self.rows, self.doubted = survey, rows, doubted
        self.here = survey.samples(rows)

    def miss(self, shift: Shift = (0, 0), start: int = 0) -> NDArray[np.float64]:
        """The logarithm of what the prediction of each followed row misses, (m,)."""
        samples = self.here
        if shift != (0, 0):
            there = self.survey.samples(self.survey.neighbour(self.rows, shift))
            late = np.arange(self.survey.count) >= start
            pairs = zip(_arrays(there), _arrays(self.here), strict=True)
            samples = Samples(*(np.where(late, moved, stayed) for moved, stayed in pairs))
        missed = predict(self.survey.patterns, samples, doubted=self.doubted).miss
        return np.asarray(np.log(np.maximum(missed, _LEAST_MISS)))

    def likeliest_shift(self) -> Shift | None:
        """The shift that predicts best if it happened after one, two or three quarters.

        It serves scenes without outlines, such as a white wall; None where it would take too long.
        """
        reach = range(-MARGIN, MARGIN + 1)
        shifts = [shift for shift in itertools.product(reach, reach) if shift != (0, 0)]
        starts = [self.survey.count * part // 4 for part in (2, 1, 3)]
        rows = self.rows[:: max(1, len(self.rows) // _SEARCH_ROWS)]
        work = 4 * min(_SEARCH_ROWS, len(self.rows)) * self.survey.count
        if work * self.survey.patterns.pixels * len(shifts) * len(starts) > _MOST_WORK:
            return None
        few = _Follower(self.survey, rows, self.doubted)
        misses = {
            (shift, start): float(np.mean(few.miss(shift, start)))
            for start in starts
            for shift in shifts
        }
        return min(misses, key=misses.__getitem__)[0]

    def first_shifted(self, shift: Shift) -> int | None:
        """The first shifted frame; None if rows followed by the shift are predicted no better."""
        # Either side must be more than an odd frame.
        first = max(3, self.survey.count // 10)
        last = self.survey.count - first
        step = max(1, (last - first) // _PLACES)
        misses = {k: float(np.mean(self.miss(shift, k))) for k in range(first, last + 1, step)}
        best = min(misses, key=misses.__getitem__)
        near = range(max(first, best - step), min(last, best + step) + 1)
        misses |= {k: float(np.mean(self.miss(shift, k))) for k in near if k not in misses}
        best = min(misses, key=misses.__getitem__)
        # Compared with rows that stay where they are, at either end of the shift: one of the two
        # may just be easier to predict.
        still = np.minimum(self.miss(), self.miss(shift))
        gain = still - self.miss(shift, best)
        error = float(gain.std() / np.sqrt(len(gain)))
        certain = gain.mean() > _BETTER and gain.mean() > _CERTAIN * error
        return best if certain else None


def _arrays(samples: Samples) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Values, clipping and clip level, (m, K) each."""
    level = np.broadcast_to(samples.clip_level, samples.values.shape)
    return samples.values, samples.clipped, level
