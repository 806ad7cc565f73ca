"""`lightmatrix estimate`: from a capture to its light transport matrix."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from lightmatrix.capture.capture import Capture
from lightmatrix.cli.common import (
    Clip,
    Json,
    Overwrite,
    ResponseCurve,
    claim,
    out,
    progress,
    show_json,
    show_table,
    size,
)
from lightmatrix.cli.results import named, summary
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import WORTH_IT_UP_TO, CoherentEstimator
from lightmatrix.estimators.multiscale.estimator import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.regularization import held_out_path
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, SaturationADMM, Solver
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import check_regularization
from lightmatrix.store.zarr_file import STORE


class SolverName(StrEnum):
    """Solvers of `lightmatrix estimate`."""

    ACTIVE_SET = "active-set"
    SATURATION_ADMM = "saturation-admm"
    ADMM = "admm"
    ROMP = "romp"


SOLVERS_HELP = (
    "active-set (one-sided, rejection, linear; certifies a duality gap), "
    "saturation-admm (clipped, one-sided, likelihood, rejection, linear), admm (linear), "
    "romp (linear, rejection)."
)
FIDELITY_HELP = (
    "How clipped samples count: one-sided (a lower bound, convex), clipped (the paper's Eq. 6), "
    "likelihood (a lower bound with a soft edge), rejection (left out), "
    "linear (taken at their value)."
)
DEFAULT_FIDELITY = {
    SolverName.ACTIVE_SET: Fidelity.ONE_SIDED,
    SolverName.SATURATION_ADMM: Fidelity.ONE_SIDED,
    SolverName.ADMM: Fidelity.LINEAR,
    SolverName.ROMP: Fidelity.REJECTION,
}


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command("estimate")(estimate)


def estimate(
    capture: Annotated[
        Path | None,
        typer.Argument(
            metavar="CAPTURE", help="Capture folder (patterns/, images/, capture.json)."
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The store to write, ending in .zarr.")
    ] = Path("scene.zarr"),
    pattern_folder: Annotated[
        Path | None, typer.Option("--patterns", help="Folder of pattern images.")
    ] = None,
    images: Annotated[Path | None, typer.Option(help="Folder of photographs, same order.")] = None,
    black: Annotated[
        Path | None, typer.Option(help="Photograph under a black pattern, or of ambient light.")
    ] = None,
    white: Annotated[
        Path | None, typer.Option(help="Photograph under a white pattern; one more sample.")
    ] = None,
    mask: Annotated[Path | None, typer.Option(help="Image; pixels at 0 are left out.")] = None,
    black_level: Annotated[
        float | None,
        typer.Option(help="Raw level without any light.", show_default="0"),
    ] = None,
    clip: Clip = None,
    response: ResponseCurve = None,
    solver: Annotated[SolverName, typer.Option(help=SOLVERS_HELP)] = SolverName.ACTIVE_SET,
    fidelity: Annotated[
        Fidelity | None,
        typer.Option(
            help=FIDELITY_HELP, show_default="one-sided; linear for admm, rejection for romp"
        ),
    ] = None,
    regularization: Annotated[
        str,
        typer.Option(
            help="The paper's lambda in units of camera sample; auto (from patterns and samples); "
            "or path (row by row, the value that best predicts patterns held out)."
        ),
    ] = "auto",
    coherent: Annotated[
        bool | None,
        typer.Option(
            "--coherent/--no-coherent",
            help="Learn from neighbouring camera pixels where light is likely; by default with the "
            f"active-set solver and up to {WORTH_IT_UP_TO} patterns.",
        ),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(
            help="Most iterations (rounds for romp, passes for active-set).",
            min=1,
            show_default=f"{ActiveSet().max_passes}; {ADMM().max_iterations} for both ADMMs, "
            "as many as its non-zeros for romp",
        ),
    ] = None,
    signed: Annotated[bool, typer.Option(help="Allow negative light, as the paper does.")] = False,
    background: Annotated[
        bool,
        typer.Option(help="Diffuse light: a coefficient, or coarse blocks, per camera sample."),
    ] = True,
    multi_scale: Annotated[
        bool,
        typer.Option("--multi-scale", help="Projector blocks first, then the pixels that matter."),
    ] = False,
    bin_projector: Annotated[str, typer.Option(help="Projector pixels per bin, 8 or 8x8.")] = "1",
    bin_camera: Annotated[str, typer.Option(help="Camera pixels per bin, 8 or 8x8.")] = "1",
    tile_rows: Annotated[
        int | None,
        typer.Option(
            help="Camera samples solved at a time.", min=1, show_default="as half a gigabyte holds"
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option(help="Refuse images that do not follow the patterns.")
    ] = True,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Estimate T; interrupted runs go on.

    Give a capture folder, or --patterns and --images. A run that was interrupted goes on where it
    stopped if given again.
    """
    _check_source(capture, pattern_folder, images)
    if multi_scale and tile_rows is not None:
        raise InputError(
            "--tile-rows with --multi-scale, which solves strips of camera blocks",
            hint="leave out one of the two",
        )
    started = time.perf_counter()
    fitting = _why_not_coherent(solver, signed, background, multi_scale)
    if coherent and fitting is not None:
        raise InputError(f"--coherent {fitting}", hint="leave out one of the two")
    chosen = _solver(solver, fidelity, iterations)
    given = _given_regularization(regularization)
    claim(output, STORE, overwrite=overwrite)
    opened = _open(capture, pattern_folder, images, black, white, mask, black_level, clip, response)
    opened = opened.bin(projector=size(bin_projector), camera=size(bin_camera))
    opened.check(order=check)
    if regularization == "path":
        if coherent:
            raise InputError(
                "--regularization path chooses for rows by themselves, not with --coherent",
                hint="leave out one of the two",
            )
        coherent = False
    if coherent is None:
        coherent = fitting is None and opened.count <= WORTH_IT_UP_TO
    value = held_out_path(opened).best if regularization == "path" else given
    estimator: PlainEstimator | CoherentEstimator | MultiScaleEstimator
    if multi_scale:
        estimator = MultiScaleEstimator(chosen, value, not signed, background)
    elif coherent and isinstance(chosen, ActiveSet):
        estimator = CoherentEstimator(
            value, fidelity=chosen.fidelity, max_passes=chosen.max_passes, tile_rows=tile_rows
        )
    else:
        estimator = PlainEstimator(chosen, value, not signed, background, tile_rows)
    with progress("estimating", "rows") as report:
        transport = estimator.estimate(
            opened, checkpoint=output, overwrite=overwrite, progress=report
        )
    result = {"output": str(output), "seconds": round(time.perf_counter() - started, 2)}
    result |= summary(transport)
    if as_json:
        show_json(result)
    else:
        show_table(f"{output}", named(summary(transport)))
        unfinished = float(1 - np.mean(transport.diagnostics["converged"]))
        if unfinished > 0.01:
            out.print(
                f"{100 * unfinished:.0f} % of the rows reached the iteration limit; "
                "raise it with --iterations",
                style="yellow",
            )


def _why_not_coherent(
    solver: SolverName, signed: bool, background: bool, multi_scale: bool
) -> str | None:
    """What the coherent estimate does not go with, if anything."""
    if multi_scale:
        return "looks for light in a way of its own, without --multi-scale"
    if solver is not SolverName.ACTIVE_SET:
        return f"needs --solver active-set, not {solver}"
    if signed:
        return "needs light that is not negative, without --signed"
    if not background:
        return "needs the background, without --no-background"
    return None


def _solver(name: SolverName, fidelity: Fidelity | None, iterations: int | None) -> Solver:
    wanted = fidelity or DEFAULT_FIDELITY[name]
    limit: dict[str, int] = {} if iterations is None else {"max_iterations": iterations}
    if name is SolverName.ACTIVE_SET:
        return ActiveSet(wanted) if iterations is None else ActiveSet(wanted, max_passes=iterations)
    if name is SolverName.ADMM:
        if wanted is not Fidelity.LINEAR:
            raise InputError(
                f"the solver admm cannot use the fidelity {wanted}",
                hint="use --solver saturation-admm, or --fidelity linear",
            )
        return ADMM(**limit)
    if name is SolverName.ROMP:
        return ROMP(fidelity=wanted, **limit)
    return SaturationADMM(fidelity=wanted, **limit)


def _check_source(capture: Path | None, patterns: Path | None, images: Path | None) -> None:
    """Whether there is something to estimate from."""
    if capture is not None or (patterns is not None and images is not None):
        return
    if patterns is None and images is None:
        raise InputError(
            "there is nothing to estimate from",
            hint="give a capture folder, or --patterns and --images",
        )
    missing = "--patterns" if patterns is None else "--images"
    raise InputError(f"{missing} is missing", hint="give both folders, or a capture folder")


def _open(
    capture: Path | None,
    patterns: Path | None,
    images: Path | None,
    black: Path | None,
    white: Path | None,
    mask: Path | None,
    black_level: float | None,
    clip: float | None,
    response: str | None,
) -> Capture:
    if capture is not None:
        extras: dict[str, object] = {
            "--patterns": patterns,
            "--images": images,
            "--black": black,
            "--white": white,
        }
        extras |= {"--mask": mask, "--black-level": black_level}
        extras |= {"--clip": clip, "--response": response}
        given = [name for name, value in extras.items() if value is not None]
        if given:
            raise InputError(
                f"a capture folder and {', '.join(given)} were given",
                hint="a capture folder says all that in capture.json; give one or the other",
            )
        return Capture.open(capture, check=False)
    assert patterns is not None
    assert images is not None
    return Capture.from_folders(
        patterns,
        images,
        black=black,
        white=white,
        mask=mask,
        black_level=black_level,
        clip=clip,
        response=response,
        check=False,
    )


def _given_regularization(text: str) -> float | None:
    """The number that was given; None for auto and path."""
    if text in ("auto", "path"):
        return None
    try:
        value = float(text)
    except ValueError:
        raise InputError(
            f"a regularization of {text!r}", hint="use auto, path or a number such as 0.3"
        ) from None
    check_regularization(value)
    return value
