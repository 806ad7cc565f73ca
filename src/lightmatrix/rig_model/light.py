"""Light that differs from frame to frame, or from row to row: lamps, room, mains, irises."""

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


def _waves(height: Array) -> Array:
    """A constant, and half a period to three over the picture's height, of places from 0 to 1."""
    return np.stack([np.cos(np.pi * number * height) for number in range(7)])


class Rows(Term):
    """The light of frame k varies over the camera's rows, as a sum of cosines."""

    name = "rows"
    advice = (
        "expose for whole periods of the mains and of the projector (1/50 or 1/60 s and "
        "multiples), or use a global shutter"
    )
    per_frame = True
    # The phase differs from frame to frame, so the mean of all frames is nearer to an even light
    # than the first frame.
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return _waves(seen.position[0]) * seen.predicted

    def take_out(self, values: Array, draft: Draft) -> None:
        rows = draft.capture.camera_shape[0]
        draft.profile = 1 + np.tensordot(_waves((np.arange(rows) + 0.5) / rows), values, (0, 0))

    def sentence(self, values: Array) -> str:
        waves = _waves((np.arange(100) + 0.5) / 100)
        amplitude = 100 * np.sqrt(2) * np.std(np.tensordot(waves, values, (0, 0)))
        return f"the light varied by {amplitude:.1f} % along the camera's rows (rolling shutter?)"
