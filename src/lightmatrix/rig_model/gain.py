"""Light that differs from frame to frame: an unsteady lamp, automatic exposure, mains."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


class Gain(Term):
    """Frame k has (1 + g_k) times the light."""

    name = "gain"
    per_frame = True

    def regressors(self, seen: Prediction) -> Array:
        return seen.predicted[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.gain = draft.gain * (1 + values[0])

    def added(self, values: Array, step: Array) -> Array:
        return (1 + values) * (1 + step) - 1

    def based(self, values: Array) -> Array:
        return (1 + values) / (1 + values[:, :1]) - 1

    def sentence(self, values: Array) -> str:
        gain = values[0]
        # One step that leaves a tenth of the variance is an exposure that was changed.
        steps = [
            gain[:k].var() * k + gain[k:].var() * (len(gain) - k) for k in range(1, len(gain))
        ]
        k = int(np.argmin(steps)) + 1
        if steps[k - 1] < 0.1 * gain.var() * len(gain):
            change = (1 + gain[k:].mean()) / (1 + gain[:k].mean()) - 1
            return f"the exposure changed by {100 * change:+.1f} % before frame {k}"
        return f"the light varied by {100 * deviation(values):.1f} % from frame to frame"
