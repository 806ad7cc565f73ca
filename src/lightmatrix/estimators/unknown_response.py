"""`lm.find_response`: the responses of camera and projector, from the photographs of a capture.

Light adds up. What a camera pixel shows under many patterns is therefore a sum that T predicts, and
a curve that bends the light leaves a trace that no sum explains. It is found as whatever else a rig
does wrong: by least squares from what the strongest pixels of each row of T, and what T predicts as
a whole, leave of its samples (see `rig_model/`).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture import found_response as responses
from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.camera_window import window_of_levels
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.files.images import JPEG
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.resources.threads import one_blas_thread
from lightmatrix.rig_model.levels import CameraCurve, ProjectorCurve, bent_light
from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.transport.matrix import LightTransport, prediction_error

Array = NDArray[np.float64]

# A search is repeated from elsewhere if its T misses photographs held out by more than 6 %. The new
# curves are taken if theirs misses at most half of that. On simulated captures of 16 frames a T
# under the right curve missed at most 4 %, and 14 to 19 % where a search had ended at a wrong one.
_MISSED, _CLEARLY = 0.06, 0.5


@dataclass(frozen=True, eq=False)
class Curves:
    """The camera's response and the projector's gamma (None: none is looked for).

    `errors` are the standard errors of the gammas that were looked for, the camera's first, as
    shares of them. `curved` says that the camera's is more than a gamma. `missed` is the prediction
    error of the T from which they follow.
    """

    response: Response
    gamma: float | None = None
    errors: tuple[float, ...] = ()
    curved: bool = False
    missed: float = 0.0

    def difference(self, other: "Curves") -> float:
        """The largest difference of the curves, as a share of full light."""
        greys = (responses.gamma_response(each.gamma or 1.0) for each in (self, other))
        return max(
            responses.largest_difference(self.response, other.response),
            responses.largest_difference(*greys),
        )


def find_response(
    capture: Capture | str | Path,
    settings: EstimateSettings | None = None,
    *,
    projector: bool | None = None,
) -> responses.FoundResponse:
    """Find the response of a camera or a projector in the photographs of a capture.

    Light adds up: under the right curve, what a camera pixel shows under all patterns is explained
    by the light of single projector pixels. T is estimated, the curve is corrected by what T leaves
    unexplained, and so on while that changes it. `estimate` does so where a response is "auto".

    Parameters
    ----------
    capture : Capture, str or Path
        The capture, or its folder. The search begins at the response that it states. Where a
        projector's gamma is looked for, its patterns are the grey values that this was sent.
    settings : EstimateSettings, optional
        How T is estimated, in a window of at most 64 x 64 camera pixels. None: as by `estimate`.
    projector : bool, optional
        Whether the projector's gamma is looked for, and the camera's only if the capture's response
        is "auto". None: if the capture leaves it open.

    Returns
    -------
    FoundResponse
        The camera's gamma; or a curve, if one explains the photographs clearly better. With the
        response of the projector as `projector`, if that was looked for.

    Raises
    ------
    InputError
        If the photographs do not determine a response: too few pixels vary without clipping, the
        patterns are not random enough, or the search does not settle. Grey pictures determine only
        the quotient of the camera's and the projector's curves, and black and white patterns need
        no curve of the projector.

    Examples
    --------
    >>> import numpy as np
    >>> import lightmatrix as lm
    >>> light = np.random.default_rng(0).random((32, 64, 64)) ** 2.2
    >>> capture = lm.simulate("metal", lm.ImagePatterns(light), exposure=0.5)
    >>> round(lm.find_response(capture).gamma, 1)  # doctest: +SKIP
    1.0
    >>> grey = lm.ImagePatterns(light ** (1 / 2.2))
    >>> capture = lm.Capture(grey, capture.frames, capture.decoder)
    >>> found = lm.find_response(capture, projector=True)  # doctest: +SKIP
    >>> round(found.projector.gamma, 1)  # doctest: +SKIP
    2.2
    """
    settings = settings or EstimateSettings()
    whole = open_capture(capture)
    looked_for = whole.projector_unknown if projector is None else projector
    _refuse_patterns(whole, projector=looked_for)
    stated, compressed = whole.decoder.response, False
    if not looked_for:
        compressed = any(whole.frames.name(k).lower().endswith(JPEG) for k in range(whole.count))
    if compressed:
        warn(
            "JPEG rounds dark and bright samples by different steps, which looks like a curve: "
            "only a gamma is looked for, and it may be off by some per cent"
        )
    # Windows of 64 x 64 camera pixels gave the same gammas of projectors to 0.4 %, for 1.7 times
    # the time.
    search = _Search(
        window_of_levels(whole, 45 if looked_for else 64), settings,
        camera=not looked_for or stated.name == AUTOMATIC, curves=not (looked_for or compressed),
    )  # fmt: skip

    def starts() -> Iterator[Curves]:
        yield Curves(stated, 1.0 if looked_for else None)
        if looked_for:
            yield Curves(stated, 2.2)
        else:
            yield Curves(responses.raised(stated, search.scanned(stated)))

    found = search.best(starts())
    # A projector's gamma whose standard error is above 2.5 % is not determined.
    if found is None or (looked_for and max(found.errors) > 0.025):
        what = "projector's gamma" if looked_for else "camera's response"
        hint = "measure it with `lightmatrix response`, or give one, such as gamma:2.2"
        raise InputError(f"the photographs do not determine the {what}", hint=hint)
    return search.found(found, stated)


@dataclass(eq=False)
class _Search:
    """The search in a part of a capture, by estimates of T; counts them."""

    part: Capture
    settings: EstimateSettings
    # Whether the camera's response is looked for, and whether it may be more than a gamma.
    camera: bool = True
    curves: bool = True
    estimates: int = 0

    def settled(self, now: Curves) -> Curves | None:
        """The curves at which a search from others ends; None if it does not settle."""
        # Fewer frames determine no curve.
        if self.part.count < 12:
            return None
        # A small difference is removed by one step, a gamma of 3 takes about six.
        for _ in range(8):
            better = refined(*self.estimated(now), now, camera=self.camera, curves=self.curves)
            if better is None or better.difference(now) < 0.005:
                return better
            now = better
        return None

    def best(self, starts: Iterable[Curves]) -> Curves | None:
        """The curves at which searches end; None if none settles."""
        best = None
        for start in starts:
            found = self.settled(start)
            if found and (best is None or found.missed < _CLEARLY * best.missed):
                best = found
            # A search may end at wrong curves, under which T explains few frames as well.
            if best and best.missed <= _MISSED:
                break
        return best

    def scanned(self, stated: Response) -> float:
        """The power of the light, among those of a scan, at which T predicts best."""
        # An error of half of these steps can be told from one of a whole step.
        step = 1.25
        powers = [step**k for k in range(-1, 6)]
        scan = (self.estimated(Curves(responses.raised(stated, power)))[1] for power in powers)
        misses = [prediction_error(transport) or 0.0 for transport in scan]
        best = int(np.argmin(misses))
        if best in (0, len(misses) - 1):
            return powers[best]
        # The vertex of the parabola through three errors, in steps of the scan.
        before, least, after = misses[best - 1 : best + 2]
        curvature = before - 2 * least + after
        offset = 0.5 * (before - after) / curvature if curvature > 0 else 0.0
        return float(powers[best] * step**offset)

    def estimated(self, curves: Curves) -> tuple[Capture, LightTransport]:
        """The part, read by some curves, and its T."""
        self.estimates += 1
        read = responses.with_response(self.part, curves.response)
        if curves.gamma is not None:
            read = responses.with_projector(read, ProjectorResponse.of_gamma(curves.gamma))
        return read, choose_estimator(read, self.settings).estimate(read)

    def found(self, curves: Curves, stated: Response) -> responses.FoundResponse:
        """What was found."""
        gamma, projector = responses.exponent(curves.response), curves.gamma
        # The uncertainty is twice the standard error, and at least 0.5 % of the gamma: on simulated
        # captures the gamma is off by up to that where the standard error is smaller.
        uncertainty = [max(2 * error, 0.005) for error in curves.errors]
        return responses.FoundResponse(
            curves.response, gamma, uncertainty[0] * gamma if self.camera else 0.0,
            responses.largest_difference(curves.response, stated), self.estimates,
            None if projector is None else ProjectorResponse.of_gamma(projector),
            0.0 if projector is None else uncertainty[-1] * projector,
        )  # fmt: skip


def refined(
    capture: Capture, transport: LightTransport, known: Curves, *, camera: bool = True,
    curves: bool = True,
) -> Curves | None:  # fmt: skip
    """The curves of a capture, corrected by the T that was estimated under the `known` ones.

    The response is a gamma, unless a curve is clearly better or was better before; without `curves`
    it is always a gamma. Without `camera` it stays. None if too few rows tell anything.
    """
    with one_blas_thread():
        seen = Prediction.of(capture, capture, transport)
        changes = [CameraCurve().regressors(seen)] if camera else []
        if known.gamma is not None:
            changes.append(np.asarray(ProjectorCurve().regressors(seen)))
        solved = _solved(seen, np.concatenate(changes))
        if solved is None:
            return None
        sizes, errors = solved
        # Beyond these shares the linear change of the light misleads.
        powers = 1 + np.clip(sizes, -0.5, 1.0)
        response, curved = known.response, known.curved
        if camera:
            response = responses.raised(response, float(powers[0]))
        # A curve says nothing of levels that no photograph reaches; a gamma needs no such levels.
        # A curve is looked for only if photographs use half of the levels of their files: those of
        # a camera of 12 bits in files of 16 bits use a sixteenth.
        if curves and np.max(capture.decoder.clip) > 0.5 * capture.decoder.full_scale:
            levels, light = responses.points(known.response)
            shapes = bent_light(
                seen, lambda share: responses.bends(known.response, np.interp(share, light, levels))
            )
            by_bends = _solved(seen, shapes)
            if by_bends is None:
                return None
            curve = responses.bent(known.response, by_bends[0])
            # A gamma looks like the first bend, so only the others tell it from a curve: by eight
            # standard errors, and by 0.25 % of full light. Chosen on simulated captures: gammas
            # stay gammas, sRGB becomes a curve. It is looked for once the gamma is right to 3 %:
            # the T of a wrong gamma bends in other ways, too.
            certain = np.max(np.abs(by_bends[0][1:]) / np.maximum(by_bends[1][1:], 1e-12))
            differs = certain > 8 and responses.largest_difference(curve, response) > 0.0025
            curved |= bool(abs(sizes[0]) < 0.03 and differs)
            response = curve if curved else response
    gamma = known.gamma and float(np.clip(known.gamma * powers[-1], *responses.GAMMAS))
    return Curves(
        response, gamma, tuple(map(float, errors)), curved, prediction_error(transport) or 0.0
    )


def _solved(seen: Prediction, changes: Array) -> tuple[Array, Array] | None:
    """How much of each change (c, m, K) is in the samples; and its standard error, (c,) each.

    The error follows from the scatter of the rows. None if too few rows tell anything.
    """
    enough = seen.free >= 3
    if enough.sum() < 20:
        return None
    # Rows count by the inverse of what they miss anyway.
    missed = (seen.left**2).sum(axis=1) / np.maximum(seen.free, 1)
    weight = np.where(enough, 1 / np.maximum(missed + np.median(missed[enough]), 1e-30), 0)
    parts = np.stack([seen.projected(each) for each in changes])
    matrices = np.einsum("imk,jmk->mij", weight[:, None] * parts, parts, optimize=True)
    sides = np.einsum("imk,mk->mi", parts, weight[:, None] * seen.left)
    matrix = matrices.sum(axis=0)
    if not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1e12:
        return None
    inverse = np.linalg.inv(matrix)
    sizes = inverse @ sides.sum(axis=0)
    scatter = (sides - matrices @ sizes) @ inverse
    return sizes, np.sqrt((scatter**2).sum(axis=0))


def _refuse_patterns(capture: Capture, *, projector: bool) -> None:
    """Refuse patterns from which no curve of the camera, or none of the projector, can be found."""
    patterns, binned = capture.patterns, capture.bin_projector != (1, 1)
    hint = 'leave out projector_response="auto", or projector=True of find_response'
    if projector and isinstance(patterns, ColourPatterns):
        raise InputError("the projector's gamma cannot be found from patterns in colour", hint=hint)
    if projector and patterns.as_bits() is not None:
        raise InputError("black and white patterns need no curve of the projector", hint=hint)
    if projector and binned:
        hint = "do not bin the projector, or measure its curve with `projector_response`"
        raise InputError("grey values are averaged before their light is known", hint=hint)
    rows, cols = patterns.shape
    if binned or patterns.as_bits() is not None or cols < 2:
        return
    drawn = np.random.default_rng(0).integers(0, rows * (cols - 1), 500)
    left = drawn // (cols - 1) * cols + drawn % (cols - 1)
    one, other = (patterns.columns(pixels).astype(np.float64) for pixels in (left, left + 1))
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    both = np.sqrt((one**2).sum() * (other**2).sum())
    # Neighbours in random grey patterns do not correlate, those in photographs by more than 0.9.
    if (one * other).sum() > 0.5 * max(both, 1e-12):
        raise InputError(
            "patterns of pictures determine only the quotient of the camera's and the projector's "
            "curves",
            hint="measure the curves with `lightmatrix response`, or use random patterns",
        )
