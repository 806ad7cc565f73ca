"""`lightmatrix convert`: captures of other programs as capture folders."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from typer import Argument

import lightmatrix as lm
from lightmatrix.cli.options import FIND_HELP, Json, Overwrite, described
from lightmatrix.cli.terminal import answer, progress


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
