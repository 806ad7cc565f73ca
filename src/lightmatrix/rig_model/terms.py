"""All terms, in the order in which they are taken out of the patterns and of the photographs.

Those of pixels that change with their neighbours stand here: crosstalk, unsharp masks, a blurred
camera.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.rig_model import frames
from lightmatrix.rig_model.levels import Black, CameraCurve, ProjectorCurve, ToneMapping
from lightmatrix.rig_model.prediction import INNER, MARGIN, Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


def neighbours(images: Array) -> Array:
    """Means of the left and right, and of the upper and lower neighbours, (2, n, rows, cols)."""
    padded = np.pad(images, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across = (padded[:, 1:-1, :-2] + padded[:, 1:-1, 2:]) / 2
    down = (padded[:, :-2, 1:-1] + padded[:, 2:, 1:-1]) / 2
    return np.stack([across, down])


class Crosstalk(Term):
    """A pixel loses a share of its light for each dark neighbour: p (1 - sum_j a_j (1 - n_j))."""

    name = "crosstalk"
    advice = "use patterns of larger pixels"
    # On grey patterns, T itself errs by about half of this.
    least = 0.01
    between = (0, 1)

    def regressors(self, seen: Prediction) -> Array:
        def lost(images: Array, before: Array, side: int) -> Array:
            return -images * (1 - neighbours(images)[side])

        return np.stack([seen.under(partial(lost, side=side)) for side in (0, 1)])

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.patterns.append(
            lambda images, before: images * (1 - np.tensordot(values, 1 - neighbours(images), 1))
        )

    def sentence(self, values: Array) -> str:
        return f"a projector pixel between dark ones loses {100 * values.sum():.0f} % of its light"


# The four pixels beside a pixel, at its corners, and two away, by the squares of their distances.
# Unsharp masks of a radius of about a pixel are sums of these three rings.
_SQUARES = np.arange(-2, 3) ** 2
_RINGS = np.stack([np.add.outer(_SQUARES, _SQUARES) == square for square in (1, 2, 4)]) / 4


def _differences(images: NDArray[Any]) -> NDArray[Any]:
    """What images (n, rows, cols, ...) differ by from each ring around a pixel, (3, n, ...)."""
    rings = _RINGS.reshape(3, 1, 5, 5, *[1] * (images.ndim - 3))
    around = [scipy.ndimage.correlate(images, ring, mode="nearest") for ring in rings]
    return images - np.stack(around)


class Sharpening(Term):
    """The projector adds what a pixel differs from those around it, within black and white.

    Without the limits T would hold it. Black and white pixels cannot be sharpened.
    """

    name = "sharpening"
    advice = (
        "set the projector's sharpness to 0, use its native resolution, or black and white patterns"
    )
    between = (0, np.inf)

    def regressors(self, seen: Prediction) -> Array | None:
        if seen.sent.patterns.as_bits() is not None:
            return None

        def changed(images: Array, before: Array, ring: int) -> Array:
            # The change is not linear because of the limits: it is that of half its strength.
            return np.asarray(2 * (_sharpened(images, np.eye(3)[ring] / 2) - images))

        return np.stack([seen.under(partial(changed, ring=ring)) for ring in range(3)])

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.patterns.append(lambda images, before: _sharpened(images, values))

    def sentence(self, values: Array) -> str:
        return f"the projector sharpens its picture by {100 * values.sum():.0f} %"


class CameraSharpening(Term):
    """The camera adds what a pixel differs from those around it, and ends at black."""

    name = "camera-sharpening"
    advice = "take raw files, or set the camera's sharpness to 0"
    between = (0, np.inf)
    # T itself errs by this much of what neighbours differ in.
    least = 0.03

    def regressors(self, seen: Prediction) -> Array:
        images = seen.around[INNER]
        rings = _differences(seen.around)[:, :, MARGIN:-MARGIN, MARGIN:-MARGIN]
        # As above: no photograph is darker than black.
        return np.stack([seen.inner(2 * (np.maximum(images + r / 2, 0) - images)) for r in rings])

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.images.append(
            lambda images, places: np.tensordot(values, _differences(images), 1)[INNER]
        )

    def sentence(self, values: Array) -> str:
        return f"the camera sharpens its photographs by {100 * values.sum():.0f} %"


class CameraBlur(Term):
    """The camera is out of focus; `estimators/defocused.py` finds the blur together with T."""

    name = "camera-blur"
    advice = "focus the camera on the scene, or close its aperture"

    def take_out(self, values: Array, draft: Draft) -> None:
        pass

    def sentence(self, values: Array) -> str:
        return f"the camera is out of focus by {values[0]:.1f} of its pixels"


def _sharpened(images: Array, amounts: Array) -> Array:
    return np.clip(images + np.tensordot(amounts, _differences(images), 1), 0, 1)


TERMS: dict[str, type[Term]] = {
    each.name: each
    for each in (
        ProjectorCurve,
        Sharpening,
        Crosstalk,
        frames.Previous,
        CameraSharpening,
        frames.Shift,
        frames.Zoom,
        frames.DynamicContrast,
        frames.Gain,
        frames.Rows,
        frames.Ambient,
        ToneMapping,
        CameraCurve,
        Black,
        frames.Torn,
        CameraBlur,
    )
}


def allowed_terms(names: Sequence[str]) -> tuple[str, ...] | None:
    """The terms of some names that a user may give; None if one of them is no name."""
    names = ["gain" if name == "exposure" else name for name in names]
    found = {name for name, term in TERMS.items() if name in names or term.label in names}
    known = found | {TERMS[name].label for name in found}
    return tuple(name for name in TERMS if name in found) if set(names) <= known else None
