"""Whether the scene, the camera or the projector moved between frames.

The brightest that each camera pixel was in some of the frames hardly depends on which patterns they
showed. If that image lies elsewhere in the last third of the frames than in the first, something
has moved. How far is the shift at which the two agree best; when, the frame from which on the
camera pixels, followed by that shift, are predicted best.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.local import predict
from lightmatrix.diagnosis.outlines import agreed_shift, describe_shift
from lightmatrix.diagnosis.survey import MARGIN, Survey

_FEWEST_FRAMES = 9
# Rows that are followed, and while the shift is looked for.
_ROWS, _FEW_ROWS = 80, 30
# Rows that miss less than this share of their variance have not moved.
_STILL = 0.03
_PLACES = 24
# By how much followed rows must be predicted better (logarithm of the miss); in standard errors.
_BETTER, _CERTAIN = 0.15, 4.0
# Multiplications that looking for a shift without outlines may take; about ten seconds.
_WORK = 1e11


def check_motion(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """Whether frames are shifted against each other, from which one on and by how much.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Lively rows.
    doubted : (K,) bool
        Frames that are odd by themselves; nothing is learned from them.
    names : sequence of str
        What the frames are called.
    """
    if survey.count < _FEWEST_FRAMES or len(rows) < 20:
        return []
    rows = rows[:: max(1, len(rows) // _ROWS)]
    follow = _Follower(survey, rows, doubted)
    if float(np.median(follow.miss((0, 0), 0))) < np.log(_STILL):
        return []
    known = survey.statistics
    shift = agreed_shift(survey, known.first, known.last) or follow.likeliest_shift()
    start = None if shift is None else follow.moment(shift)
    if shift is None or start is None:
        return []
    return [
        Finding(
            "motion",
            tuple(range(start, survey.count)),
            f"from {names[start]} on, the image lies {describe_shift(shift)}",
            "fix camera, projector and scene, and take the capture again; or use the frames before "
            "or after it alone",
        )
    ]


class _Follower:
    """Rows followed by a shift from some frame on, and how well they are predicted then."""

    def __init__(self, survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_]) -> None:
        self.survey, self.rows, self.doubted = survey, rows, doubted
        self.here = survey.samples(rows)

    def miss(self, shift: tuple[int, int], start: int) -> NDArray[np.float64]:
        """What the predictions of each row miss, as logarithms, (m,)."""
        if shift == (0, 0):
            return np.log(predict(self.survey.patterns, self.here, doubted=self.doubted).miss)
        here, there = self.here, self.survey.samples(self.survey.neighbour(self.rows, shift))
        late = np.arange(self.survey.count) >= start
        level = [np.broadcast_to(each.clip_level, each.values.shape) for each in (here, there)]
        followed = Samples(
            np.where(late, there.values, here.values),
            np.where(late, there.clipped, here.clipped),
            np.where(late, level[1], level[0]),
        )
        return np.asarray(
            np.log(predict(self.survey.patterns, followed, doubted=self.doubted).miss)
        )

    def likeliest_shift(self) -> tuple[int, int] | None:
        """The shift that predicts best if it happened after a quarter, half or three of the frames.

        For scenes without outlines, such as a white wall; None where that would take too long.
        """
        reach = range(-MARGIN, MARGIN + 1)
        shifts = [shift for shift in itertools.product(reach, reach) if shift != (0, 0)]
        starts = [self.survey.count * part // 4 for part in (2, 1, 3)]
        once = 4 * min(_FEW_ROWS, len(self.rows)) * self.survey.count * self.survey.patterns.pixels
        if once * len(shifts) * len(starts) > _WORK:
            return None
        few = _Follower(
            self.survey, self.rows[:: max(1, len(self.rows) // _FEW_ROWS)], self.doubted
        )
        tried = {
            (shift, start): float(np.mean(few.miss(shift, start)))
            for start in starts
            for shift in shifts
        }
        return min(tried, key=tried.__getitem__)[0]

    def moment(self, shift: tuple[int, int]) -> int | None:
        """The first shifted frame; None if rows followed by the shift are predicted no better."""
        # Both sides must be more than the odd frame.
        first = max(3, self.survey.count // 10)
        last = self.survey.count - first
        step = max(1, (last - first) // _PLACES)
        tried = {k: float(np.mean(self.miss(shift, k))) for k in range(first, last + 1, step)}
        best = min(tried, key=tried.__getitem__)
        near = range(max(first, best - step), min(last, best + step) + 1)
        tried |= {k: float(np.mean(self.miss(shift, k))) for k in near if k not in tried}
        best = min(tried, key=tried.__getitem__)
        # Rows that stay where they are, on either end of the shift: one may just be better.
        still = np.minimum(self.miss((0, 0), 0), self.miss(shift, 0))
        gain = still - self.miss(shift, best)
        error = float(gain.std() / np.sqrt(len(gain)))
        certain = gain.mean() > _BETTER and gain.mean() > _CERTAIN * error
        return best if certain else None
