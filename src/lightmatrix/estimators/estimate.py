"""The call `lm.estimate`: from a capture to its light transport matrix.

A tile of rows is solved six calls below it:

1. `estimate` (here) checks the settings and the capture, and chooses the estimator (`choice.py`).
2. `Estimator.estimate` (`base.py`) plans the work and opens the checkpoint.
3. `complete` (`work.py`) goes through the steps of the work and their missing tiles.
4. A method of `Rounds` (`coherent/rounds.py`) reads the samples of a tile and returns its rows.
5. `RowSolver.near` (`coherent/row_solver.py`) sets up the weighted problem of these rows.
6. `solve_weighted` (`solvers/active_set.py`) hands it to the compiled core.

Row by row, `PlainRows._solve` (`plain.py`) replaces 4 and 5, and `solvers.solve` replaces 6.
With workers, 3 hands the tiles to `DaskPool.solve` (`workers.py`), and each worker does the rest.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.found_response import FOUND_RESPONSE, with_projector, with_response
from lightmatrix.check.finding import FINDINGS, Finding
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable, warn_of
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.corrected import corrected, terms_to_correct
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.resource_estimate import estimate_resources
from lightmatrix.estimators.rig_findings import rig_findings
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.unknown_response import find_response
from lightmatrix.estimators.workers import dask_pool
from lightmatrix.files.kinds import PROJECTOR_STORES, STORE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.progress import Progress
from lightmatrix.progress_bar import progress_bar
from lightmatrix.rig_model.model import RigModel
from lightmatrix.rig_model.terms import TERMS
from lightmatrix.transport.matrix import LightTransport, prediction_error


def estimate(
    capture: Capture | str | Path,
    *,
    response: Response | str | None = None,
    projector_response: ProjectorResponse | str | None = None,
    solver: str = "active-set",
    fidelity: str | None = None,
    regularization: str | float = "auto",
    coherent: bool | None = None,
    multi_scale: bool = False,
    background: bool = True,
    signed: bool = False,
    iterations: int | None = None,
    tile_rows: int | None = None,
    memory: int | str | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    check: bool = True,
    correct: str | Sequence[str] = "auto",
    progress: Progress | bool = True,
) -> LightTransport:
    """Estimate the light transport matrix of a capture, as `lightmatrix estimate` does.

    With up to 256 patterns, camera pixels learn from their neighbours where light is likely. With
    more patterns, and with settings that exclude this, each camera pixel is estimated by itself.

    Parameters
    ----------
    capture : Capture, str or Path
        M camera samples under K patterns of N projector pixels; or a capture folder.
    response : Response or str, optional
        The camera's response in place of the capture's, see `Response.parse`. "auto" finds it in
        the photographs, see `find_response`. None: the capture's.
    projector_response : ProjectorResponse or str, optional
        The light of the patterns' grey values; "auto" finds a gamma in the photographs, see
        `find_response`. None: the patterns are light, or black and white.
    solver : {"active-set", "saturation-admm", "admm", "romp", "total-variation"}
        active-set certifies a duality gap of each row. total-variation is for rows that are
        pictures, as of single-pixel detectors.
    fidelity : {"one-sided", "clipped", "rejection", "linear"}, optional
        How clipped samples count: as a lower bound (convex), as in the paper's Eq. 6, not at all,
        at their value. None: one-sided; linear for admm, rejection for romp.
    regularization : "auto" or float
        The paper's lambda in units of camera sample at exposure 1; auto derives it from patterns
        and samples.
    coherent : bool, optional
        Whether to learn from neighbouring camera pixels. None: with the active-set solver and up
        to 256 patterns, unless photographs held out are predicted better without.
    multi_scale : bool
        Whether to solve on projector blocks first, then on the pixels that matter.
    background : bool
        Whether diffuse light has a coefficient, or coarse cells, per camera sample.
    signed : bool
        Whether to allow negative light, as the paper does.
    iterations : int, optional
        Most iterations (rounds for romp, passes for active-set), 1 to 10^9.
    tile_rows : int, optional
        Camera samples solved at a time. None: as many as half a gigabyte holds.
    memory : int or str, optional
        Bytes, or an amount such as "4GiB", that the estimate may take at most. Fewer camera samples
        are then solved at a time; results do not depend on it. None: as much as is free. Workers of
        this machine share it; of a cluster each may take so much.
    workers : int, optional
        Processes on this machine that solve rows, and share its cores; results do not depend on
        their number. Needs the extra cluster. None: this process.
    cluster : str, optional
        Address of a scheduler of Dask, such as tcp://10.0.0.1:8786, whose workers solve rows (see
        docs/clusters.md). They read the capture by its path.
    output : str or Path, optional
        A store (.zarr) to write as well. Finished tiles are kept beside it, so that an interrupted
        run continues where it stopped. Of several projectors, a folder of stores instead.
    overwrite : bool
        Whether a complete store at `output` may be replaced.
    check : bool
        Whether to refuse photographs that do not follow their patterns and estimates that do not
        fit into memory, and to warn of what else `lm.check` finds. The provenance keeps it.
    correct : "auto", "none" or sequence of str
        Which faults of the rig are looked for in the photographs and taken out of T, see `fit_rig`:
        all, none, or some of "gain", "exposure", "ambient", "shift", "rows", "previous",
        "camera-curve", "projector-curve", "crosstalk", "sharpening", "camera-sharpening",
        "dynamic-contrast", "tone-mapping", "black" and "camera-blur". A correction stays only if
        photographs held out are predicted better with it; estimates row by row hold none out, and
        are never corrected. The exposure of T is then that of the first frame, or of the others if
        it is odd.
    progress : bool or callable
        Whether to show a bar on a terminal and in notebooks; or what to call with (done, total)
        rows.

    Returns
    -------
    LightTransport
        With the share of clipped samples, gap, iterations and convergence of each row as
        `diagnostics`. Of several projectors, its `split` gives the matrix of each.

    Warns
    -----
    LightMatrixWarning
        For each finding of `lm.check`; for what the rig did and is corrected; with the response
        that was found; and if the estimate row by row was chosen because it predicts photographs
        held out better.

    Raises
    ------
    InputError, SolverError, OutputError
        If settings exclude each other, the capture is unusable or shows patterns in colour, the
        estimate does not fit into memory (see `estimate_resources`), or the output cannot be
        written.
    ClusterError, MissingExtraError
        If workers cannot be reached or do not have the same versions, or Dask is missing.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> transport = lm.estimate(capture, coherent=False, iterations=20, output="metal.zarr")
    >>> transport.camera_shape, transport.summary()["fidelity"]
    ((64, 64), 'one-sided')
    """
    settings = EstimateSettings(
        solver, fidelity, regularization, coherent, multi_scale, background, signed, iterations,
        tile_rows, memory, workers, cluster,
    )  # fmt: skip
    allowed = terms_to_correct(correct)
    capture = open_capture(capture)
    if isinstance(capture.patterns, ColourPatterns):
        hint = "use lm.estimate_colour, or `lightmatrix estimate`"
        raise InputError("patterns in several colours, of which T has three matrices", hint=hint)
    if output is not None:
        kind = PROJECTOR_STORES if capture.projectors else STORE
        check_output(output, kind, overwrite=overwrite)
    if response is not None:
        known = Response.parse(response) if isinstance(response, str) else response
        capture = with_response(capture, known)
    if isinstance(projector_response, ProjectorResponse):
        capture = with_projector(capture, projector_response)
    elif projector_response == AUTOMATIC:
        capture = replace(capture, projector_unknown=True)
    elif projector_response is not None:
        hint = "give a ProjectorResponse, or auto"
        raise InputError(f"a projector's response of {projector_response!r}", hint=hint)
    resources = estimate_resources(capture, settings)
    if check or resources.limited:
        resources.check()
    elif not resources.fits:
        warn(f"this takes {resources}\n  {resources.advice}")
    several = settings.workers is not None or settings.cluster is not None
    # Workers are checked before the frames are read, which takes longer.
    with dask_pool(workers, cluster) if several else nullcontext() as pool:
        refuse_unusable(capture)
        findings = refuse_unordered(capture) if check else []
        remarks: dict[str, Any] = {}
        camera_unknown = capture.decoder.response.name == AUTOMATIC
        if camera_unknown or capture.projector_unknown:
            with _bar("looking for the response", progress is True):
                found = find_response(capture, settings)
            warn(f"response: {found}")
            capture = found.applied_to(capture)
            remarks = {FOUND_RESPONSE: found.provenance()}
        estimator = choose_estimator(capture, settings, resources)
        warn_of(findings)
        if resources.coherent and type(estimator) is PlainEstimator:
            better = "which predicts photographs held out better than coherent=True"
            warn(f"estimating row by row, {better}")
        with _bar("estimating", progress is True) as bar:
            report = progress if callable(progress) else bar
            run = partial(estimator.estimate, progress=report, pool=pool)
            return run(
                capture, output=None if output is None else Path(output),
                remarks={FINDINGS: [each.as_dict() for each in findings], **remarks},
                overwrite=overwrite,
                review=partial(
                    _without_faults, capture, run, allowed, findings if check else None, report
                ),
            )  # fmt: skip


def _without_faults(
    capture: Capture, run: Callable[[Capture], LightTransport], allowed: Sequence[str],
    findings: list[Finding] | None, progress: Progress | None, first: LightTransport,
) -> LightTransport | None:  # fmt: skip
    """Warn of what the rig did, and return T without it; None if nothing was found.

    If there are `findings` of `check`, what may not be corrected, or cannot be, is looked for, too.
    """
    model, transport = corrected(capture, first, run, allowed, progress)
    for sentence in model.sentences:
        warn(f"rig: {sentence}: corrected")
    others, found = [name for name in TERMS if name not in allowed], list[Finding]()
    if findings is not None and prediction_error(first) is None:
        found = rig_findings(capture, findings)
    elif findings is not None and others and RigModel().refined(capture, capture, first, others):
        found = rig_findings(capture, findings, others)
    if not (model.names or found):
        return None
    warn_of(found)
    # A finding of what is corrected spoils T no more.
    kept = [each for each in transport.provenance[FINDINGS] if each["kind"] not in model.names]
    kept += [each.as_dict() for each in found]
    return replace(transport, provenance={**transport.provenance, FINDINGS: kept})


def _bar(title: str, shown: bool) -> AbstractContextManager[Any]:
    return progress_bar(title, "rows") if shown else nullcontext(None)
