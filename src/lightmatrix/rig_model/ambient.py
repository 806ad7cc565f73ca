"""Room light that differs from frame to frame."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


class Ambient(Term):
    """All samples of frame k have a_k more light."""

    name = "ambient"
    advice = "shut out other light, and switch off what lights up by itself"
    per_frame = True

    def regressors(self, seen: Prediction) -> Array:
        return np.ones((1, *seen.predicted.shape))

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.ambient = draft.ambient + values[0]

    def sentence(self, values: Array) -> str:
        return f"the room's light varied by {100 * deviation(values):.1f} % of the clip level"
