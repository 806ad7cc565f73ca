"""A projector whose lamp or iris follows how bright the picture is."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class DynamicContrast(Term):
    """The light is 1 + a times the pattern's mean, less that of the first pattern."""

    name = "dynamic-contrast"
    advice = "switch dynamic contrast, eco mode and iris off"
    between = (-1, 1)

    def _means(self, means: Array) -> Array:
        return means - means[0]

    def regressors(self, seen: Prediction) -> Array | None:
        # Patterns that are about as bright as each other tell nothing.
        if float(np.std(seen.sent.patterns.means)) < 0.02:
            return None
        return (self._means(seen.sent.patterns.means) * seen.predicted)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.gain = draft.gain * (1 + values[0] * self._means(draft.capture.patterns.means))

    def sentence(self, values: Array) -> str:
        change = f"{100 * values[0]:+.0f} % from black to white"
        return f"the projector's light follows its picture: {change}"
