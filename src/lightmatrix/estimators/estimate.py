"""The calls of the estimate: `estimate`, and `needs`, which says before what it will take."""

from __future__ import annotations

from pathlib import Path

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.diagnosis.refusals import refuse_unordered, refuse_unusable
from lightmatrix.estimators.auto import AutoEstimator
from lightmatrix.estimators.needs import Needs
from lightmatrix.estimators.steps import Progress
from lightmatrix.outputs.kinds import STORE
from lightmatrix.outputs.writing import check_output
from lightmatrix.transport.matrix import LightTransport


def estimate(
    capture: Capture | str | Path,
    *,
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
    progress: Progress | None = None,
) -> LightTransport:
    """Estimate the light transport matrix of a capture, as `lightmatrix estimate` does.

    Up to 256 patterns camera pixels learn from their neighbours where light is likely; with more,
    and with anything that this does not go with, each is estimated by itself.

    Parameters
    ----------
    capture : Capture, str or Path
        M camera samples under K patterns of N projector pixels; or a capture folder, which is
        opened and checked.
    solver : {"active-set", "saturation-admm", "admm", "romp"}
        active-set certifies a duality gap of each row.
    fidelity : {"one-sided", "clipped", "likelihood", "rejection", "linear"}, optional
        How clipped samples count: as a lower bound (convex), as in the paper's Eq. 6, as a lower
        bound with a soft edge, not at all, at their value. None: one-sided; linear for admm,
        rejection for romp.
    regularization : "auto", "path" or float
        The paper's lambda in units of camera sample at exposure 1; auto tells it from patterns and
        samples; path takes, row by row, the value that best predicts patterns held out.
    coherent : bool, optional
        Whether to learn from neighbouring camera pixels. None: with the active-set solver and up
        to 256 patterns.
    multi_scale : bool
        Projector blocks first, then the pixels that matter.
    background : bool
        Whether diffuse light has a coefficient, or coarse cells, per camera sample.
    signed : bool
        Allow negative light, as the paper does.
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
        docs/clusters.md). They read the capture, and write beside the output, by their paths.
    output : str or Path, optional
        A store (.zarr) to write as well. Finished tiles are kept beside it, so that an interrupted
        run goes on where it stopped.
    overwrite : bool
        Whether a complete store at `output` may be replaced.
    check : bool
        Refuse photographs that do not follow their patterns, as `lm.check` finds them.
    progress : callable, optional
        Called with (done, total) rows.

    Returns
    -------
    LightTransport
        With the share of clipped samples, gap, iterations and convergence of each row as
        `diagnostics`.

    Raises
    ------
    InputError, SolverError, OutputError
        On settings that do not go together, unusable captures, what does not fit into memory (see
        `needs`), or outputs that cannot be written.
    ClusterError, MissingExtraError
        On workers that cannot be reached or are not what they should be, or without Dask.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> transport = lm.estimate(capture, coherent=False, iterations=20, output="metal.zarr")
    >>> transport.camera_shape, transport.summary()["fidelity"]
    ((64, 64), 'one-sided')
    """
    estimator = AutoEstimator(
        solver,
        fidelity,
        regularization,
        coherent,
        multi_scale,
        background,
        signed,
        iterations,
        tile_rows,
        memory,
        workers,
        cluster,
    )
    estimator.check_shared(output)
    if output is not None:
        check_output(output, STORE, overwrite=overwrite)
    taken = open_capture(capture)
    estimator.needs(taken).check()
    # What is wrong with workers is said before frames are read.
    with estimator.crew(taken) as crew:
        refuse_unusable(taken)
        if check:
            refuse_unordered(taken)
        return estimator.estimate(
            taken,
            checkpoint=None if output is None else Path(output),
            overwrite=overwrite,
            progress=progress,
            crew=crew,
        )


def needs(capture: Capture | str | Path, *, estimator: AutoEstimator | None = None) -> Needs:
    """What an estimate will take of memory and time, and what would take less.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, or a capture folder, of which no frame but the first is read.
    estimator : AutoEstimator, optional
        With the settings of the estimate. None: the default ones.

    Returns
    -------
    Needs
        Within a factor of about 1.5 in memory and 2 in time.

    Raises
    ------
    InputError
        On a folder that is none.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> lm.needs(capture).fits
    True
    """
    taken = open_capture(capture)
    return (estimator or AutoEstimator()).needs(taken)
