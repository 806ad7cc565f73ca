"""`lm.find_response`: the camera's response, from the photographs of a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.found_response import (
    FoundResponse,
    GammaBend,
    SmoothBends,
    exponent,
    largest_difference,
    raised,
    with_projector,
    with_response,
)
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.camera_window import window_of_levels
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.files.images import JPEG
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.rig_model.bends import Bends, bends_from_transport, gammas_from_greys
from lightmatrix.transport.matrix import LightTransport, prediction_error

# The search ends after eight estimates, or when the curve changes by less than 1 % of full light.
# A small difference is removed by one step, a gamma of 3 takes about six.
_MOST_ESTIMATES, _SMALL = 8, 0.01
# A search is repeated from the best of a scan if its T misses photographs held out by more than
# 6 %. The new response is taken if it misses at most half of that. On simulated captures of 16
# frames a T under the right curve missed at most 4 %, and 14 to 19 % where a search had ended at a
# wrong gamma.
_MISSED, _CLEARLY = 0.06, 0.5
# The powers of the scan, in steps at which an error of half a step can be told from a whole one.
_SCAN_STEP = 1.25
_SCANNED = tuple(_SCAN_STEP**k for k in range(-1, 6))
# A curve replaces a gamma if it differs from it by 0.25 % of full light, and one of its bends by
# eight standard errors. Chosen on simulated captures: gammas stay gammas, sRGB becomes a curve.
_CURVED, _CERTAIN = 0.0025, 8.0


class Refined(NamedTuple):
    """A curve, the relative uncertainty of its gamma, and whether it is more than a gamma."""

    response: Response
    uncertainty: float
    curved: bool


def find_response(
    capture: Capture | str | Path, settings: EstimateSettings | None = None
) -> FoundResponse:
    """Find the camera's response in the photographs of a capture, as `estimate` can do by itself.

    Light adds up: under the right curve, what a camera pixel shows under all patterns is explained
    by the light of single projector pixels. T is estimated, the curve is corrected by what T leaves
    unexplained, and so on while that changes it.

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
    # Fewer frames determine no curve.
    if whole.count < 12:
        raise _undetermined()
    search = _Search(window_of_levels(whole), settings, curves=not compressed)
    found = search.settled(stated)
    # A search may end at a wrong curve, under which T explains few frames as well.
    if found is None or found[1] > _MISSED:
        other = search.settled(raised(stated, search.scanned(stated)))
        if other is not None and (found is None or other[1] < _CLEARLY * found[1]):
            found = other
    if found is None:
        raise _undetermined()
    response, uncertainty, _ = found[0]
    gamma, difference = exponent(response), largest_difference(response, stated)
    return FoundResponse(response, gamma, uncertainty * gamma, difference, search.estimates)


@dataclass(eq=False)
class _Search:
    """The search in a part of a capture, by estimates of T; counts them."""

    part: Capture
    settings: EstimateSettings
    curves: bool
    estimates: int = 0

    def settled(self, response: Response) -> tuple[Refined, float] | None:
        """The response at which a search from `response` ends; None if it does not settle.

        Beside it stands the prediction error of the T from which it follows.
        """
        curved = False
        for _ in range(_MOST_ESTIMATES):
            read, transport = self._estimated(response)
            better = refined_response(read, transport, curved=curved, curves=self.curves)
            if better is None:
                return None
            change = largest_difference(better.response, response)
            response, curved = better.response, better.curved
            if change < _SMALL:
                return better, prediction_error(transport) or 0.0
        return None

    def scanned(self, stated: Response) -> float:
        """The power of the light, among those of a scan, at which T predicts best."""
        scan = (self._estimated(raised(stated, power))[1] for power in _SCANNED)
        misses = [prediction_error(transport) or 0.0 for transport in scan]
        best = int(np.argmin(misses))
        if best in (0, len(misses) - 1):
            return _SCANNED[best]
        # The vertex of the parabola through three errors, in steps of the scan.
        before, least, after = misses[best - 1 : best + 2]
        curvature = before - 2 * least + after
        offset = 0.5 * (before - after) / curvature if curvature > 0 else 0.0
        return float(_SCANNED[best] * _SCAN_STEP**offset)

    def _estimated(self, response: Response) -> tuple[Capture, LightTransport]:
        """The part, read by a response, and its T."""
        self.estimates += 1
        read = with_response(self.part, response)
        return read, choose_estimator(read, self.settings).estimate(read)


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
    # A curve is looked for only if photographs use half of the levels of their files: those of a
    # camera of 12 bits in files of 16 bits use a sixteenth. Chosen by hand.
    curves = curves and float(np.max(capture.decoder.clip)) > 0.5 * capture.decoder.full_scale
    gamma = GammaBend().bent(response, power.sizes)
    curve = SmoothBends().bent(response, bends.sizes)
    # A gamma looks like the first bend, so only the others tell it from a curve.
    certain = float(np.max(np.abs(bends.sizes[1:]) / np.maximum(bends.errors[1:], 1e-12)))
    # A curve is looked for once the gamma is right to 5 %: the T of a wrong gamma bends in other
    # ways, too.
    near = abs(float(power.sizes[0])) < 0.05
    differs = largest_difference(curve, gamma) > _CURVED and certain > _CERTAIN
    curved |= curves and near and differs
    # The uncertainty is twice the standard error, and at least 0.5 % of the gamma: on simulated
    # captures the gamma is off by up to that where the standard error is smaller.
    uncertainty = max(2 * float(power.errors[0]), 0.005)
    return Refined(curve if curved else gamma, uncertainty, curved)


def show_pictures(patterns: PatternSet) -> bool:
    """Whether neighbouring pixels of grey patterns are alike, as those of photographs are."""
    if patterns.as_bits() is not None or patterns.shape[1] < 2:
        return False
    rows, cols = patterns.shape
    drawn = np.random.default_rng(0).integers(0, rows * (cols - 1), 500)
    left = drawn // (cols - 1) * cols + drawn % (cols - 1)
    one, other = (patterns.columns(pixels).astype(np.float64) for pixels in (left, left + 1))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    both = np.sqrt((one**2).sum() * (other**2).sum())
    # Neighbours in random grey patterns do not correlate, those in photographs by more than 0.9.
    return float((one * other).sum() / max(both, 1e-12)) > 0.5


def refuse_pictures(capture: Capture) -> None:
    """Refuse grey patterns whose neighbouring pixels are alike, such as photographs."""
    if capture.bin_projector == (1, 1) and show_pictures(capture.patterns):
        raise InputError(
            "patterns of pictures determine only the quotient of the camera's and the projector's "
            "curves",
            hint="measure the curves with `lightmatrix response`, or use random patterns",
        )


def _undetermined(what: str = "camera's response") -> InputError:
    return InputError(
        f"the photographs do not determine the {what}",
        hint="measure it with `lightmatrix response`, or give one, such as gamma:2.2",
    )


def find_projector_response(
    capture: Capture | str | Path,
    settings: EstimateSettings | None = None,
    *,
    camera: bool = False,
) -> FoundResponse:
    """Find the projector's gamma in photographs of random grey patterns.

    T is estimated, the gamma is corrected by what T leaves unexplained, and so on while that
    changes it.

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
        raise _undetermined("projector's gamma")
    camera = camera or whole.decoder.response.name == AUTOMATIC
    stated = whole.decoder.response
    read = with_response(whole, Response()) if stated.name == AUTOMATIC else whole
    # The search estimates T of a window of at most 45 x 45 camera pixels, about the 2,000 rows that
    # a step uses. Windows of 64 x 64 gave the same gammas to 0.4 %, for 1.7 times the time.
    part = window_of_levels(read, 45)
    # Most searches end at the right gammas from wherever they begin.
    estimates = 0
    for start in (1.0, 2.2):
        found, tried = _searched_gammas(part, start, camera, settings)
        estimates += tried
        if found is not None:
            break
    else:
        raise _undetermined("projector's gamma")
    response, gamma, last = found
    # A gamma whose standard error is above 2.5 % is not determined.
    if last.errors.max() > 0.025:
        raise _undetermined("projector's gamma")
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


def _searched_gammas(
    part: Capture, gamma: float, camera: bool, settings: EstimateSettings
) -> tuple[tuple[Response, float, Bends] | None, int]:
    """The camera's response, the projector's gamma and the last step; and how many estimates.

    None in place of the first if the search from this gamma does not settle.
    """
    # One to four estimates were needed on simulated captures.
    most = 6
    for number in range(1, most + 1):
        read = with_projector(part, ProjectorResponse.of_gamma(gamma))
        transport = choose_estimator(read, settings).estimate(read)
        better = gammas_from_greys(part, transport, gamma, camera=camera)
        if better is None:
            return None, number
        known, before = part.decoder.response, gamma
        part, gamma, last = better
        change = abs(gamma / before - 1)
        if camera:
            change = max(change, abs(exponent(part.decoder.response) / exponent(known) - 1))
        # When an estimate changes neither gamma by 1.5 %, the next change would be a tenth of it.
        if change < 0.015:
            return (part.decoder.response, gamma, last), number
    return None, most


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
