"""A projector or a camera whose levels are not proportional to light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lightmatrix.capture.found_response import raised, with_response
from lightmatrix.rig_model.prediction import Prediction
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

        def bent(images: Array, before: Array) -> Array:
            return images * np.log(np.maximum(images, 1e-9))

        return seen.under(bent)[None]

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
