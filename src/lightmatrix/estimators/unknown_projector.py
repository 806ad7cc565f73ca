"""`lm.find_projector_response`: the projector's gamma, from photographs of grey patterns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.check.bends import gammas_from_greys
from lightmatrix.check.curves import (
    FoundResponse,
    exponent,
    largest_difference,
    with_projector,
    with_response,
)
from lightmatrix.check.linearity import (
    both_from_windows,
    gamma_from_windows,
)
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError
from lightmatrix.estimators.camera_window import window_of_levels
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.unknown_response import (
    find_response,
    refuse_pictures,
)
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.projector_curve import ProjectorResponse

# The search ends after six estimates, or when an estimate changes neither gamma by 1.5 %: the next
# change would be a tenth of it. One to three estimates were needed on simulated captures.
_MOST_ESTIMATES, _SMALL = 6, 0.015


def find_projector_response(
    capture: Capture | str | Path,
    settings: EstimateSettings | None = None,
    *,
    camera: bool = False,
) -> FoundResponse:
    """Find the projector's gamma in photographs of random grey patterns.

    A start is found without an estimate of T; then T is estimated, the gamma is corrected by what T
    leaves unexplained, and so on while that changes it.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture, or its folder. Its patterns are the grey values that the projector was sent.
    settings : EstimateSettings, optional
        How T is estimated, in a window of at most 45 x 45 camera pixels. None: as by `estimate`.
    camera : bool
        Whether the camera's gamma is unknown too, and found together with the projector's. It is
        found anyway if the capture's response is "auto".

    Returns
    -------
    FoundResponse
        The camera's response, with the projector's as `projector`.

    Raises
    ------
    InputError
        If the patterns are black and white, which need no curve, or pictures, which determine only
        the quotient of both gammas; or if the photographs do not determine a gamma.

    Examples
    --------
    >>> import numpy as np
    >>> import lightmatrix as lm
    >>> light = np.random.default_rng(0).random((32, 64, 64)) ** 2.2
    >>> capture = lm.simulate("metal", lm.ImagePatterns(light), exposure=0.5)
    >>> grey = lm.ImagePatterns(light ** (1 / 2.2))
    >>> capture = lm.Capture(grey, capture.frames, capture.decoder)
    >>> found = lm.find_projector_response(capture)  # doctest: +SKIP
    >>> round(found.projector.gamma, 1)  # doctest: +SKIP
    2.2
    """
    settings = settings or EstimateSettings()
    whole = open_capture(capture)
    _refuse_other_patterns(whole)
    # Fewer frames determine no gamma, as they determine none of the camera's.
    if whole.count < 12:
        raise _undetermined()
    camera = camera or whole.decoder.response.name == AUTOMATIC
    stated = whole.decoder.response
    start, gamma = _start(whole, camera)
    # The search estimates T of a window of at most 45 x 45 camera pixels, about the 2,000 rows that
    # a step uses. Windows of 64 x 64 gave the same gammas to 0.4 %, for 1.7 times the time.
    part, estimates = window_of_levels(with_response(whole, start), 45), 0
    while True:
        read = with_projector(part, ProjectorResponse.of_gamma(gamma))
        transport = choose_estimator(read, settings).estimate(read)
        estimates += 1
        better = gammas_from_greys(part, transport, gamma, camera=camera)
        if better is None:
            raise _undetermined()
        known, before = part.decoder.response, gamma
        part, gamma, last = better
        change = abs(gamma / before - 1)
        if camera:
            change = max(change, abs(exponent(part.decoder.response) / exponent(known) - 1))
        if change < _SMALL:
            break
        if estimates == _MOST_ESTIMATES:
            raise _undetermined()
    # A gamma whose standard error is above 2.5 % is not determined.
    if last.errors.max() > 0.025:
        raise _undetermined()
    response = part.decoder.response
    # The uncertainty is twice the standard error, and at least 0.5 %, as that of the camera's
    # gamma.
    uncertainty = [max(2 * float(error), 0.005) for error in last.errors]
    return FoundResponse(
        response,
        exponent(response),
        uncertainty[0] * exponent(response) if camera else 0.0,
        largest_difference(response, stated),
        estimates,
        ProjectorResponse.of_gamma(gamma),
        uncertainty[-1] * gamma,
    )


def _start(capture: Capture, camera: bool) -> tuple[Response, float]:
    """Responses to begin with: the camera's, if it is unknown, and the projector's gamma."""
    survey = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    learned = np.zeros(capture.count, bool)
    if camera:
        return both_from_windows(survey, learned)
    found = gamma_from_windows(survey, learned)
    return capture.decoder.response, 1.0 if found is None else found.power


def find_responses(capture: Capture, settings: EstimateSettings) -> FoundResponse:
    """The responses that a capture leaves to be found."""
    find = find_projector_response if capture.projector_unknown else find_response
    return find(capture, settings)


def _refuse_other_patterns(capture: Capture) -> None:
    """Refuse patterns from which no gamma of the projector can be found."""
    patterns = capture.patterns
    hint = 'leave out projector_response="auto"'
    if isinstance(patterns, ColourPatterns):
        raise InputError("the projector's gamma cannot be found from patterns in colour", hint=hint)
    if patterns.as_bits() is not None:
        raise InputError("black and white patterns need no curve of the projector", hint=hint)
    if capture.bin_projector != (1, 1):
        raise InputError(
            "grey values are averaged before their light is known",
            hint="do not bin the projector, or measure its curve with `projector_response`",
        )
    refuse_pictures(capture)


def _undetermined() -> InputError:
    return InputError(
        "the photographs do not determine the projector's gamma",
        hint="measure it with `projector_response`",
    )
