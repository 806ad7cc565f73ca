"""The demo and the experiments, each into a folder that is whole or absent."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.experiments import demo as demo_report
from lightmatrix.experiments import few_patterns, fig4, fig5, fig6, fig7
from lightmatrix.files.outputs import atomic_folder, check_output

Progress = Callable[[int, int], None]

EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    "fig4": fig4.run,
    "fig5": fig5.run,
    "fig6": fig6.run,
    "fig7": fig7.run,
    "few-patterns": few_patterns.run,
}
# These take long, so that an interrupted run goes on with the cases it has.
RESUMABLE = {"fig6", "fig7", "few-patterns"}


def demo(
    folder: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Simulate and estimate a scene with three solvers; write a picture report.

    Parameters
    ----------
    folder : str or Path
        The report to make: report.png, demo.json and the capture it estimated from.
    overwrite : bool
        Whether an existing report may be replaced.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    dict
        What demo.json holds: the setting, and the errors of each method.

    Raises
    ------
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> result = lm.demo("report")  # doctest: +SKIP
    """
    check_output(folder, overwrite=overwrite)
    with atomic_folder(folder, overwrite=overwrite) as part:
        return demo_report.run(part, progress=progress)


def experiment(
    figure: str,
    folder: str | Path,
    *,
    quick: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Reproduce a figure of the paper, or a claim of ours: picture, CSV and JSON.

    Parameters
    ----------
    figure : {"fig4", "fig5", "fig6", "fig7", "few-patterns"}
    folder : str or Path
        The folder to make. fig6, fig7 and few-patterns go on where they stopped if run again.
    quick : bool
        Fewer trials, for a first look; otherwise it takes up to an hour.
    overwrite : bool
        Whether an existing folder may be replaced.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    dict
        What the JSON file holds.

    Raises
    ------
    InputError
        On an unknown figure.
    MissingExtraError
        If scenes have to be rendered and Mitsuba is not installed.
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
    target = check_output(folder, overwrite=overwrite)
    kept = target.with_name(target.name + ".cases")
    options = {"kept": kept} if figure in RESUMABLE else {}
    with atomic_folder(folder, overwrite=overwrite) as part:
        result = EXPERIMENTS[figure](part, quick=quick, progress=progress, **options)
    shutil.rmtree(kept, ignore_errors=True)
    return result
