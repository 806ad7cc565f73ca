"""`lm.find_response`: the camera's response, from the photographs of a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightmatrix.camera.camera_curve import Response
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.decoding import JPEG
from lightmatrix.diagnosis.responses.bend import GammaBend, SmoothBends, exponent, raised
from lightmatrix.diagnosis.responses.found import (
    FoundResponse,
    largest_difference,
    with_response,
)
from lightmatrix.diagnosis.responses.from_transport import bends_from_transport
from lightmatrix.diagnosis.responses.from_windows import power_from_windows
from lightmatrix.diagnosis.responses.greys_from_windows import show_pictures
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.transport.matrix import LightTransport

# The search estimates T of a window of at most 64 x 64 camera pixels: enough for 2,000 rows.
_SIDE = 64
# Frames that tell where the camera sees the most. Chosen by hand: a few patterns light everything.
_FRAMES = 8
# The search ends after four estimates, or when the curve changes by less than 1 % of full light.
# Each step removes nearly all of a difference, so that what is left is much smaller.
_MOST_ESTIMATES, _SMALL = 4, 0.01
# A curve replaces a gamma if it differs from it by 0.25 % of full light, and one of its bends by
# eight standard errors. Chosen on simulated captures: gammas stay gammas, sRGB becomes a curve.
_CURVED, _CERTAIN = 0.0025, 8.0
# A curve is looked for only if photographs use half of the levels of their files: those of a camera
# of 12 bits in files of 16 bits use a sixteenth. Chosen by hand.
_WIDE = 0.5
# The uncertainty is twice the standard error, and at least 0.5 % of the gamma: on simulated
# captures the gamma is off by up to that where the standard error is smaller.
_LEAST_UNCERTAINTY = 0.005


@dataclass(frozen=True, eq=False)
class Refined:
    """A curve, the relative uncertainty of its gamma, and whether it is more than a gamma."""

    response: Response
    uncertainty: float
    curved: bool


def find_response(
    capture: Capture | str | Path, settings: EstimateSettings | None = None
) -> FoundResponse:
    """Find the camera's response in the photographs of a capture, as `estimate` can do by itself.

    Light adds up: under the right curve, what a camera pixel shows under all patterns is explained
    by the light of single projector pixels. A start is found without an estimate of T; then T is
    estimated, the curve is corrected by what T leaves unexplained, and so on while that changes it.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture, or its folder. The search begins at the response that it states.
    settings : EstimateSettings, optional
        How T is estimated, in a window of at most 64 x 64 camera pixels. None: as by `estimate`.

    Returns
    -------
    FoundResponse
        A gamma; or a curve, if one explains the photographs clearly better.

    Raises
    ------
    InputError
        If the photographs do not determine a response: too few pixels vary without clipping, the
        patterns are not random enough, or the search does not settle. Grey pictures determine only
        the quotient of the camera's and the projector's curves.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> found = lm.find_response(capture)  # doctest: +SKIP
    >>> round(found.gamma, 1)  # doctest: +SKIP
    1.0
    """
    settings = settings or EstimateSettings()
    whole = open_capture(capture)
    refuse_pictures(whole)
    compressed = any(whole.frames.name(k).lower().endswith(JPEG) for k in range(whole.count))
    if compressed:
        warn(
            "JPEG rounds dark and bright samples by different steps, which looks like a curve: "
            "only a gamma is looked for, and it may be off by some per cent"
        )
    stated = whole.decoder.response
    survey = Survey.take(whole.patterns, whole.frames, whole.decoder, whole.mask)
    start = power_from_windows(survey, np.zeros(whole.count, bool))
    if start is None:
        raise _undetermined()
    response, curved, estimates = raised(stated, start.power), False, 0
    part = brightest_window(whole)
    while True:
        read = with_response(part, response)
        transport = choose_estimator(read, settings).estimate(read)
        estimates += 1
        better = refined_response(read, transport, curved=curved, curves=not compressed)
        if better is None:
            raise _undetermined()
        change = largest_difference(better.response, response)
        response, curved = better.response, better.curved
        if change < _SMALL:
            break
        if estimates == _MOST_ESTIMATES:
            raise _undetermined()
    return FoundResponse(
        response,
        exponent(response),
        better.uncertainty * exponent(response),
        largest_difference(response, stated),
        estimates,
    )


def refined_response(
    capture: Capture, transport: LightTransport, *, curved: bool = False, curves: bool = True
) -> Refined | None:
    """The response of a capture, corrected by the T that was estimated under it.

    It is a gamma, unless a curve is clearly better or was better before (`curved`); without
    `curves` it is always a gamma. None if too few rows tell anything.
    """
    response = capture.decoder.response
    power = bends_from_transport(capture, transport, GammaBend())
    bends = bends_from_transport(capture, transport, SmoothBends())
    if power is None or bends is None:
        return None
    # A curve says nothing of levels that no photograph reaches; a gamma needs no such levels.
    curves = curves and float(np.max(capture.decoder.clip)) > _WIDE * capture.decoder.full_scale
    gamma = GammaBend().bent(response, power.sizes)
    curve = SmoothBends().bent(response, bends.sizes)
    # A gamma looks like the first bend, so only the others tell it from a curve.
    certain = float(np.max(np.abs(bends.sizes[1:]) / np.maximum(bends.errors[1:], 1e-12)))
    curved |= curves and largest_difference(curve, gamma) > _CURVED and certain > _CERTAIN
    uncertainty = max(2 * float(power.errors[0]), _LEAST_UNCERTAINTY)
    return Refined(curve if curved else gamma, uncertainty, curved)


def refuse_pictures(capture: Capture) -> None:
    """Refuse grey patterns whose neighbouring pixels are alike, such as photographs."""
    if capture.bin_projector == (1, 1) and show_pictures(capture.patterns):
        raise InputError(
            "patterns of pictures determine only the quotient of the camera's and the projector's "
            "curves",
            hint="measure the curves with `lightmatrix response`, or use random patterns",
        )


def _undetermined() -> InputError:
    return InputError(
        "the photographs do not determine the camera's response",
        hint="measure it with `lightmatrix response`, or give one, such as gamma:2.2 or srgb",
    )


def brightest_window(capture: Capture, side: int = _SIDE) -> Capture:
    """The capture's window of at most `side` x `side` camera pixels in which most light changes."""
    rows, cols = capture.camera_shape[:2]
    high, wide = min(rows, side), min(cols, side)
    if (high, wide) == (rows, cols):
        return capture
    frames = np.linspace(0, capture.count - 1, min(_FRAMES, capture.count)).astype(int)
    some = capture.select(frames)
    spread = np.concatenate([tile.values.std(axis=1) for _, tile in some.tiles()])
    image = spread.reshape(rows, cols, -1).mean(axis=2)
    # A few bright pixels shall not decide.
    sums = np.zeros((rows + 1, cols + 1))
    sums[1:, 1:] = np.minimum(image, np.quantile(image, 0.9)).cumsum(axis=0).cumsum(axis=1)
    inside = sums[high:, wide:] - sums[:-high, wide:] - sums[high:, :-wide] + sums[:-high, :-wide]
    top, left = np.unravel_index(int(inside.argmax()), inside.shape)
    return capture.window(slice(int(top), int(top) + high), slice(int(left), int(left) + wide))
