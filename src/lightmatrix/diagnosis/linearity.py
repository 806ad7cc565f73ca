"""Whether photographs are linear in light.

Light adds up, so what a camera pixel shows under several projector pixels is the sum of what it
shows under each, and can be predicted from its other frames. Photographs that were coded for a
display (sRGB, a gamma of 2.2) do not add up. `responses/` finds the power of the light under which
they do; `lm.find_response` finds the curve itself, with the help of an estimate of T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.responses.from_windows import WindowPower, power_from_windows
from lightmatrix.diagnosis.survey import Survey

# A power is announced if it differs from 1 by 2 % and by four standard errors more: where light is
# blurred, predictions from windows are off by up to two of them.
_ANNOUNCED, _CERTAIN = 0.02, 4.0
# Under 16 patterns, windows of 50 pixels explain anything: powers of linear captures were off by up
# to 0.1 under sharp light and 0.5 under broad light. The logarithm of a power gets a margin of 0.4
# at 16 patterns, which falls with the cube of their number. Less the 7 columns that are removed, a
# row has 9 samples left under 16 patterns. Rows that have as few left, as where many samples clip,
# get the same margin, which falls likewise: under 32 patterns with 7 samples left, powers of linear
# captures were off by up to 0.24. Chosen by hand.
_FEW_PATTERNS, _FEW_LEFT, _OFF_BY = 16, 9.0, 0.4
# Where predictions miss more than 10 % of the variance under every power, what they miss may look
# like a bend: the power must take a tenth of that away. Chosen on captures with and without curves
# (`benchmarks/synthetic_captures.py`).
_MUCH, _REMAINS = 0.1, 0.9


def check_linearity(survey: Survey, doubted: NDArray[np.bool_], *, steady: bool) -> list[Finding]:
    """Whether the samples, decoded as the capture says, are linear in light.

    Nothing is learned from `doubted` frames (K,). Powers below 1 are not announced if the light is
    not `steady`: its changes look like one.
    """
    found = power_from_windows(survey, doubted)
    if found is None or not is_certain(found, survey.distinct_patterns, steady=steady):
        return []
    return [response_finding(found, survey.decoder.response.name)]


def is_certain(found: WindowPower, count: int, *, steady: bool) -> bool:
    """Whether a power that was found under `count` distinct patterns certainly differs from 1."""
    if not found.settled:
        return False
    few = max(_FEW_PATTERNS / count, min(1.0, _FEW_LEFT / max(found.freedom, 1.0)))
    least = _ANNOUNCED + _CERTAIN * found.error + _OFF_BY * few**3
    before, after = found.missed
    if after > _MUCH and after > _REMAINS * before:
        return False
    return bool(abs(np.log(found.power)) >= least and (found.power > 1 or steady))


def response_finding(found: WindowPower, stated: str) -> Finding:
    """The finding of photographs that are not linear, decoded by the `stated` response."""
    power, uncertainty = found.power, max(2 * found.error * found.power, 0.01)
    if power < 1:
        return Finding(
            "response",
            (),
            f"the photographs are not linear in light, decoded as {stated}: they look as if raised "
            f"to a power of {1 / power:.2f} +- {uncertainty / power**2:.2f}",
            "use --response auto, which finds the curve; or measure it with `lightmatrix response`",
        )
    coded = "coded with" if stated == "linear" else "coded with a further"
    return Finding(
        "response",
        (),
        f"the photographs are not linear in light, decoded as {stated}: they look {coded} gamma "
        f"{power:.2f} +- {uncertainty:.2f}",
        "use --response auto, which finds the curve; or turn gamma, sRGB, contrast and tone curves "
        "off in the camera",
    )
