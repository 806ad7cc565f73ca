"""Light that varies along the camera's rows: a rolling shutter under mains light, a colour wheel."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term, deviation


class Rows(Term):
    """The light of frame k varies as a sine and a cosine over the camera's rows."""

    name = "rows"
    per_frame = True
    # The phase differs from frame to frame, so the mean of all frames is nearer to an even light
    # than the first frame.
    of_first_frame = False

    def _waves(self, height: Array) -> Array:
        return np.stack([np.sin(2 * np.pi * height), np.cos(2 * np.pi * height)])

    def regressors(self, seen: Prediction) -> Array:
        return self._waves(seen.height) * seen.predicted

    def take_out(self, values: Array, draft: Draft) -> None:
        rows = draft.capture.camera_shape[0]
        waves = self._waves((np.arange(rows)[:, None] + 0.5) / rows)
        draft.profile = 1 + (waves * values[:, None, :]).sum(axis=0)

    def sentence(self, values: Array) -> str:
        amplitude = 100 * deviation(values)
        return f"the light varied by {amplitude:.1f} % along the camera's rows (rolling shutter?)"
