"""Levels that are not the light: undeclared curves, tone mapping, a wrong black frame."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.found_response import raised, with_response
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.rig_model.prediction import INNER, Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class ProjectorCurve(Term):
    """The projector's light is the grey value to the power 1 + c."""

    name = "projector-curve"
    advice = (
        'use black and white patterns; or projector_response="auto", which finds the curve, '
        "or measure it"
    )

    def regressors(self, seen: Prediction) -> Array | None:
        if seen.sent.patterns.as_bits() is not None:
            return None

        return seen.under(lambda images, before: images * np.log(np.maximum(images, 1e-9)))[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        power = 1 + float(values[0])
        draft.patterns.append(lambda images, before: images**power)

    def sentence(self, values: Array) -> str:
        return f"the projector has a gamma of {1 + values[0]:.2f} that is not declared"


def bent_light(seen: Prediction, bend: Callable[[Array], Array]) -> Array:
    """What samples change by where a camera adds bends of its light, (bends, m, K).

    `bend` gives them for light as a share of full light.
    """
    decoder = seen.capture.decoder
    full = decoder.response.linearise(np.asarray(decoder.clip) / decoder.full_scale)
    dark = decoder.response.linearise(np.asarray(decoder.black_level) / decoder.full_scale)
    unit = seen.capture.exposures * np.max(full - dark)
    # Half a step of 8 bits is the faintest light whose logarithm is trusted.
    light = np.clip(seen.predicted * unit + np.min(dark), 0.002, None)
    return np.asarray(-bend(light) / unit)


class CameraCurve(Term):
    """Light is the stated light to the power 1 + c."""

    name = "camera-curve"
    advice = (
        'take raw files, or turn gamma, contrast and tone curves off; or use response="auto", '
        "which finds the curve, or measure it"
    )

    def regressors(self, seen: Prediction) -> Array:
        return bent_light(seen, lambda light: (light * np.log(light))[None])

    def take_out(self, values: Array, draft: Draft) -> None:
        response = raised(draft.capture.decoder.response, 1 + float(values[0]))
        draft.capture = with_response(draft.capture, response)

    def added(self, values: Array, step: Array) -> Array:
        return (1 + values) * (1 + step) - 1

    def sentence(self, values: Array) -> str:
        return f"the camera's levels have a gamma of {1 + values[0]:.2f} that is not declared"


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
        around = scipy.ndimage.gaussian_filter(right, (radius, radius, 0), mode="nearest")
        # A hundredth of the mean is the faintest light whose logarithm is trusted.
        around = np.log(around.clip(0) / mean + 0.01)
        right = light * np.exp(power * around)
    centres = [(np.arange(n) + 0.5) * side / m for n, m in zip(light.shape, size, strict=False)]
    whole = scipy.interpolate.RegularGridInterpolator(
        centres, around, bounds_error=False, fill_value=None
    )
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


class Black(Term):
    """A share of the black frame is too much, (1,): all samples are too small by it.

    If it holds too little light, T takes the rest as diffuse light, which costs little.
    """

    name = "black"
    advice = (
        "take the black frame with the projector showing black, at the exposure of the others and "
        "in the same room light, or state its exposure"
    )

    def found(self, seen: Prediction) -> Array | None:
        """Light is never negative, so what pixels lack where they are dark tells the share."""
        if seen.capture.decoder.black_frame is None:
            return None
        # The light of the black frame is what it takes from the clip level.
        dark = np.mean(1 / seen.capture.exposures - seen.samples.clip_levels_of_all(), axis=1)
        missed = (seen.left**2).sum(axis=1) / np.maximum(seen.free, 1)
        level, scatter = seen.constants
        known = np.flatnonzero((seen.free >= 3) & (scatter > 0))
        if not known.size:
            return None
        # The noise of the black frame is in all samples of a row alike, so it is in the constant.
        weight = (1 / ((scatter + 1) * (missed + np.median(missed))))[known]
        level, dark = level[known], dark[known]
        # Groups of pixels that lie beside each other, since there are dark ones in some. That noise
        # is in `dark` with the opposite sign, so only sums of many pixels are compared.
        most, share = 0.0, 0.0
        for some in np.array_split(np.arange(len(known)), max(1, len(known) // 64)):
            total, light = (weight * dark)[some].sum(), (weight * level)[some].sum()
            off = weight[some] * (level[some] - light / weight[some].sum())
            error = np.sqrt(max(weight[some].sum(), (off**2).sum()))
            if total > 0:
                most, share = min((most, share), ((light + 4 * error) / total, -light / total))
        size = share * np.sqrt((dark**2).mean() / (seen.predicted**2).mean())
        return np.array([min(share, 0.99)]) if most < -0.02 and size > self.least else None

    def take_out(self, values: Array, draft: Draft) -> None:
        decoder = draft.capture.decoder
        stated = decoder.black_exposure or float(np.max(decoder.exposure))
        decoder = replace(decoder, black_exposure=stated / (1 - float(values[0])))
        draft.capture = replace(draft.capture, decoder=decoder)

    def sentence(self, values: Array) -> str:
        more = 100 * values[0] / (1 - values[0])
        return f"the black frame holds {more:.0f} % more light than the room gave the photographs"
