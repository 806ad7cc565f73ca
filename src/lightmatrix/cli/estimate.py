"""`lightmatrix estimate`: from a capture to its light transport matrix."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import lightmatrix as lm
from lightmatrix.cli.claims import claim, say_what_is_kept
from lightmatrix.cli.estimate_colour import estimate_colour, in_colour
from lightmatrix.cli.estimate_preparation import prepared
from lightmatrix.cli.estimate_report import check_report, write_report
from lightmatrix.cli.options import (
    ADMM_ITERATIONS,
    COHERENT_UP_TO,
    PASSES,
    Json,
    Overwrite,
    Verbose,
    size,
)
from lightmatrix.cli.source import Source, refuse_unknown_projector, with_source
from lightmatrix.cli.terminal import progress, say, show_json, show_table, warn
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import REPORT, STORE
from lightmatrix.transport.matrix import labelled

if TYPE_CHECKING:
    from lightmatrix import (
        Capture,
        LightTransport,
        ResourceEstimate,
        RigGeometry,
    )

# The command says what an estimate takes if it takes longer than this many seconds, or more than
# this share of the free memory. Chosen by hand: shorter and smaller ones need no warning.
_LONG, _MUCH = 60, 0.25
# The command advises to raise --iterations if a smaller share of the rows converged.
_ENOUGH_CONVERGED = 0.99

# What is written where no other name is given.
_OUTPUT = Path("scene.zarr")

# Headings of the options in `--help`.
_SOLVER, _RESOLUTION, _RESOURCES = "How to solve", "Resolution", "Memory and processes"

SolverName = Literal["active-set", "saturation-admm", "admm", "romp"]
FidelityName = Literal["linear", "one-sided", "clipped", "rejection", "likelihood"]
Solver = Annotated[
    SolverName,
    typer.Option(
        rich_help_panel=_SOLVER,
        help="active-set (one-sided, rejection, linear; certifies a duality gap), "
        "saturation-admm (clipped, one-sided, likelihood, rejection, linear), admm (linear), "
        "romp (linear, rejection).",
    ),
]
FidelityOption = Annotated[
    FidelityName | None,
    typer.Option(
        rich_help_panel=_SOLVER,
        help="How clipped samples count: one-sided (a lower bound, convex), clipped (the paper's "
        "Eq. 6), likelihood (a lower bound with a soft edge), rejection (left out), linear (at "
        "their value).",
        show_default="one-sided; linear for admm, rejection for romp",
    ),
]
Regularization = Annotated[
    str,
    typer.Option(
        rich_help_panel=_SOLVER,
        help="The paper's lambda, in units of camera sample; auto (from patterns and samples); "
        "or path (row by row, the value that best predicts held-out photographs).",
    ),
]
Coherent = Annotated[
    bool | None,
    typer.Option(
        "--coherent/--no-coherent",
        rich_help_panel=_SOLVER,
        help="Let camera pixels learn from their neighbours. The default with the active-set "
        f"solver and up to {COHERENT_UP_TO} patterns, unless photographs held out are predicted "
        "better without.",
    ),
]
Iterations = Annotated[
    int | None,
    typer.Option(
        rich_help_panel=_SOLVER,
        help="Most iterations per row (rounds of romp, passes of active-set).",
        min=1,
        show_default=f"{PASSES}; {ADMM_ITERATIONS} for both ADMMs, "
        "as many as its non-zeros for romp",
    ),
]
Signed = Annotated[
    bool, typer.Option(rich_help_panel=_SOLVER, help="Allow negative light, as the paper does.")
]
Background = Annotated[
    bool,
    typer.Option(
        rich_help_panel=_SOLVER,
        help="Estimate faint light from everywhere, as coarse cells per camera sample.",
    ),
]
MultiScale = Annotated[
    bool,
    typer.Option(
        "--multi-scale",
        rich_help_panel=_SOLVER,
        help="Solve for projector blocks first, then for the pixels that matter.",
    ),
]
BinProjector = Annotated[
    str, typer.Option(rich_help_panel=_RESOLUTION, help="Projector pixels per bin, 8 or 8x8.")
]
BinCamera = Annotated[
    str, typer.Option(rich_help_panel=_RESOLUTION, help="Camera pixels per bin, 8 or 8x8.")
]
TileRows = Annotated[
    int | None,
    typer.Option(
        rich_help_panel=_RESOURCES,
        help="Camera samples to solve at a time.",
        min=1,
        show_default="as half a gigabyte holds",
    ),
]
Memory = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=_RESOURCES,
        help="Most memory to take, such as 4GiB. The estimate solves fewer camera samples at a "
        "time to stay within it, and refuses before it starts if it cannot.",
        show_default="what is free",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        rich_help_panel=_RESOURCES,
        help="Processes on this machine that solve rows. They share its cores and --memory; the "
        "result is the same. Needs the extra cluster.",
        min=1,
        show_default="this one",
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=_RESOURCES,
        metavar="ADDRESS",
        help="Let the workers of a Dask scheduler solve rows, such as tcp://10.0.0.1:8786. All "
        "must see capture and output under the same paths. --memory is per worker.",
    ),
]
Check = Annotated[
    bool,
    typer.Option(
        help="Check the frames first, and refuse images that do not follow the patterns and "
        "estimates that do not fit into memory."
    ),
]


@with_source()
def estimate(
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="The store to write, ending in .zarr. For patterns in colour: a folder of three.",
        ),
    ] = _OUTPUT,
    *,
    source: Source,
    solver: Solver = "active-set",
    fidelity: FidelityOption = None,
    regularization: Regularization = "auto",
    coherent: Coherent = None,
    iterations: Iterations = None,
    signed: Signed = False,
    background: Background = True,
    multi_scale: MultiScale = False,
    bin_projector: BinProjector = "1",
    bin_camera: BinCamera = "1",
    tile_rows: TileRows = None,
    memory: Memory = None,
    workers: Workers = None,
    cluster: Cluster = None,
    check: Check = True,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write a report too, which tests T on photographs that the estimate has not seen.",
        ),
    ] = None,
    viewer: Annotated[
        bool, typer.Option("--viewer", help="Add the viewer to the report, as viewer.html.")
    ] = False,
    geometry: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG.json",
            help="Where camera and projector stand, for depth and normals in the report: a file of "
            "`calibrate`.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the memory and time it would take, and stop.")
    ] = False,
    verbose: Verbose = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Estimate T from a capture.

    Give a capture folder; or patterns and images, each as a folder or a stack. After an
    interruption, the same command goes on where it stopped. Patterns in colour give a folder with
    a matrix of each primary, in one go.
    """
    started = time.perf_counter()
    settings = lm.EstimateSettings(
        solver=solver,
        fidelity=fidelity,
        regularization=_regularization(regularization),
        coherent=coherent,
        multi_scale=multi_scale,
        background=background,
        signed=signed,
        iterations=iterations,
        tile_rows=tile_rows,
        memory=memory,
        workers=workers,
        cluster=cluster,
    )
    # A mistyped input is named first, whatever the output.
    whole = source.open(finds_projector=True)
    if in_colour(whole):
        refuse_unknown_projector(whole)
        estimate_colour(
            whole.bin(projector=size(bin_projector), camera=size(bin_camera)),
            Path("scene") if output == _OUTPUT else output,
            settings,
            {"--report": report, "--viewer": viewer, "--dry-run": dry_run, "--geometry": geometry},
            check=check,
            overwrite=overwrite,
            as_json=as_json,
        )
        return
    check_report(output, report, viewer)
    if not dry_run:
        claim(output, STORE, overwrite=overwrite)
        if report is not None:
            claim(report, REPORT, overwrite=overwrite)
    capture = whole.bin(projector=size(bin_projector), camera=size(bin_camera))
    rig = _geometry(capture, geometry, report)
    resources = lm.estimate_resources(capture, settings)
    if dry_run:
        _show_resources(resources, as_json)
        return
    _warn_of_resources(resources, check)
    say_what_is_kept(output, "tiles", enough=not as_json and report is None)
    # Workers are checked before the frames are read, which takes longer.
    with lm.open_workers(settings, resources) as pool:
        if pool is not None:
            warn(str(pool))
        lm.refuse_unusable(capture)
        capture, found, estimator, findings = prepared(capture, whole, settings, resources, check)
        with progress("estimating", "rows") as step:
            transport = estimator.estimate(
                capture,
                output=output,
                overwrite=overwrite,
                findings=findings,
                progress=step,
                pool=pool,
            )
    seconds, outcome = round(time.perf_counter() - started, 2), None
    if report is not None:
        outcome = write_report(
            report, output, source, transport, capture, settings, findings, viewer, rig, overwrite
        )
    judged = lm.Verdicts.from_dict(outcome["verdicts"]) if outcome else lm.verdicts(transport)
    if as_json:
        overall = judged.transport
        result = {"output": str(output), "seconds": seconds, "resources": resources.as_dict()}
        result |= {"verdict": overall.level, "sentence": overall.sentence}
        result |= {"verdicts": judged.as_dict()}
        result |= {} if found is None else {"response": found.as_dict()}
        result |= transport.summary() | {"findings": [finding.as_dict() for finding in findings]}
        show_json(result if outcome is None else {**result, "report": outcome})
        return
    for line in judged.lines():
        say(line)
    _show_summary(output, transport, verbose)
    if report is not None:
        say(f"report: {(report / 'report.html').absolute()}")


def _geometry(capture: Capture, geometry: Path | None, report: Path | None) -> RigGeometry | None:
    """The geometry for the report; one of other images is named before the estimate begins."""
    if geometry is None:
        return None
    if report is None:
        raise InputError(
            "--geometry without --report",
            hint="add --report, which shows depth and normals; or run `lightmatrix triangulate` "
            "on the estimate",
        )
    return lm.geometry_of(capture, geometry)


def _show_summary(output: Path, transport: LightTransport, verbose: bool) -> None:
    """Print the numbers of an estimate, and advice if too few rows converged."""
    summary = transport.summary()
    show_table(str(output), labelled(summary, main_only=not verbose))
    if summary["converged_rows"] < _ENOUGH_CONVERGED:
        say("some rows reached the iteration limit: raise it with --iterations", style="yellow")


def _show_resources(resources: ResourceEstimate, as_json: bool) -> None:
    """Print the memory and time that the estimate would take, for --dry-run."""
    if as_json:
        show_json(resources.as_dict())
        return
    whose = "allowed" if resources.limited else "free"
    free = f"{resources.available / 2**30:.3g} GiB are {whose}"
    say(f"the estimate takes {resources} ({free})", style=None if resources.fits else "yellow")
    if resources.advice:
        say(resources.advice)


def _warn_of_resources(resources: ResourceEstimate, check: bool) -> None:
    """Refuse an estimate that does not fit, and warn of one that takes long or much."""
    if check or resources.limited:
        resources.check()
    if resources.memory > _MUCH * resources.available or (resources.seconds or 0) > _LONG:
        warn(f"this takes {resources}")
    if resources.advice:
        warn(f"less: {resources.advice}", style="yellow")


def _regularization(text: str) -> str | float:
    """A number if the text is one, otherwise the text."""
    try:
        return float(text)
    except ValueError:
        return text
