"""Patterns, a simulated capture, three estimates and their errors, all in Python.

    python examples/estimate_in_python.py OUT_FOLDER

The scene is procedural, so it needs no renderer.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.simulation.procedural import ProceduralScene

PICTURES = {"row.png": "One row of T: the truth and three estimates"}
# The samples of this camera pixel often clip, although no single projector pixel clips it.
ROW, COLUMN = 6, 11


def main(out: Path) -> dict[str, float]:
    """Estimate with three solvers, draw a row and return their relative errors."""
    truth = ProceduralScene((16, 16), (24, 24), seed=1, bounces=8).truth()
    patterns = lm.BernoulliPatterns(truth.projector_shape, 160)

    # The camera: 8 bits, a little noise, and an exposure at which samples clip.
    exposure = 2.5
    capture = lm.simulate(truth, patterns, exposure=exposure)
    print(f"{100 * capture.clipped_share:.0f} % of the samples clip")

    solvers = {
        "ADMM, which ignores clipping": ("admm", "linear"),
        "Saturation ADMM, the paper's": ("saturation-admm", "clipped"),
        "Saturation ADMM, one-sided": ("saturation-admm", "one-sided"),
    }
    drawing = Figure(figsize=(10, 2.9), layout="constrained")
    panels = drawing.subplots(1, 4)
    known = truth.transport().row(ROW, COLUMN)
    _draw(panels[0], known, known, "the truth")
    errors = {}
    for axes, (name, (solver, fidelity)) in zip(panels[1:], solvers.items(), strict=True):
        # A simulated capture needs no check, which takes longer than the estimates.
        estimate = lm.estimate(
            capture, solver=solver, fidelity=fidelity, regularization=0.05 / exposure, check=False
        )
        # Rows that clip under a single projector pixel cannot be recovered, so they are left out.
        errors[name] = lm.evaluate(estimate, truth, exposure).relative_error_unclipped_responses
        print(f"{name}: relative error {errors[name]:.3f}")
        _draw(axes, estimate.row(ROW, COLUMN), known, f"{name}\nerror of T {errors[name]:.3f}")
    drawing.savefig(out / "row.png")
    return errors


def _draw(axes: Axes, row: NDArray[np.float32], known: NDArray[np.float32], title: str) -> None:
    """Draw a row as an image over the projector, with faint light brightened."""
    axes.imshow((row.clip(0) / known.max()) ** 0.35, cmap="inferno", vmin=0, vmax=1)
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
