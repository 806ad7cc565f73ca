"""Reproduces figures of the paper, and claims of this project, as pictures, CSV and JSON.

    python -m experiments fig4 -o out/fig4 [--quick]

A full run takes up to an hour. After an interruption, the same command continues where it stopped.
All but fig4, responses and fig5 render scenes, which needs the extra `render`, except with --quick.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from experiments import (
    few_patterns,
    fig4,
    fig5,
    fig6,
    fig7,
    harness,
    layers,
    mapping,
    numbers,
    responses,
    rigs,
    shape,
    uses,
)
from lightmatrix.cli.terminal import progress
from lightmatrix.errors import LightMatrixError

EXPERIMENTS: dict[str, harness.Experiment[Any]] = {
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
        layers.LAYERS_EXPERIMENT,
        mapping.MAPPING,
        numbers.NUMBERS,
    )
}


def main(arguments: list[str] | None = None) -> int:
    """Run an experiment; returns the exit status."""
    parser = harness.options("experiments", __doc__)
    parser.add_argument("name", choices=EXPERIMENTS, help="a figure of the paper, or a claim")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the figure")
    parser.add_argument("--quick", action="store_true", help="fewer trials, for a first look")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier result")
    chosen = parser.parse_args(arguments)
    try:
        with progress(chosen.name, "cases") as report:
            EXPERIMENTS[chosen.name].run(
                chosen.output, quick=chosen.quick, overwrite=chosen.overwrite, progress=report
            )
    except LightMatrixError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command continues", file=sys.stderr)
        return 130
    print(f"{chosen.name}: see {chosen.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
