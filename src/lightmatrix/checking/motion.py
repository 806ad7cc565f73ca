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
from lightmatrix.checking.finding import Finding
from lightmatrix.checking.local import predict
from lightmatrix.checking.survey import MARGIN, Survey

_FEWEST_FRAMES = 9
# How much closer the two images must be when shifted, in standard errors over parts of the image
# and as a share.
_CERTAIN, _CLOSER = 4.0, 0.15
_PARTS = 6
# Rows that are followed, and while the shift is looked for.
_ROWS, _FEW_ROWS = 80, 30
# Rows that miss less than this share of their variance have not moved.
_STILL = 0.03
_PLACES = 24
# Followed rows must be predicted better by this much (logarithm of the miss).
_BETTER = 0.15


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
    shift = _shift(survey) or follow.likeliest_shift()
    start = follow.moment(shift)
    if start is None:
        return []
    return [
        Finding(
            "motion",
            tuple(range(start, survey.count)),
            f"from {names[start]} on, the image lies about {np.hypot(*shift):.2g} camera pixels "
            f"away ({_direction(shift)})",
            "fix camera, projector and scene, and take the capture again; or use the frames before "
            "or after it alone",
        )
    ]


def _direction(shift: tuple[int, int]) -> str:
    down, right = shift
    words = []
    if down:
        words.append(f"{abs(down)} {'down' if down > 0 else 'up'}")
    if right:
        words.append(f"{abs(right)} {'right' if right > 0 else 'left'}")
    return ", ".join(words)


def _shift(survey: Survey) -> tuple[int, int] | None:
    """By how many camera pixels (down, right) the last third of the frames is shifted, if it is."""
    first, last = (_outlines(survey, image) for image in _brightest(survey))
    tiles, rows, cols, _ = survey.grid
    inner = (slice(None), slice(MARGIN, rows - MARGIN), slice(MARGIN, cols - MARGIN))
    parts = _parts((tiles, rows - 2 * MARGIN, cols - 2 * MARGIN))
    valid = survey.valid.reshape(survey.grid)[inner].all(axis=-1)

    def distances(shift: tuple[int, int]) -> NDArray[np.float64]:
        moved = np.roll(last, (-shift[0], -shift[1]), axis=(1, 2))
        difference = np.where(valid, ((moved - first)[inner] ** 2).sum(axis=-1), 0)
        return np.bincount(parts.ravel(), difference.ravel())

    reach = range(-MARGIN, MARGIN + 1)
    tried = {shift: distances(shift) for shift in itertools.product(reach, reach)}
    best = min(tried, key=lambda shift: float(tried[shift].sum()))
    if best == (0, 0):
        return None
    gain = tried[0, 0] - tried[best]
    error = np.sqrt(len(gain) * gain.var(ddof=1)) if len(gain) > 1 else np.inf
    if gain.sum() < _CERTAIN * error or gain.sum() < _CLOSER * tried[0, 0].sum():
        return None
    return best


def _brightest(survey: Survey) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    known = survey.statistics
    return known.first.reshape(survey.grid), known.last.reshape(survey.grid)


def _outlines(survey: Survey, image: NDArray[np.float32]) -> NDArray[np.float64]:
    """An image without its slow changes, so that light that changed is no motion."""
    image = np.sqrt(np.maximum(image, 0)).astype(np.float64)
    edges = np.stack(
        [np.roll(image, 1, axis) - np.roll(image, -1, axis) for axis in (1, 2)], axis=-1
    ).reshape(*image.shape[:3], -1)
    # No edge counts more than many others together.
    most = 4 * float(np.median(np.abs(edges))) + 0.02
    return np.asarray(np.clip(edges, -most, most))


def _parts(shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """Which part of the image each pixel lies in: tiles, or a grid over the only one."""
    tiles, rows, cols = shape
    if tiles >= _PARTS:
        part = np.arange(tiles) * _PARTS**2 // tiles
        return np.broadcast_to(part[:, None, None], shape).astype(np.int64)
    row = np.arange(rows) * _PARTS // rows
    col = np.arange(cols) * _PARTS // cols
    return np.broadcast_to(row[:, None] * _PARTS + col, shape).astype(np.int64)


class _Follower:
    """Rows followed by a shift from some frame on, and how well they are predicted then."""

    def __init__(
        self, survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_]
    ) -> None:
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
        return np.asarray(np.log(predict(self.survey.patterns, followed, doubted=self.doubted).miss))

    def likeliest_shift(self) -> tuple[int, int]:
        """The shift that predicts best if it happened after a quarter, half or three of the frames.

        For scenes without outlines, such as a white wall.
        """
        reach = range(-MARGIN, MARGIN + 1)
        shifts = [shift for shift in itertools.product(reach, reach) if shift != (0, 0)]
        starts = [self.survey.count * part // 4 for part in (2, 1, 3)]
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
