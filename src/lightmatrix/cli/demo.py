"""`lightmatrix demo`: simulate, estimate, and write a report."""

from __future__ import annotations

from pathlib import Path

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described
from lightmatrix.cli.terminal import progress, say, show_columns, show_json


@described(output="Folder of the report.")
def demo(
    output: Path = Path("report"), overwrite: Overwrite = False, as_json: Json = False
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
    errors = ("relative_error", "relighting_error")
    show_columns(
        title,
        ("method", "RMSE", "relative error", "relighting error"),
        [
            (each["method"], f"{each['rmse']:.4f}", *(f"{each[error]:.3f}" for error in errors))
            for each in result["methods"]
        ],
    )
    judged = lm.Verdicts.from_dict(result["report"]["verdicts"])
    say(f"default estimate: {judged.transport}")
    say(f"report: {(output / 'report.html').absolute()}")
