"""`lightmatrix estimate` and `track`: T from a capture, and after each further photograph."""

from __future__ import annotations

import functools
import time
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.check.finding import Finding
from lightmatrix.cli import options
from lightmatrix.cli.options import Json, Overwrite, Verbose, described, refuse, size
from lightmatrix.cli.source import Source, refuse_unknown_projector, with_source
from lightmatrix.cli.terminal import (
    answer,
    as_options,
    judged_json,
    progress,
    say,
    show_json,
    show_table,
)
from lightmatrix.defaults import ADMM_ITERATIONS, COHERENT_UP_TO, PASSES
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.kinds import REPORT, STORE
from lightmatrix.files.writing import check_output
from lightmatrix.reprs import amount, labelled

# What is written where no other name is given.
_OUTPUT = Path("scene.zarr")

SolverName = Literal["active-set", "saturation-admm", "admm", "romp", "total-variation"]
FidelityName = Literal["linear", "one-sided", "clipped", "rejection"]
# Options under the headings of `--help-all`.
_solving = functools.partial(Option, rich_help_panel="How to solve")
_resource = functools.partial(Option, rich_help_panel="Memory and processes")
_reporting = functools.partial(Option, rich_help_panel="Check and report")


@with_source()
@described(
    output="The store to write, ending in .zarr. For patterns in colour, or several projectors, a "
    "folder of stores.",
    solver=_solving(
        help="active-set (one-sided, rejection, linear; certifies a duality gap), "
        "saturation-admm (clipped, one-sided, rejection, linear), admm (linear), "
        "romp (linear, rejection), total-variation (one-sided; for single-pixel detectors, "
        "which see the whole scene)."
    ),
    fidelity=_solving(
        help="How clipped samples count: one-sided (a lower bound, convex), clipped (the paper's "
        "Eq. 6), rejection (left out), linear (at their value).",
        show_default="one-sided; linear for admm, rejection for romp",
    ),
    regularization=_solving(
        help="How strongly faint light is suppressed (the paper's lambda). Leave it at auto."
    ),
    coherent=_solving(
        "--coherent/--no-coherent",
        help="Let camera pixels learn from their neighbours. The default with the active-set "
        f"solver and up to {COHERENT_UP_TO} patterns, unless photographs held out are predicted "
        "better without.",
    ),
    iterations=_solving(
        help="Most iterations per row (rounds of romp, passes of active-set).",
        min=1,
        show_default=f"{PASSES}; {ADMM_ITERATIONS} for both ADMMs, "
        "as many as its non-zeros for romp",
    ),
    signed=_solving(help="Allow negative light, as the paper does."),
    background=_solving(
        help="Estimate faint light from everywhere, as coarse cells per camera sample."
    ),
    multi_scale=_solving(
        "--multi-scale", help="Solve for projector blocks first, then for the pixels that matter."
    ),
    bin_projector=_solving(help="Projector pixels per bin, 8 or 8x8."),
    bin_camera="Camera pixels per bin, 8 or 8x8; averages them.",
    tile_rows=_resource(
        help="Camera samples to solve at a time.", min=1, show_default="as half a gigabyte holds"
    ),
    memory=_resource(
        help="Most memory to take, such as 4GiB. The estimate solves fewer camera samples at a "
        "time to stay within it, and refuses before it starts if it cannot.",
        show_default="what is free",
    ),
    workers=_resource(
        help="Processes on this machine that solve rows. They share its cores and --memory; the "
        "result is the same. Needs the extra cluster.",
        min=1,
        show_default="this one",
    ),
    cluster=_resource(
        metavar="ADDRESS",
        help="Let the workers of a Dask scheduler solve rows, such as tcp://10.0.0.1:8786. All "
        "must see the capture under the same path. --memory is per worker.",
    ),
    check=_reporting(
        help="Check the frames first, and refuse images that do not follow the patterns and "
        "estimates that do not fit into memory."
    ),
    correct=_reporting(
        metavar="auto|none|NAME,...",
        help="Which faults of the rig to look for in the photographs and to take out of T: all, "
        "none, or some of gain, exposure, ambient, shift, rows, previous, camera-curve, "
        "projector-curve, crosstalk, sharpening, camera-sharpening, dynamic-contrast, "
        "tone-mapping, black, camera-blur.",
    ),
    report=Option(
        metavar="DIR",
        help="Write a report too, which tests T on photographs that the estimate has not seen.",
    ),
    viewer=_reporting("--viewer", help="Add the viewer to the report, as viewer.html."),
    geometry=_reporting(
        metavar="GEOMETRY.json",
        help="Where camera and projector stand, for depth and normals in the report: a file of "
        "`calibrate`.",
    ),
    dry_run=_resource("--dry-run", help="Print the memory and time it would take, and stop."),
)
def estimate(
    output: Path = _OUTPUT,
    *,
    source: Source,
    solver: SolverName = "active-set",
    fidelity: FidelityName | None = None,
    regularization: str = "auto",
    coherent: bool | None = None,
    iterations: int | None = None,
    signed: bool = False,
    background: bool = True,
    multi_scale: bool = False,
    bin_projector: str = "1",
    bin_camera: str = "1",
    tile_rows: int | None = None,
    memory: str | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    check: bool = True,
    correct: str = "auto",
    report: Path | None = None,
    viewer: bool = False,
    geometry: Path | None = None,
    dry_run: bool = False,
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
    # A regularization is auto, or a number.
    number: str | float = regularization
    with suppress(ValueError):
        number = float(regularization)
    settings = lm.EstimateSettings(
        solver, fidelity, number, coherent, multi_scale, background,
        signed, iterations, tile_rows, memory, workers, cluster,
    )  # fmt: skip
    # A mistyped input is named first, whatever the output.
    capture = source.open(finds_projector=True)
    if isinstance(capture.patterns, lm.ColourPatterns):
        refuse_unknown_projector(capture)
        others = {"report": report, "viewer": viewer, "dry_run": dry_run, "geometry": geometry}
        # An estimate in colour has no settings.
        usual = asdict(lm.EstimateSettings(coherent=coherent or None))
        set_by_user = {name: value != usual[name] for name, value in asdict(settings).items()}
        set_by_user |= {**others, "correct": correct != "auto"}
        named = {f"--{name.replace('_', '-')}": value for name, value in set_by_user.items()}
        refuse(named, "patterns in colour")
    if isinstance(capture.patterns, lm.ColourPatterns) or capture.projectors:
        if output == _OUTPUT:
            output = Path("scene")
        if output.suffix.lower() == ".zarr":
            what = "several projectors" if capture.projectors else "patterns in colour"
            hint = f"name a folder: -o {output.with_suffix('')}"
            raise InputError(f"{output} for {what}, whose T is a folder of stores", hint=hint)
    if not isinstance(capture.patterns, lm.ColourPatterns):
        for name, given in (("--viewer", viewer), ("--geometry", geometry)):
            if given and report is None:
                hint = "add --report; or run `lightmatrix view` or `triangulate` on the estimate"
                raise InputError(f"{name} without --report", hint=hint)
        if report is not None:
            if output.absolute() in (report.absolute(), *report.absolute().parents):
                hint = "choose another folder for the report"
                raise InputError(f"{report}: is where the estimate goes", hint=hint)
            check_output(report, REPORT, overwrite=overwrite)
    capture = capture.bin(projector=size(bin_projector), camera=size(bin_camera))
    if isinstance(capture.patterns, lm.ColourPatterns):
        colour = lm.estimate_colour(capture, output=output, overwrite=overwrite, check=check)
        judged = lm.verdicts(colour.red)
        stores = {name: str(output / f"{name}.zarr") for name in COLOURS}
        seconds = round(time.perf_counter() - started, 2)
        result = {"output": str(output), "stores": stores, "seconds": seconds}
        result |= judged_json(judged) | {"findings": colour.red.provenance["findings"]}
        names = ", ".join(f"{name}.zarr" for name in COLOURS)
        answer(as_json, result, *judged.lines(), f"{names} in {output}")
        return
    rig = None if geometry is None else lm.geometry_of(capture, geometry)
    if dry_run:
        needed = lm.estimate_resources(capture, settings)
        free = f"{amount(needed.available)} are {'allowed' if needed.limited else 'free'}"
        advice = [as_options(needed.advice)] if needed.advice else []
        answer(as_json, needed.as_dict(), f"the estimate takes {needed} ({free})", *advice)
        return
    transport = lm.estimate(
        capture, **asdict(settings), output=output, overwrite=overwrite, check=check,
        correct=correct if correct in ("auto", "none") else correct.split(","),
    )  # fmt: skip
    seconds, outcome = round(time.perf_counter() - started, 2), None
    findings = transport.provenance["findings"]
    if report is not None:
        with progress("predicting held-out photographs", "rows") as step:
            outcome = lm.report(
                report,
                transport,
                capture,
                # The truth, if `simulate` left it beside the frames.
                truth=_truth(source.folder, transport),
                # The report solves a small part of the camera, for which this process suffices.
                estimator=replace(settings, workers=None, cluster=None),
                title=output.name,
                findings=[Finding(**each) for each in findings],
                viewer=viewer,
                geometry=rig,
                overwrite=overwrite,
                progress=step,
            )
    judged = lm.Verdicts.from_dict(outcome["verdicts"]) if outcome else lm.verdicts(transport)
    if as_json:
        result = {"output": str(output), "seconds": seconds} | judged_json(judged)
        if found := transport.provenance.get("found_response"):
            result["response"] = {key: found[key] for key in found if key != "light"}
        result |= transport.summary() | {"findings": findings}
        show_json(result if outcome is None else {**result, "report": outcome})
        return
    for line in judged.lines():
        say(line)
    summary = transport.summary()
    if capture.projectors:
        summary["projector"] = " and ".join(f"{rows} x {cols}" for rows, cols in capture.projectors)
    show_table(options.written_stores(output), labelled(summary, main_only=not verbose))
    # All rows but one in a hundred should converge.
    if summary.get("converged_rows", 1) < 0.99:
        say("some rows reached the iteration limit: raise it with --iterations", style="yellow")
    if report is not None:
        say(f"report: {(report / 'report.html').absolute()}")


def _truth(folder: Path | None, transport: lm.LightTransport) -> lm.LightTransport | None:
    """The true T, if `simulate` wrote it and the capture was not binned."""
    file = None if folder is None else folder / "truth.npz"
    if file is None or not file.is_file():
        return None
    known = lm.truth(str(file)).transport().cropped_like(transport)
    shapes = (known.camera_shape, known.projector_shape)
    return known if shapes == (transport.camera_shape, transport.projector_shape) else None


@described(
    folder=Argument(metavar="CAPTURE", help="A capture folder, or a packed capture."),
    output="The store to write in the end, ending in .zarr.",
    window=Option(
        "-k", "--window", min=8, help="Photographs that T is estimated from, and that slide along."
    ),
    watch=Option(
        metavar="DIR",
        help="Follow a folder of further photographs, those that are there and those that another "
        "program leaves there. Their names end in a number that says the pattern, counted as in "
        "the capture; after the last pattern comes the first. It ends when none comes for half a "
        "minute, or with Ctrl-C.",
        show_default="the photographs of the capture after the window",
    ),
    first=Option(
        min=0,
        help="With --watch, the number in the name of a photograph of the first pattern.",
        show_default="that of the capture's first photograph",
    ),
)
def track(
    folder: Path,
    output: Path,
    window: int = 32,
    watch: Path | None = None,
    first: int | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Let T follow a scene in which things move.

    Rows of T that follow the photographs stay as they are. Those that changed are estimated again,
    and unknown until they predict photographs; `show SCENE.zarr changes` draws them.
    """
    check_output(output, STORE, overwrite=overwrite)
    capture = lm.Capture.open(folder)
    start = capture.select(range(min(window, capture.count)))
    if watch is None and start.count == capture.count:
        hint = f"use a window of less than {capture.count}"
        raise InputError(f"{folder}: has no photographs after the window", hint=hint)
    if watch is not None and not watch.is_dir():
        raise InputError(f"{watch}: no such folder", hint="make it first, or check the name")
    with progress("estimating", "rows") as report:
        tracker = lm.Tracker(start, lm.estimate(start, progress=report))
    lines, offset = list[dict[str, Any]](), start.count if watch is None else 0
    if watch is None:
        steps = tracker.follow(capture.select(range(start.count, capture.count)))
    else:
        steps = tracker.watch(watch, capture, first=first)
    try:
        with suppress(KeyboardInterrupt):
            for step in steps:
                shares = {n: float(getattr(step, n).mean()) for n in ("changed", "unknown")}
                line = {"photograph": step.name, "pattern": step.pattern + offset}
                lines.append({**line, "missed": step.missed, **shares, "seconds": step.seconds})
                if not as_json:
                    named = [f"{100 * lines[-1][n]:.2g} % {n}" for n in ("missed", *shares)]
                    said = f"{step.name}, pattern {step.pattern + offset}: {', '.join(named)}"
                    say(f"{said}; {step.seconds:.2f} s")
    finally:
        # T as far as it got is saved, whatever ends the photographs.
        transport = tracker.transport
        lm.save(output, transport, overwrite=overwrite)
    judged = lm.verdicts(transport)
    result = {"output": output, **judged_json(judged), "photographs": lines, **transport.summary()}
    text = f"{output}: T after {len(lines)} further photographs"
    if not lines:
        text = f"{output}: T of the first {start.count} photographs; no further one was taken in"
    answer(as_json, result, *judged.lines(), text)
