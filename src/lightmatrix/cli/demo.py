"""`lightmatrix demo`: simulate, estimate, and write a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, output_option
from lightmatrix.cli.terminal import progress, say, show_columns, show_json


def demo(
    output: Annotated[Path, output_option("Folder of the report.")] = Path("report"),
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Simulate and estimate a scene, and write a report."""
    with progress("demo", "steps") as report:
        result = lm.demo(output, overwrite=overwrite, progress=report)
    if as_json:
        show_json({**result, "output": output})
        return
    rows, cols = result["size"]
    title = (
        f"{result['scene']}, {rows} x {cols}, {result['patterns']} Bernoulli patterns, 8 bits: "
        f"{100 * result['clipped_samples']:.0f} % of the samples clip, "
        f"{100 * result['clipping_responses']:.0f} % of the single responses"
    )
    show_columns(
        title,
        ("method", "RMSE", "relative error", "relighting error"),
        [
            (
                method["method"],
                f"{method['rmse']:.4f}",
                f"{method['relative_error']:.3f}",
                f"{method['relighting_error']:.3f}",
            )
            for method in result["methods"]
        ],
    )
    judged = lm.Verdicts.from_dict(result["report"]["verdicts"])
    say(f"default estimate: {judged.transport}")
    say(f"report: {(output / 'report.html').absolute()}")
