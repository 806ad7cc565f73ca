"""A camera, projector or scene that moves from frame to frame."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
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
