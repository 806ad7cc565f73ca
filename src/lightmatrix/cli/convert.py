"""`lightmatrix convert`: captures of other programs as capture folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import FIND_HELP, Json, Overwrite, output_option
from lightmatrix.cli.terminal import progress, say, show_json


def convert(
    folder: Annotated[Path, Argument(metavar="FOLDER", help="The folder of the other program.")],
    output: Annotated[Path, output_option("The capture folder to make.")] = Path("capture"),
    channel: Annotated[
        Literal["red", "green", "blue"], Option(help="The channel of colour images that is kept.")
    ] = "green",
    response: Annotated[str, Option(help=FIND_HELP)] = "linear",
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Make a capture folder from other layouts.

    FOLDER is a setup of CompenNet's data (with cam/raw/train); SLStudio's frames and patterns
    (frameSeq_*, pat_*); or patterns/, numbered folders of photographs, and exposures.csv or .json.
    """
    with progress("converting", "frames") as step:
        layout = lm.convert(
            folder, output, channel=channel, response=response, overwrite=overwrite, progress=step
        )
    if as_json:
        show_json({"output": output, "layout": layout})
    else:
        say(f"{output}: a capture from the layout {layout}; now `lightmatrix check {output}`")
