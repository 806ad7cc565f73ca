"""`lightmatrix estimate`: from a capture to its light transport matrix."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import lightmatrix as lm
from lightmatrix.cli.claims import claim, say_what_is_kept
from lightmatrix.cli.options import (
    ADMM_ITERATIONS,
    COHERENT_UP_TO,
    PASSES,
    Json,
    Overwrite,
    Verbose,
    size,
)
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import progress, say, show_json, show_table, warn
from lightmatrix.diagnosis.refusals import refuse_disorder, refuse_unusable
from lightmatrix.outputs.kinds import REPORT, STORE
from lightmatrix.transport.labels import labelled

if TYPE_CHECKING:
    from lightmatrix import Capture, EstimateSettings, Finding, LightTransport, ResourceEstimate

SolverName = Literal["active-set", "saturation-admm", "admm", "romp"]
FidelityName = Literal["linear", "one-sided", "clipped", "rejection", "likelihood"]
# What an estimate takes is said from so many seconds on, or this share of the free memory.
_LONG, _MUCH = 60, 0.25
# The advice to raise --iterations is given where a smaller share of the rows converged.
_FEW_CONVERGED = 0.99
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


@with_source()
def estimate(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The store to write, ending in .zarr.")
    ] = Path("scene.zarr"),
    *,
    source: Source,
    solver: Annotated[SolverName, typer.Option(help=SOLVERS_HELP)] = "active-set",
    fidelity: Annotated[
        FidelityName | None,
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
            f"active-set solver and up to {COHERENT_UP_TO} patterns.",
        ),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(
            help="Most iterations (rounds for romp, passes for active-set).",
            min=1,
            show_default=f"{PASSES}; {ADMM_ITERATIONS} for both ADMMs, "
            "as many as its non-zeros for romp",
        ),
    ] = None,
    signed: Annotated[bool, typer.Option(help="Allow negative light, as the paper does.")] = False,
    background: Annotated[
        bool,
        typer.Option(help="Diffuse light: a coefficient, or coarse cells, per camera sample."),
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
    memory: Annotated[
        str | None,
        typer.Option(
            help="Memory that it may take at most, such as 4GiB; said before, and kept by solving "
            "fewer camera samples at a time.",
            show_default="what is free",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Processes on this machine that solve rows, and share its cores and --memory; the "
            "result is the same. Needs the extra cluster.",
            min=1,
            show_default="this one",
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Let the workers of the Dask scheduler at this address solve rows, such as "
            "tcp://10.0.0.1:8786; all see capture and output by the same paths. --memory is that "
            "of each.",
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            help="Refuse images that do not follow the patterns, and what does not fit into "
            "memory; say what else is wrong."
        ),
    ] = True,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="DIR",
            help="Write a report as well, with photographs held out of a second estimate.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what memory and time it will take, and stop.")
    ] = False,
    verbose: Verbose = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Estimate T; interrupted runs go on.

    Give a capture folder; or patterns and images, each a folder or a stack. A run that was
    interrupted goes on where it stopped if given again.
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
    if not dry_run:
        claim(output, STORE, overwrite=overwrite)
        if report is not None:
            claim(report, REPORT, overwrite=overwrite)
    taken = source.open()
    opened = taken.bin(projector=size(bin_projector), camera=size(bin_camera))
    resources = lm.estimate_resources(opened, settings)
    if dry_run:
        _show_resources(resources, as_json)
        return
    _warn_of_resources(resources, check)
    say_what_is_kept(output, "tiles", enough=not as_json and report is None)
    # Workers are checked before the frames are read, which takes longer.
    with lm.open_workers(settings, resources) as pool:
        if pool is not None:
            warn(str(pool))
        findings = _findings(opened, taken, check)
        with progress("estimating", "rows") as step:
            transport = lm.choose_estimator(opened, settings, resources).estimate(
                opened, output=output, overwrite=overwrite, progress=step, pool=pool
            )
    seconds = round(time.perf_counter() - started, 2)
    told = None
    if report is not None:
        # Photographs are held out of a part of the camera, which this process does by itself.
        here = replace(settings, workers=None, cluster=None)
        told = _report(report, output, source, transport, opened, here, findings, overwrite)
    summary = transport.summary()
    if as_json:
        found = [finding.as_dict() for finding in findings]
        more = {"findings": found} if told is None else {"findings": found, "report": told}
        took = {"seconds": seconds, "needs": resources.as_dict()}
        show_json({"output": str(output), **took, **summary, **more})
        return
    if told is None:
        say(str(lm.verdict(transport)))
    else:
        say(str(lm.Verdict(told["verdict"], told["sentence"])))
    show_table(str(output), labelled(summary, main_only=not verbose))
    if summary["converged_rows"] < _FEW_CONVERGED:
        say("some rows reached the iteration limit: raise it with --iterations", style="yellow")
    if report is not None:
        say(f"report: {(report / 'report.html').absolute()}")


def _show_resources(resources: ResourceEstimate, as_json: bool) -> None:
    """Show the memory and time that the estimate would take, for --dry-run."""
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
    much = resources.memory > _MUCH * resources.available
    if much or (resources.seconds or 0) > _LONG:
        warn(f"this takes {resources}")
    if resources.advice:
        warn(f"less: {resources.advice}", style="yellow")


def _findings(opened: Capture, taken: Capture, check: bool) -> list[Finding]:
    """What is wrong with the frames, told; what makes an estimate impossible is refused."""
    refuse_unusable(opened)
    findings = lm.check(taken) if check else []
    refuse_disorder(findings)
    # What else is wrong spoils less than all of it.
    for finding in findings:
        warn(f"{finding.kind}: {finding.message}\n  {finding.advice}", style="yellow")
    return findings


def _report(
    folder: Path,
    store: Path,
    source: Source,
    transport: LightTransport,
    capture: Capture,
    settings: EstimateSettings,
    findings: list[Finding],
    overwrite: bool,
) -> dict[str, Any]:
    """The report, with the truth where `simulate` left it beside the frames."""
    with progress("predicting photographs held out", "rows") as step:
        return lm.report(
            folder,
            transport,
            capture,
            truth=_truth(source.folder, transport),
            estimator=settings,
            title=store.name,
            findings=findings,
            overwrite=overwrite,
            progress=step,
        )


def _truth(folder: Path | None, transport: LightTransport) -> LightTransport | None:
    """What was photographed, if it is known and was not binned since."""
    file = None if folder is None else folder / "truth.npz"
    if file is None or not file.is_file():
        return None
    known = lm.truth(str(file)).transport().cropped_like(transport)
    shapes = (known.camera_shape, known.projector_shape)
    return known if shapes == (transport.camera_shape, transport.projector_shape) else None


def _regularization(text: str) -> str | float:
    """A number, or the word as it is."""
    try:
        return float(text)
    except ValueError:
        return text
