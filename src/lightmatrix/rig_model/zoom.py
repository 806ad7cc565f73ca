"""A picture that grows, shrinks or turns from frame to frame, as a lens that breathes shows it."""

from __future__ import annotations

from functools import partial

import numpy as np

from lightmatrix.rig_model.prediction import Prediction, slopes
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


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
