"""A projector whose light is not proportional to the patterns' grey values."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class ProjectorCurve(Term):
    """The projector's light is the grey value to the power 1 + c."""

    name = "projector-curve"
    advice = (
        'use black and white patterns; or projector_response="auto", which finds the curve, '
        "or measure it"
    )

    def regressors(self, seen: Prediction) -> Array | None:
        if seen.sent.patterns.as_bits() is not None:
            return None

        def bent(images: Array, before: Array) -> Array:
            return images * np.log(np.maximum(images, 1e-9))

        return seen.under(bent)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        power = 1 + float(values[0])
        draft.patterns.append(lambda images, before: images**power)

    def sentence(self, values: Array) -> str:
        return f"the projector has a gamma of {1 + values[0]:.2f} that is not declared"
