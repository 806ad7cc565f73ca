"""A projector that sharpens the picture that it is sent."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.crosstalk import neighbours
from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class Sharpening(Term):
    """The projector adds a times what a pixel differs from its neighbours, within black and white.

    Without the limits T would hold it. Black and white pixels cannot be sharpened.
    """

    name = "sharpening"
    between = (0, np.inf)

    def regressors(self, seen: Prediction) -> Array | None:
        if seen.sent.patterns.as_bits() is not None:
            return None
        # The change is not linear because of the limits: it is that of half its strength.
        half = 0.5
        return seen.under(lambda images, before: (_sharpened(images, half) - images) / half)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        amount = float(values[0])
        draft.patterns.append(lambda images, before: _sharpened(images, amount))

    def sentence(self, values: Array) -> str:
        return f"the projector sharpens its picture by {100 * values[0]:.0f} %"


def _sharpened(images: Array, amount: float) -> Array:
    return np.clip(images + amount * (images - neighbours(images).mean(axis=0)), 0, 1)
