"""`lightmatrix capture`: photographs a scene under patterns with a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.claims import claim, say_what_is_kept
from lightmatrix.cli.terminal import progress, say, show_json, stages
from lightmatrix.defaults import MOST_FRAMES, RIG_FILE, USUAL_FRAMES, USUAL_PATIENCE
from lightmatrix.files.kinds import LIVE_CAPTURE, STORE


def capture(
    output: Annotated[Path, options.output_option("Capture folder to write.")],
    count: Annotated[
        int | None,
        Option(
            "-k",
            "--count",
            help="Number of patterns; with --until the most of them.",
            show_default=f"{USUAL_FRAMES}; {MOST_FRAMES} with --until",
        ),
    ] = None,
    rig: options.RigName = None,
    projector: options.ProjectorName = None,
    camera: options.CameraName = None,
    pattern_folder: Annotated[
        Path | None,
        Option(
            "--patterns",
            help="Folder made by `lightmatrix patterns`.",
            show_default="a random mix of fine and coarse patterns",
        ),
    ] = None,
    density: Annotated[
        float | None,
        Option(help="Share of lit pixels of random patterns.", show_default="as measured"),
    ] = None,
    cell: Annotated[int, Option(help="Projector pixels along a side of each pattern pixel.")] = 1,
    exposure: Annotated[
        float | None,
        Option(
            help="Exposure of all frames, in seconds.", show_default="as measured, possibly several"
        ),
    ] = None,
    settle: options.Settle = None,
    response: Annotated[
        str, Option(help="Response of the camera: linear, gamma:2.2, srgb, FILE.")
    ] = "linear",
    patience: options.Patience = USUAL_PATIENCE,
    rig_file: options.RigFile = Path(RIG_FILE),
    check: Annotated[
        bool, Option(help="Photograph each pattern twice, and keep frames that agree.")
    ] = True,
    until: Annotated[
        str | None,
        Option(
            metavar="ERROR",
            help="Photograph patterns in groups of eight until the estimate states at most this "
            "relative error of T, such as 0.03, or of relit images, such as relighting:0.03; or "
            "more patterns do not help.",
            show_default="all patterns",
        ),
    ] = None,
    store: Annotated[
        Path | None, Option("--estimate", help="Also estimate T, into this .zarr store.")
    ] = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Photograph patterns with a rig; interrupted runs go on.

    The rig is measured first: settle time and flicker, which the rig file keeps, and the exposures
    that the scene needs. Frames that are late, torn, lost or copied are taken again.
    """
    settings = lm.CaptureSettings(
        cell=cell,
        exposure=exposure,
        settle=settle,
        response=response,
        check=check,
        until=until,
    )
    if count is None:
        count = USUAL_FRAMES if until is None else MOST_FRAMES
    claim(output, LIVE_CAPTURE, overwrite=overwrite)
    say_what_is_kept(output, "frames")
    if store is not None:
        claim(store, STORE, overwrite=overwrite)
        say_what_is_kept(store, "tiles")
    with (
        lm.open_rig(rig, projector=projector, camera=camera, patience=patience) as opened,
        stages() as shown,
    ):
        captured = lm.take_capture(
            output,
            opened,
            pattern_folder,
            count=count,
            density=density,
            seed=seed,
            settings=settings,
            keep=rig_file,
            overwrite=overwrite,
            progress=shown.photographed,
            measuring=shown.measured,
        )
    summary: dict[str, Any] = {"output": output, "clipped_share": captured.clipped_share}
    summary |= captured.provenance
    if not as_json:
        _show(summary)
    if store is not None:
        with progress("estimating", "rows") as report:
            transport = lm.estimate(captured, output=store, overwrite=overwrite, progress=report)
        summary["estimate"] = {"output": store, **transport.summary()}
        if not as_json:
            say(f"light transport matrix in {store}")
    if as_json:
        show_json(summary)


def _show(summary: dict[str, Any]) -> None:
    say(
        f"{summary['frames']} frames in {summary['output']}, "
        f"{100 * summary['clipped_share']:.1f} % of the samples clipped"
    )
    until = summary["until"]
    if until:
        reached = "reached" if until["reached"] else "not reached"
        what = " for relighting" if until["relighting"] else ""
        say(f"the target of {100 * until['target']:.2g} %{what} is {reached}: {until['sentence']}")
    again = summary["photographed_again"]
    if again:
        say(f"{sum(again.values())} photographs were taken again:")
        for reason, number in sorted(again.items(), key=lambda item: -item[1]):
            say(f"  {number} x {reason}")
