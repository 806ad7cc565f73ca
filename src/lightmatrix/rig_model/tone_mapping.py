"""A camera that brightens what is dark around: tone mapping, and dynamic range modes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from lightmatrix.capture.capture import Capture
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.rig_model.prediction import INNER, Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


def _around(capture: Capture, power: float = 0.0) -> Callable[[Array], Array]:
    """The logarithm of the light around places over the frame's mean, (..., K) of (2, ...).

    `power` is that by which the photographs of the capture are brightened where it is dark around.
    """
    size = np.array(capture.camera_shape[:2])
    width = capture.rows // size[0]
    # Up to 64 x 64 cells tell it, since the surroundings are a sixteenth of the picture.
    side = -(-int(size.max()) // 64)
    cells = []
    for top in range(0, size[0], side):
        values = capture.samples(top * width, min(top + side, size[0]) * width).values
        strip = values.reshape(-1, size[1], width // size[1], capture.count).mean(axis=2)
        cells.append(block_mean(np.moveaxis(strip, -1, 0), (side, side)))
    light = right = np.moveaxis(np.concatenate(cells, axis=1), 0, -1)
    radius = max(light.shape[:2]) / 16
    # The light around is that of photographs that are right, which its gain tells in turn.
    for _ in range(6 if power else 1):
        # Black patterns may have none, or less than none by noise.
        mean = right.mean(axis=(0, 1))
        mean = np.maximum(mean, max(1e-3 * float(mean.mean()), 1e-12))
        around = gaussian_filter(right, (radius, radius, 0), mode="nearest").clip(0) / mean
        # A hundredth of the mean is the faintest light whose logarithm is trusted.
        around = np.log(around + 0.01)
        right = light * np.exp(power * around)
    centres = [(np.arange(n) + 0.5) * side / m for n, m in zip(light.shape, size, strict=False)]
    whole = RegularGridInterpolator(centres, around, bounds_error=False, fill_value=None)
    return lambda places: np.asarray(whole(np.moveaxis(places, 0, -1)))


class ToneMapping(Term):
    """Samples are their light by (s_k / mean)^-t, with the light s_k of frame k around them."""

    name = "tone-mapping"
    advice = "take raw files, or turn HDR, dynamic range and local contrast modes off"
    # On grey patterns of few pixels, T itself errs by two thirds of this.
    least = 0.012
    # Intact captures reach a power of 0.03, and one of a tenth costs T 0.02 to 0.03.
    between = (0.05, 1)

    def regressors(self, seen: Prediction) -> Array:
        return -(seen.predicted * _around(seen.capture)(seen.position[..., 0]))[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        around = _around(draft.capture, float(values[0]))

        def change(images: Array, places: Array, sign: int) -> Array:
            gain = np.exp(sign * values[0] * around(places))[:, :, None]
            return np.asarray(images[INNER] * (gain - 1))

        draft.images.append(lambda images, places: change(images, places, -1))
        draft.back.append(lambda missed, places: change(missed, places, 1))

    def sentence(self, values: Array) -> str:
        return f"the camera brightens what is dark around, by a power of {values[0]:.2f}"
