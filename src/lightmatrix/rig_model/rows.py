"""Light that varies along the camera's rows: rolling shutters in mains light, colour wheels."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


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
