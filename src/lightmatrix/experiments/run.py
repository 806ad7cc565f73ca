"""`lm.demo` and `lm.experiment`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.experiments import demo as demo_report
from lightmatrix.experiments import (
    few_patterns,
    fig4,
    fig5,
    fig6,
    fig7,
    responses,
    rigs,
    shape,
    uses,
)
from lightmatrix.experiments.harness import Experiment
from lightmatrix.outputs.kinds import CASES, DEMO, FIGURE
from lightmatrix.outputs.running import RunningResults
from lightmatrix.outputs.writing import atomic_folder, claimed

Progress = Callable[[int, int], None]

EXPERIMENTS: dict[str, Experiment[Any]] = {
    one.name: one
    for one in (
        fig4.FIG4,
        fig5.FIG5,
        fig6.FIG6,
        fig7.FIG7,
        few_patterns.FEW_PATTERNS,
        rigs.RIGS_EXPERIMENT,
        responses.RESPONSES_EXPERIMENT,
        uses.USES_EXPERIMENT,
        shape.SHAPE_EXPERIMENT,
    )
}


def demo(
    folder: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Simulate a capture, estimate T by four methods, and write a report of the default one.

    Parameters
    ----------
    folder : str or Path
        The folder to make: report.html, a picture of all methods, demo.json, and the capture.
    overwrite : bool
        Whether an existing report may be replaced.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    dict
        The content of demo.json: the settings, the errors of each method, and, as ``report``,
        the result of `report`.

    Raises
    ------
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> result = lm.demo("report")  # doctest: +SKIP
    """
    with atomic_folder(folder, DEMO, overwrite=overwrite) as part:
        return demo_report.run(part, progress=progress)


def experiment(
    figure: str,
    folder: str | Path,
    *,
    quick: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Reproduce a figure of the paper or a claim of this project: picture, CSV and JSON.

    Parameters
    ----------
    figure : {"fig4", "fig5", "fig6", "fig7", "few-patterns", "rigs", "responses", "uses", "shape"}
        The experiment.
    folder : str or Path
        The folder to make. An interrupted run continues where it stopped.
    quick : bool
        Whether to run fewer trials, for a first look. A full run takes up to an hour.
    overwrite : bool
        Whether an existing folder may be replaced.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    dict
        The content of the JSON file.

    Raises
    ------
    InputError
        On an unknown figure.
    MissingExtraError
        If scenes must be rendered and Mitsuba is not installed.
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> result = lm.experiment("fig4", "out", quick=True)  # doctest: +SKIP
    """
    if figure not in EXPERIMENTS:
        raise InputError(
            f"there is no experiment {figure!r}", hint=f"use one of {', '.join(EXPERIMENTS)}"
        )
    with claimed(folder, FIGURE, overwrite=overwrite) as target:
        kept = RunningResults.open(target, CASES)
        with atomic_folder(folder, FIGURE, overwrite=overwrite) as part:
            result = EXPERIMENTS[figure].run(part, quick=quick, progress=progress, kept=kept)
        kept.discard()
    return result
