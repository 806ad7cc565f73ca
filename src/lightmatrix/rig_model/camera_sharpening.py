"""A camera that sharpens its photographs, which leaves dark rings around bright places."""

from __future__ import annotations

import numpy as np

from lightmatrix.rig_model.prediction import MARGIN, Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class CameraSharpening(Term):
    """A photograph holds a times what a pixel differs from its four neighbours."""

    name = "camera-sharpening"
    between = (0, np.inf)
    # T itself errs by this much of what neighbours differ in.
    least = 0.03

    def regressors(self, seen: Prediction) -> Array:
        return seen.inner(_ring(seen.around))[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.images.append(lambda images, places: float(values[0]) * _ring(images))

    def sentence(self, values: Array) -> str:
        return f"the camera sharpens its photographs by {100 * values[0]:.0f} %"


def _ring(images: Array) -> Array:
    """What images (n, rows, cols, ...) differ by from their neighbours, without margins."""
    inner = slice(MARGIN, -MARGIN)
    before, after = slice(MARGIN - 1, -MARGIN - 1), slice(MARGIN + 1, 1 - MARGIN)
    around = images[:, before, inner] + images[:, after, inner]
    around = around + images[:, inner, before] + images[:, inner, after]
    return np.asarray(images[:, inner, inner] - around / 4)
