"""Light of another picture: a slow panel, the lag of a camera, a late refresh."""

from __future__ import annotations

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.check.prediction import best_pixels, column_scale
from lightmatrix.rig_model.prediction import Prediction, samples_of_rows
from lightmatrix.rig_model.term import Array, Draft, Term


class Previous(Term):
    """Each photograph holds a share a of the pattern before its own."""

    name = "previous"
    advice = "wait longer after each change of pattern (`lightmatrix rig settle` measures how long)"
    between = (0, 1)

    def regressors(self, seen: Prediction) -> Array:
        return seen.under(lambda images, before: before - images)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        share = float(values[0])
        draft.patterns.append(lambda images, before: (1 - share) * images + share * before)

    def added(self, values: Array, step: Array) -> Array:
        # T has taken on the light of the pattern itself, 1 - a of what it should be.
        return values + step / (1 + step)

    def sentence(self, values: Array) -> str:
        return f"each photograph shows {100 * values[0]:.1f} % of the picture before it"


# The picture is looked at in up to this many bands of rows, of each 32 of its camera pixels.
_BANDS, _PIXELS = 64, 32


class Torn(Term):
    """Each camera row shows the pattern of this many frames before: -1, 0 or 1, (1, rows)."""

    name = "torn"
    label = "previous"
    advice = Previous.advice

    def found(self, seen: Prediction) -> Array | None:
        """A band of rows is late if most of its pixels follow a projector pixel better then.

        Half of all bands are in order. T is not asked, since it is wrong.
        """
        capture = seen.capture
        rows, cols = capture.camera_shape[0], int(np.prod(capture.camera_shape[1:]))
        if capture.count < 12:
            return None
        bands = np.array_split(np.arange(rows), min(rows, _BANDS))
        draw = np.random.default_rng(0)
        chosen = np.stack(
            [draw.choice(band, _PIXELS) * cols + draw.integers(0, cols, _PIXELS) for band in bands]
        )
        samples = samples_of_rows(capture, chosen.ravel())
        follow = np.stack([_followed(capture, samples.values, late) for late in (-1, 0, 1)])
        follow = follow.reshape(3, len(bands), _PIXELS)
        # Dark pixels follow nothing, and tell nothing.
        lit = follow.max(axis=0) > 0.8
        better = (follow - follow[1] > 0.1) & lit
        share = better.sum(axis=2) / np.maximum(lit.sum(axis=1), 1)
        late = np.where(lit.sum(axis=1) >= _PIXELS // 4, share, 0) > 0.8
        found = np.where(late[2], 1.0, np.where(late[0], -1.0, 0.0))
        if not found.any() or np.mean(found != 0) > 0.5:
            return None
        # A band of dark pixels between late ones is late, too.
        known = np.flatnonzero((lit.sum(axis=1) >= _PIXELS // 4) | (found != 0))
        nearest = known[np.abs(np.arange(len(bands))[:, None] - known).argmin(axis=1)]
        return np.repeat(found[nearest], [len(band) for band in bands])[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.lag = np.rint(values[0]).astype(np.int64)

    def sentence(self, values: Array) -> str:
        share = 100 * np.mean(values[0] != 0)
        return f"{share:.0f} % of the camera's rows show the pattern of another frame"


def _followed(capture: Capture, values: Array, late: int) -> Array:
    """The correlation of samples (m, K), read `late` frames later, with their best pixel, (m,)."""
    count = capture.count
    patterns = np.arange(max(0, -late), count - max(0, late))
    shown = capture.patterns.subset(patterns)
    read = _scaled(values[:, patterns + late])
    pixels = best_pixels(shown, column_scale(shown), read)
    return np.asarray((_scaled(shown.columns(pixels).T.astype(np.float64)) * read).sum(axis=1))


def _scaled(values: Array) -> Array:
    values = values - values.mean(axis=1, keepdims=True)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
