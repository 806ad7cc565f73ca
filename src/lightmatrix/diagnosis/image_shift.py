"""By how much one image of the surveyed samples is shifted against another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.survey import MARGIN, Survey

# Shifted images must be closer by 4 standard errors over the parts of the image, and by 15 %. The
# image has 6 x 6 parts. Chosen on simulated captures: `python -m benchmarks.frame_checks`.
_CERTAIN, _CLOSER = 4.0, 0.15
_PARTS = 6
# The parts with even numbers and those with odd ones must show the same shift to one pixel. Where
# an image has no outlines, each half shows another one by chance.
_HALVES_APART = 1

Shift = tuple[int, int]


def find_shift(
    survey: Survey, first: NDArray[np.float32], last: NDArray[np.float32]
) -> Shift | None:
    """By how many camera pixels (down, right) the last image (S,) is shifted; None if not."""
    before, after = (_outlines(image.reshape(survey.grid)) for image in (first, last))
    tiles, rows, cols, _ = survey.grid
    inner = (slice(None), slice(MARGIN, rows - MARGIN), slice(MARGIN, cols - MARGIN))
    parts = _parts((tiles, rows - 2 * MARGIN, cols - 2 * MARGIN))
    valid = survey.valid.reshape(survey.grid)[inner].all(axis=-1)
    reference = before[inner]

    def distances(shift: Shift) -> NDArray[np.float64]:
        down, right = MARGIN + shift[0], MARGIN + shift[1]
        moved = after[:, down : down + reference.shape[1], right : right + reference.shape[2]]
        difference = np.where(valid, ((moved - reference) ** 2).sum(axis=-1), 0)
        return np.asarray(np.bincount(parts.ravel(), difference.ravel()), np.float64)

    reach = range(-MARGIN, MARGIN + 1)
    by_shift = {shift: distances(shift) for shift in itertools.product(reach, reach)}
    best = _closest(by_shift, slice(None))
    halves = [_closest(by_shift, slice(start, None, 2)) for start in (0, 1)]
    if best == (0, 0) or np.ptp(halves, axis=0).max() > _HALVES_APART:
        return None
    gain = by_shift[0, 0] - by_shift[best]
    error = np.sqrt(len(gain) * gain.var(ddof=1)) if len(gain) > 1 else np.inf
    if gain.sum() < _CERTAIN * error or gain.sum() < _CLOSER * by_shift[0, 0].sum():
        return None
    return best


def _closest(distances: Mapping[Shift, NDArray[np.float64]], parts: slice) -> Shift:
    """The shift at which some parts of two images are closest."""
    return min(distances, key=lambda shift: float(distances[shift][parts].sum()))


def describe_shift(shift: Shift) -> str:
    """A shift in words."""
    down, right = shift
    words = []
    if down:
        words.append(f"{abs(down)} {'down' if down > 0 else 'up'}")
    if right:
        words.append(f"{abs(right)} {'right' if right > 0 else 'left'}")
    return f"about {np.hypot(*shift):.2g} camera pixels away ({', '.join(words)})"


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
