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
from lightmatrix.errors import OutputError
from lightmatrix.files.kinds import PROJECTOR_STORES, STORE
from lightmatrix.files.running import setting_differences
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
    projector: options.ProjectorNames = None,
    camera: options.CameraNames = None,
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
    that the scene needs. Frames that are late, torn, lost or copied are taken again. Several
    projectors show random patterns at once; several cameras photograph them in turn, each into a
    folder of its own: camera-1, camera-2, ...
    """
    settings = lm.CaptureSettings(cell, exposure, settle, response, check, until)
    if count is None:
        count = USUAL_FRAMES if until is None else MOST_FRAMES
    scene = "" if rig is None else rig.partition(":")[2].partition(",")[0]
    known = lm.scenes() if scene else ()
    devices = {one.name: (one.projectors, one.cameras) for one in known}.get(scene, (1, 1))
    addresses: list[str | None] = [*camera] if camera else [None]
    rigs = [(rig, one) for one in addresses]
    if devices[1] > 1 and not camera and "camera=" not in str(rig):
        rigs = [(f"{rig},camera={k}", None) for k in range(1, devices[1] + 1)]
    kind = PROJECTOR_STORES if max(devices[0], len(projector or ())) > 1 else STORE

    def place(path: Path, number: int) -> Path:
        return path if len(rigs) == 1 else path / f"camera-{number}"

    numbers = range(1, len(rigs) + 1)
    # An interrupted run had finished these cameras, and may have estimated T of them.
    finished = {k for k in numbers if not overwrite and lm.Capture.lies_at(place(output, k))}
    finished = finished if len(finished) < len(rigs) else set()
    estimated = {k for k in finished if store is not None and place(store, k).exists()}
    if store is not None:
        for number in set(numbers) - estimated:
            check_output(place(store, number), kind, overwrite=overwrite)
    summaries: list[dict[str, Any]] = []
    for number, (address, one) in zip(numbers, rigs, strict=True):
        folder = place(output, number)
        own = rig_file if len(rigs) == 1 else rig_file.with_stem(f"{rig_file.stem}-{number}")
        with lm.open_rig(address, projector=projector, camera=one) as opened, Stages() as shown:
            captured = (
                _finished(folder, opened, settings, pattern_folder, count)
                if number in finished
                else lm.take_capture(
                    folder, opened, pattern_folder, count=count, density=density, seed=seed,
                    settings=settings, keep=own, overwrite=overwrite,
                    progress=shown.photographed, measuring=shown.measured,
                )
            )  # fmt: skip
        summary: dict[str, Any] = {"output": folder, "clipped_share": captured.clipped_share}
        summaries.append({**summary, **captured.provenance})
        if not as_json:
            _show(summaries[-1])
        if store is not None and number not in estimated:
            target = place(store, number)
            with progress("estimating", "rows") as report:
                written: dict[str, Any] = {"output": target, "overwrite": overwrite}
                transport = lm.estimate(captured, **written, progress=report)
            summaries[-1]["estimate"] = {"output": target, **transport.summary()}
            if not as_json:
                say(f"light transport matrix in {options.written_stores(target)}")
    if as_json:
        show_json(summaries[0] if len(rigs) == 1 else {"output": output, "cameras": summaries})


def _finished(
    folder: Path, rig: Any, settings: lm.CaptureSettings, patterns: Path | None, count: int
) -> lm.Capture:
    """A camera's capture of an interrupted run, which must have the devices and settings of now."""
    captured = lm.Capture.open(folder)
    about = captured.provenance
    devices = about.get("rig") or {}
    before = {name: devices.get(name, {}).get("name") for name in ("projector", "camera")}
    now = {"projector": rig.projector.info()["name"], "camera": rig.camera.info()["name"]}
    before |= {name: about.get(name) for name in ("cell", "checked", "patterns")}
    shown = count if patterns is None else lm.read_patterns(patterns).count
    now |= {"cell": settings.cell, "checked": settings.check, "patterns": shown}
    if before != now:
        raise OutputError(
            f"{folder}: was captured otherwise ({setting_differences(before, now)})",
            hint="capture with those settings, pass overwrite=True, or choose another output",
        )
    return captured


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
