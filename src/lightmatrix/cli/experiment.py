"""`lightmatrix experiment`: the paper's figures, and claims of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite
from lightmatrix.cli.terminal import progress, say, show_json

Figure = Literal[
    "fig4", "fig5", "fig6", "fig7", "few-patterns", "rigs", "responses", "uses", "shape"
]


def experiment(
    figure: Annotated[
        Figure,
        typer.Argument(
            metavar="FIGURE",
            help="A figure of the paper; errors of few patterns, other rigs, responses; uses.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the figure.")],
    quick: Annotated[bool, typer.Option(help="Fewer trials, for a first look.")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Reproduce a figure as a picture, CSV and JSON.

    Without --quick it takes up to an hour. After an interruption, the same command goes on where it
    stopped. fig6, fig7, few-patterns, rigs and uses need the extra `render`, except with --quick.
    """
    with progress(figure, "steps") as report:
        result = lm.experiment(figure, output, quick=quick, overwrite=overwrite, progress=report)
    if as_json:
        show_json(result)
    else:
        say(f"{figure}: see {output}")
