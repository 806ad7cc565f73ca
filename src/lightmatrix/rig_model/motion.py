"""A picture that moves, grows or turns from frame to frame: soft stands, lenses that breathe."""

from __future__ import annotations

from functools import partial

import numpy as np

from lightmatrix.rig_model.prediction import Prediction, slopes
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


class Shift(Term):
    """The image of frame k lies d_k camera pixels (down, right) from where it was."""

    name = "shift"
    advice = "use a stiff stand, and let everything warm up"
    per_frame = True
    # T is that of the mean place, which is known best.
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return -seen.slopes

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.shift = values

    def added(self, values: Array, step: Array) -> Array:
        # T is blurred by what it swallowed, so that steps are too short, by shares that are alike.
        along = float((step * values).sum() / max((values**2).sum(), 1e-12))
        return values + step / (1 - min(max(along, 0.0), 0.6))

    def sentence(self, values: Array) -> str:
        # A creep is smooth: frames differ less from the next one than from all others.
        steps = np.diff(values, axis=1)
        if (steps**2).sum() < 0.4 * ((values - values.mean(axis=1)[:, None]) ** 2).sum():
            moved = float(np.hypot(*(values[:, -1] - values[:, 0])))
            return f"the picture crept by {moved:.2f} camera pixels in the course of the capture"
        return f"the picture shook by {deviation(values):.2f} camera pixels from frame to frame"


def _directions(position: Array) -> Array:
    """Where places (2, ...) move by a pixel at the border: (zoom and turn, down and right, ...)."""
    down, right = 2 * position - 1
    return np.stack([np.stack([down, right]), np.stack([-right, down])])


class Zoom(Term):
    """Frame k is larger by z_k pixels at the border of the picture, and turned by t_k."""

    name = "zoom"
    label = "shift"
    advice = "switch autofocus and stabilization off, and tape the rings of the lens"
    per_frame = True
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return -(_directions(seen.position) * seen.slopes).sum(axis=1)

    def take_out(self, values: Array, draft: Draft) -> None:
        def moved(images: Array, places: Array, sign: int) -> Array:
            directions = _directions(places)[..., None, None]
            change = 0.0
            for axis, (slope, bend) in enumerate(zip(*slopes(images), strict=True)):
                step = (directions[:, axis] * sign * values[:, None, None, None, :]).sum(axis=0)
                change = change + step**2 / 2 * bend - step * slope
            return np.asarray(change)

        draft.images.append(partial(moved, sign=1))
        draft.back.append(partial(moved, sign=-1))

    def sentence(self, values: Array) -> str:
        return f"the picture grew or turned by {deviation(values):.2f} camera pixels at its border"
