"""`lm.estimate_colour`: from photographs of colour patterns to the T of a colour projector."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC
from lightmatrix.capture.capture import Capture, KnownSamples, open_capture
from lightmatrix.check.finding import FINDINGS
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable, warn_of
from lightmatrix.errors import InputError
from lightmatrix.estimators.base import capture_provenance
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.colour.mixing import (
    PRIMARIES,
    ColourSamples,
    fit_gains,
    light_of_primaries,
    usual_gains,
)
from lightmatrix.estimators.colour.unmixing import grey_capture, unmixed_capture
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.kinds import COLOUR_STORES
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.progress_bar import progress_bar
from lightmatrix.solvers.loop import Progress
from lightmatrix.transport.matrix import ColourTransport, LightTransport
from lightmatrix.transport.store import save_colour

# How much gains are drawn to the mixing of the whole frame, in each round after the start. First
# the geometry of some pixels is wrong, and so would be their own gains; then it is right.
TRUSTS = (0.3, 0.03)


@dataclass(frozen=True, eq=False)
class _Known:
    """What the rounds share."""

    samples: ColourSamples
    camera_shape: tuple[int, ...]
    exposure: float
    progress: Callable[[int, int], None] | None

    def geometry(self, capture: KnownSamples, number: int) -> LightTransport:
        """The coherent estimate of a grey camera; it is the estimate of that number."""
        steps = len(TRUSTS) + 1
        report: Progress | None = None
        if self.progress is not None:
            show = self.progress

            def report(done: int, total: int) -> None:
                show(number * total + done, steps * total)

        return CoherentEstimator().estimate(capture, progress=report)

    def start(self) -> LightTransport:
        """The first geometry: of the grey photographs, or of all under a usual mixing."""
        # Grey patterns from which the geometry is found without the others. Fewer show where most
        # camera pixels look, but not all. The usual mixing is the better start then
        # (docs/colour.md).
        if self.samples.patterns.grey.sum() >= 12:
            capture = grey_capture(self.samples, self.camera_shape, self.exposure)
        else:
            usual = usual_gains(self.samples.pixels)
            capture = unmixed_capture(self.samples, usual, self.camera_shape, self.exposure)
        return self.geometry(capture, 0)

    def refined(self, before: LightTransport, number: int) -> LightTransport:
        """The geometry of all photographs, unmixed by the gains that the geometry before gives."""
        light = light_of_primaries(before, self.samples.patterns)
        gains = fit_gains(self.samples, light, TRUSTS[number])
        capture = unmixed_capture(self.samples, gains, self.camera_shape, self.exposure)
        return self.geometry(capture, number + 1)


def estimate_colour(
    capture: Capture | str | Path,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    check: bool = True,
    progress: Progress | bool = True,
) -> ColourTransport:
    """Estimate T of a colour projector, whose primaries and camera channels share their geometry.

    Parameters
    ----------
    capture : Capture, str or Path
        Photographs of a camera with three channels under `ColourPatterns`; or a capture folder.
    output : str or Path, optional
        A folder to write as well, with a store for each primary: red.zarr, green.zarr, blue.zarr.
    overwrite : bool
        Whether a folder of stores at `output` may be replaced.
    check : bool
        Whether to refuse photographs that do not follow their patterns, and to warn of what else
        `lm.check` finds. The provenance keeps it.
    progress : bool or callable
        Whether to show a bar on a terminal and in notebooks; or what to call with (done, total).

    Returns
    -------
    ColourTransport
        The matrices of red, green and blue, of three rows a camera pixel. Estimated errors are
        those of the geometry, alike for all channels and primaries of a camera pixel.

    Raises
    ------
    InputError
        If patterns or camera are grey, responses are to be found, or the capture is unusable.
    OutputError
        If the output exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.colour_bernoulli((64, 64), 32)
    >>> capture = lm.simulate("metal", patterns, exposure=0.4)
    >>> colour = lm.estimate_colour(capture)  # doctest: +SKIP
    >>> image = colour.relight(np.ones((64, 64, 3)))  # doctest: +SKIP
    """
    capture = open_capture(capture)
    patterns = _checked(capture)
    if capture.projector_unknown or capture.decoder.response.name == AUTOMATIC:
        raise InputError(
            "responses are to be found (auto), which photographs in colour do not allow yet",
            hint="state the curves, which `lightmatrix response` measures",
        )
    if output is not None:
        check_output(output, COLOUR_STORES, overwrite=overwrite)
    refuse_unusable(capture)
    findings = refuse_unordered(capture) if check else []
    warn_of(findings)
    samples = ColourSamples.of(capture.samples(), patterns)
    with progress_bar("estimating", "rows") if progress is True else nullcontext(None) as bar:
        known = _Known(
            samples,
            capture.camera_shape[:2],
            float(capture.exposures.max()),
            progress if callable(progress) else bar,
        )
        geometry = known.start()
        for number in range(len(TRUSTS)):
            geometry = known.refined(geometry, number)
    # The gains of the result are drawn less to the mixing of the whole frame.
    gains = fit_gains(samples, light_of_primaries(geometry, patterns), 0.003)
    provenance = {
        **geometry.provenance,
        **capture_provenance(capture),
        "estimator": "colour",
        FINDINGS: [finding.as_dict() for finding in findings],
    }
    clipped = samples.clipped.mean(axis=2, dtype=np.float32).ravel()
    red, green, blue = (
        _of_primary(geometry, gains[..., number], name, clipped, provenance)
        for number, name in enumerate(COLOURS)
    )
    colour = ColourTransport(red, green, blue)
    if output is not None:
        save_colour(output, colour, overwrite=overwrite)
    return colour


def _checked(capture: Capture) -> ColourPatterns:
    """The patterns, if they and the camera are in colour."""
    patterns = capture.patterns
    if not isinstance(patterns, ColourPatterns) or patterns.grey.all():
        raise InputError(
            "the patterns are grey, or of one colour",
            hint="use lm.estimate, or `lightmatrix estimate`",
        )
    if capture.camera_shape[2:] != (PRIMARIES,):
        raise InputError(
            "patterns of several colours, but a camera without three channels",
            hint="photograph them with a colour camera; or show and photograph all patterns in "
            "red, then in green, then in blue, as captures of their own",
        )
    return patterns


def _of_primary(
    geometry: LightTransport,
    gains: NDArray[np.float64],
    name: str,
    clipped: NDArray[np.float32],
    provenance: dict[str, object],
) -> LightTransport:
    """T of one primary: the geometry, three times a camera pixel, times the gains (n, 3)."""
    factors = gains.ravel().astype(np.float32)
    pixel = np.repeat(np.arange(len(gains)), PRIMARIES)
    sparse = geometry.sparse[pixel]
    sparse.data *= np.repeat(factors, np.diff(sparse.indptr))
    diagnostics = {key: values[pixel] for key, values in geometry.diagnostics.items()}
    return replace(
        geometry,
        sparse=sparse,
        background=geometry.background[pixel] * factors[:, None],
        camera_shape=(*geometry.camera_shape, PRIMARIES),
        diagnostics={**diagnostics, "clipped_share": clipped},
        provenance={**provenance, "primary": name},
    )
