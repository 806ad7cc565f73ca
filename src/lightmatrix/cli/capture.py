"""`lightmatrix capture`: photographs a scene under patterns with a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from typer import Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.options import described
from lightmatrix.cli.terminal import Stages, progress, say, show_json
from lightmatrix.defaults import MOST_FRAMES, RIG_FILE, USUAL_FRAMES
from lightmatrix.files.kinds import STORE
from lightmatrix.files.writing import check_output


@described(
    output="Capture folder to write.",
    count=Option(
        "-k",
        "--count",
        help="Number of patterns; with --until the most of them.",
        show_default=f"{USUAL_FRAMES}; {MOST_FRAMES} with --until",
    ),
    pattern_folder=Option(
        "--patterns",
        help="Folder made by `lightmatrix patterns`.",
        show_default="a random mix of fine and coarse patterns",
    ),
    density=Option(help="Share of lit pixels of random patterns.", show_default="as measured"),
    cell="Projector pixels along a side of each pattern pixel.",
    exposure=Option(
        help="Exposure of all frames, in seconds.", show_default="as measured, possibly several"
    ),
    response="Response of the camera: linear, gamma:2.2, srgb, FILE.",
    check="Photograph each pattern twice, and keep frames that agree.",
    until=Option(
        metavar="ERROR",
        help="Photograph patterns in groups of eight until the estimate states at most this "
        "relative error of T, such as 0.03, or of relit images, such as relighting:0.03; or "
        "more patterns do not help.",
        show_default="all patterns",
    ),
    store=Option("--estimate", help="Also estimate T, into this .zarr store."),
)
def capture(
    output: Path,
    count: int | None = None,
    rig: options.RigName = None,
    projector: options.ProjectorName = None,
    camera: options.CameraName = None,
    pattern_folder: Path | None = None,
    density: float | None = None,
    cell: int = 1,
    exposure: float | None = None,
    settle: options.Settle = None,
    response: str = "linear",
    rig_file: options.RigFile = Path(RIG_FILE),
    check: bool = True,
    until: str | None = None,
    store: Path | None = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Photograph patterns with a rig; interrupted runs go on.

    The rig is measured first: settle time and flicker, which the rig file keeps, and the exposures
    that the scene needs. Frames that are late, torn, lost or copied are taken again.
    """
    settings = lm.CaptureSettings(cell, exposure, settle, response, check, until)
    if count is None:
        count = USUAL_FRAMES if until is None else MOST_FRAMES
    if store is not None:
        check_output(store, STORE, overwrite=overwrite)
    with lm.open_rig(rig, projector=projector, camera=camera) as opened, Stages() as shown:
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
