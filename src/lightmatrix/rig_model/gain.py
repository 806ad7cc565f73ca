"""Light that differs from frame to frame: an unsteady lamp, automatic exposure, mains."""

from __future__ import annotations

import numpy as np

from lightmatrix.check.finding import STEADY_LIGHT, odd_light
from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


class Gain(Term):
    """Frame k has (1 + g_k) times the light."""

    name = "gain"
    advice = STEADY_LIGHT
    per_frame = True

    def regressors(self, seen: Prediction) -> Array:
        return seen.predicted[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.gain = draft.gain * (1 + values[0])

    def added(self, values: Array, step: Array) -> Array:
        return (1 + values) * (1 + step) - 1

    def based(self, values: Array) -> Array:
        return (1 + values) / (1 + values[:, :1]) - 1

    def label_of(self, values: Array) -> str:
        return "gain" if _step(values[0]) is None else "exposure"

    def sentence(self, values: Array) -> str:
        k = _step(values[0])
        if k is None:
            usual = values[0] - np.median(values[0])
            odd = np.flatnonzero(np.abs(usual) > max(0.02, 6 * np.median(np.abs(usual))))
            if 0 < len(odd) <= 3:
                return odd_light({f"frame {j}": usual[j] for j in odd})
            return f"the light varied by {100 * deviation(values):.1f} % from frame to frame"
        change = (1 + values[0, k:].mean()) / (1 + values[0, :k].mean()) - 1
        return f"the exposure changed by {100 * change:+.1f} % before frame {k}"


def _step(gain: Array) -> int | None:
    """The frame before which the light changed once, if that leaves a tenth of its variance."""
    cuts = range(1, len(gain))
    left = [gain[:k].var() * k + gain[k:].var() * (len(gain) - k) for k in cuts]
    best = int(np.argmin(left))
    return best + 1 if left[best] < 0.1 * gain.var() * len(gain) else None
