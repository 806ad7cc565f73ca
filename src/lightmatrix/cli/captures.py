"""`lightmatrix convert`, `check` and `pack`: a capture before its estimate."""

from pathlib import Path
from typing import Literal

import typer
from typer import Argument

import lightmatrix as lm
from lightmatrix.cli.options import FIND_HELP, Json, Overwrite, described
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import answer, as_options, progress, say, show_json
from lightmatrix.reprs import amount


@described(
    folder=Argument(metavar="FOLDER", help="The folder of the other program."),
    output="The capture folder to make.",
    channel="The channel of colour images that is kept.",
    response=FIND_HELP,
)
def convert(
    folder: Path,
    output: Path = Path("capture"),
    channel: Literal["red", "green", "blue"] = "green",
    response: str = "linear",
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Make a capture folder from other layouts.

    FOLDER is a setup of CompenNet's data (with cam/raw/train); SLStudio's frames and patterns
    (frameSeq_*, pat_*); or patterns/, numbered folders of photographs, and exposures.csv.
    """
    with progress("converting", "frames") as step:
        layout = lm.convert(
            folder, output, channel=channel, response=response, overwrite=overwrite, progress=step
        )
    text = f"{output}: a capture from the layout {layout}; now `lightmatrix check {output}`"
    answer(as_json, {"output": output, "layout": layout}, text)


@with_source()
def check(*, source: Source, as_json: Json = False) -> None:
    """Find what is wrong with a capture, and say what to do.

    Give a capture folder; or patterns and images, each as a folder or a stack. The command finds
    frames that are missing, late, swapped, black or odd; gamma and JPEG; motion and flicker; too
    much or too little light; and pixels that the patterns cannot tell apart. It exits with 0 if
    nothing is wrong, and with 1 otherwise. Stripes are a note, not a fault.
    """
    findings = source.check()
    faults = [finding for finding in findings if not finding.is_note]
    if as_json:
        show_json({"findings": [finding.as_dict() for finding in findings]})
    else:
        for finding in faults:
            say(as_options(f"{finding.kind}: {finding.message}"), style="yellow")
            say(as_options(f"  {finding.advice}"))
        notes = [f"note: {note.message}" for note in findings[len(faults) :]]
        for line in ["nothing is wrong"] * (not faults) + notes:
            say(line)
    if faults:
        raise typer.Exit(1)


@with_source(crop=False)
@described(output="Capture folder to write.")
def pack(
    output: Path = Path("packed"),
    *,
    source: Source,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Copy a capture with all frames in one array.

    Give a capture folder; or patterns and images, each as a folder or a stack. Commands read from
    the copy only the camera pixels that they need.
    """
    # From a capture folder `pack` copies truth.npz too.
    packable = source.open() if source.folder is None else source.folder
    with progress("packing", "rows") as step:
        lm.pack(packable, output, overwrite=overwrite, progress=step)
    size = sum(file.stat().st_size for file in output.rglob("*") if file.is_file())
    frames = lm.Capture.open(output).frames
    result = {"output": output, "frames": frames.count, "bytes": size}
    answer(as_json, result, f"{frames.count} frames in {output}, {amount(size)}")
