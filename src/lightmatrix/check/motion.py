"""Whether the scene, the camera or the projector moved between frames.

The brightest that each camera pixel was in a third of the frames hardly depends on their patterns.
If that image lies elsewhere in the last third than in the first, something has moved: by the shift
at which the two images agree best, and from the frame on from which camera pixels that are followed
by that shift are predicted best.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.samples import Samples
from lightmatrix.check.finding import Finding
from lightmatrix.check.prediction import predict
from lightmatrix.check.survey import MARGIN, Survey

# Followed rows must be predicted better by 4 standard errors, and shifted images be closer by as
# many. Chosen on simulated captures: `python -m benchmarks.frame_checks`.
_CERTAIN = 4.0
# An image has 6 x 6 parts, over which its standard error is taken.
_PARTS = 6

Displacement = tuple[int, int]


def check_motion(
    survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_], names: Sequence[str]
) -> list[Finding]:
    """Whether frames are shifted against each other, from which one on and by how much.

    `rows` are high-variance rows; nothing is learned from `doubted` frames (K,).
    """
    # Fewer frames have no thirds to compare, and fewer rows no reliable mean.
    if survey.count < 9 or len(rows) < 20:
        return []
    # More rows take longer.
    follower = _Follower(survey, rows[:: max(1, len(rows) // 80)], doubted)
    # If the predictions of half the rows miss less than 3 % of their variance, nothing has moved.
    if float(np.median(follower.miss())) < np.log(0.03):
        return []
    known = survey.statistics
    shift = find_shift(survey, known.first, known.last)
    start = None if shift is None else follower.first_shifted(shift)
    if shift is None or start is None:
        return []
    return [motion_finding(f"from {names[start]} on", start, shift, survey.count)]


def motion_finding(when: str, start: int, shift: Displacement, count: int) -> Finding:
    """The finding that frames from `start` on are shifted."""
    down, right = shift
    words = []
    if down:
        words.append(f"{abs(down)} {'down' if down > 0 else 'up'}")
    if right:
        words.append(f"{abs(right)} {'right' if right > 0 else 'left'}")
    message = f"{when}, the image lies about {np.hypot(*shift):.2g} camera pixels away"
    advice = (
        "fix camera, projector and scene, and take the capture again; or use the frames before or "
        "after it alone"
    )
    frames = tuple(range(start, count))
    slow = ", or drifted there" if np.hypot(*shift) < 1.5 else ""
    return Finding("motion", frames, f"{message} ({', '.join(words)}){slow}", advice)


class _Follower:
    """Rows followed by a shift from some frame on, and how well they are predicted then."""

    def __init__(self, survey: Survey, rows: NDArray[np.int64], doubted: NDArray[np.bool_]) -> None:
        self.survey, self.rows, self.doubted = survey, rows, doubted
        self.here = survey.samples(rows)

    def miss(self, shift: Displacement = (0, 0), start: int = 0) -> NDArray[np.float64]:
        """The logarithm of what the prediction of each followed row misses, (m,)."""
        samples = self.here
        if shift != (0, 0):
            _, _, cols, channels = self.survey.grid
            there = self.survey.samples(self.rows + (shift[0] * cols + shift[1]) * channels)
            late = np.arange(self.survey.count) >= start
            parts = (
                (each.values, each.clipped, each.clip_levels_of_all())
                for each in (there, self.here)
            )
            pairs = zip(*parts, strict=True)
            samples = Samples(*(np.where(late, moved, stayed) for moved, stayed in pairs))
        missed = predict(self.survey.patterns, samples, doubted=self.doubted).miss
        # Samples without noise may be predicted exactly.
        return np.asarray(np.log(np.maximum(missed, 1e-9)))

    def first_shifted(self, shift: Displacement) -> int | None:
        """The first shifted frame; None if rows followed by the shift are predicted no better."""
        # Either side must be more than an odd frame.
        first = max(3, self.survey.count // 10)
        last = self.survey.count - first
        # About 24 places, then frame by frame around the best.
        step = max(1, (last - first) // 24)
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
        certain = gain.mean() > max(0.15, _CERTAIN * error)
        return best if certain else None


def find_shift(
    survey: Survey, first: NDArray[np.float32], last: NDArray[np.float32]
) -> Displacement | None:
    """By how many camera pixels (down, right) the last image (S,) is shifted; None if not."""
    before, after = (_outlines(image.reshape(survey.grid)) for image in (first, last))
    tiles, rows, cols, _ = survey.grid
    inner = (slice(None), slice(MARGIN, rows - MARGIN), slice(MARGIN, cols - MARGIN))
    parts = _parts((tiles, rows - 2 * MARGIN, cols - 2 * MARGIN))
    valid = survey.valid.reshape(survey.grid)[inner].all(axis=-1)
    reference = before[inner]

    def distances(shift: Displacement) -> NDArray[np.float64]:
        down, right = MARGIN + shift[0], MARGIN + shift[1]
        moved = after[:, down : down + reference.shape[1], right : right + reference.shape[2]]
        difference = np.where(valid, ((moved - reference) ** 2).sum(axis=-1), 0)
        return np.asarray(np.bincount(parts.ravel(), difference.ravel()), np.float64)

    reach = range(-MARGIN, MARGIN + 1)
    by_shift = {shift: distances(shift) for shift in itertools.product(reach, reach)}
    best = _closest(by_shift, slice(None))
    halves = [_closest(by_shift, slice(start, None, 2)) for start in (0, 1)]
    # An image without outlines shows another shift in each half of its parts, by chance.
    if best == (0, 0) or np.ptp(halves, axis=0).max() > 1:
        return None
    gain = by_shift[0, 0] - by_shift[best]
    error = np.sqrt(len(gain) * gain.var(ddof=1)) if len(gain) > 1 else np.inf
    if gain.sum() < max(_CERTAIN * error, 0.15 * by_shift[0, 0].sum()):
        return None
    return best


def _closest(distances: Mapping[Displacement, NDArray[np.float64]], parts: slice) -> Displacement:
    """The shift at which some parts of two images are closest."""
    return min(distances, key=lambda shift: float(distances[shift][parts].sum()))


def _outlines(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """An image without its slow changes, so that light that changed is no motion."""
    image = np.sqrt(np.maximum(image, 0)).astype(np.float32)
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
