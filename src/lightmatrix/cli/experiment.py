"""Commands that show: the demo and the paper's figures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from lightmatrix.cli.common import Json, Overwrite, claim, out, progress, show_json
from lightmatrix.experiments import demo as demo_report
from lightmatrix.experiments import few_patterns, fig4, fig5, fig6, fig7
from lightmatrix.experiments.harness import CASES, FIGURE, Experiment
from lightmatrix.files.markers import FolderKind
from lightmatrix.files.outputs import atomic_folder
from lightmatrix.files.running import RunningFolder


class Figure(StrEnum):
    """Figures of the paper that can be drawn, and claims of ours."""

    FIG4 = "fig4"
    FIG5 = "fig5"
    FIG6 = "fig6"
    FIG7 = "fig7"
    FEW_PATTERNS = "few-patterns"


EXPERIMENTS: dict[Figure, Experiment[Any]] = {
    Figure.FIG4: fig4.FIG4,
    Figure.FIG5: fig5.FIG5,
    Figure.FIG6: fig6.FIG6,
    Figure.FIG7: fig7.FIG7,
    Figure.FEW_PATTERNS: few_patterns.FEW_PATTERNS,
}
REPORT = FolderKind("demo report")


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command("demo")(demo)
    app.command("experiment")(experiment)


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Report folder.")] = Path("report"),
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Simulate and estimate a scene; write a picture report."""
    with (
        atomic_folder(output, REPORT, overwrite=overwrite) as folder,
        progress("demo", "steps") as report,
    ):
        result = demo_report.run(folder, progress=report)
    if as_json:
        show_json({**result, "output": output})
        return
    out.print(demo_report.table(result))
    out.print(f"pictures: {output / 'report.png'}", highlight=False)


def experiment(
    figure: Annotated[
        Figure,
        typer.Argument(
            metavar="FIGURE",
            help="A figure of the paper, or how few patterns suffice.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the figure.")],
    quick: Annotated[bool, typer.Option(help="Fewer trials, for a first look.")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Reproduce a figure: picture, CSV and JSON.

    Without --quick it takes up to an hour and goes on where it stopped if run again; fig6, fig7 and
    few-patterns then need the extra `render`.
    """
    target = claim(output, FIGURE, overwrite=overwrite)
    kept = RunningFolder.open(target, CASES)
    with (
        atomic_folder(output, FIGURE, overwrite=overwrite) as folder,
        progress(str(figure), "steps") as report,
    ):
        result = EXPERIMENTS[figure].run(folder, quick=quick, progress=report, kept=kept)
    kept.discard()
    if as_json:
        show_json(result)
    else:
        out.print(f"{figure}: see {output}", highlight=False)
