"""Whether random grey patterns are light: the projector's curve bends them, as the camera's does.

Either curve alone may explain what does not add up, or both. The gamma of each is looked for under
the other's stated response; the one that predicts more of the photographs is taken, and the other
one is looked for again under it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.linearity import is_certain, response_finding
from lightmatrix.diagnosis.responses.bend import raised
from lightmatrix.diagnosis.responses.from_windows import WindowPower, power_from_windows
from lightmatrix.diagnosis.responses.greys_from_windows import gamma_from_windows, with_gamma
from lightmatrix.diagnosis.survey import Survey

_BOTH = "use --response auto and --projector-response auto, which find both gammas at once"


def check_grey_levels(survey: Survey, doubted: NDArray[np.bool_], *, steady: bool) -> list[Finding]:
    """Whether samples are linear in light, and patterns light, as the capture says.

    Nothing is learned from `doubted` frames (K,). `steady` is as in `check_linearity`.
    """
    camera = power_from_windows(survey, doubted)
    projector = gamma_from_windows(survey, doubted)
    if projector is None or (camera is not None and _missed(camera) < _missed(projector)):
        if camera is None or not is_certain(camera, survey.distinct_patterns, steady=steady):
            return []
        response = raised(survey.decoder.response, camera.power)
        read = replace(survey, decoder=replace(survey.decoder, response=response))
        other = gamma_from_windows(read, doubted)
        alone = response_finding(camera, survey.decoder.response.name)
    else:
        if not is_certain(projector, survey.distinct_patterns, steady=True):
            return []
        other = power_from_windows(with_gamma(survey, projector.power), doubted)
        alone = _projector_finding(projector)
    if other is None or not is_certain(other, survey.distinct_patterns, steady=steady):
        return [alone]
    return [
        Finding("response", (), "the photographs are not linear in light", _BOTH),
        Finding("projector", (), "the patterns' grey values are not proportional to light", _BOTH),
    ]


def _missed(found: WindowPower) -> float:
    """The share of the variance that predictions miss; all of it if the search did not settle."""
    return found.missed[1] if found.settled else 1.0


def _projector_finding(found: WindowPower) -> Finding:
    uncertainty = max(2 * found.error * found.power, 0.01)
    return Finding(
        "projector",
        (),
        "the patterns' grey values are not proportional to light: the projector seems to have a "
        f"gamma of {found.power:.2f} +- {uncertainty:.2f}",
        "use --projector-response auto, or measure its curve with `lightmatrix response "
        "--projector`",
    )
