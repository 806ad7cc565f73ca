"""Estimates from 32 photographs: row by row, coherent, and coherent with two exposures.

    python examples/few_patterns.py OUT_FOLDER

Neighbouring camera pixels see neighbouring projector pixels. The coherent estimate, the default,
uses that. A second, shorter exposure recovers rows that clip under a single projector pixel.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

import lightmatrix as lm
from lightmatrix.judgement.metrics import squared_errors

PICTURES = {"errors.png": "Relative error of each row of T, by three estimates"}


def main(out: Path) -> dict[str, float]:
    """Estimate T three times, draw their errors and return the relative ones over all rows."""
    truth = lm.truth("gripper")  # 64 x 64, bundled with the package
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)

    # At this exposure a fifth of the single responses clip and cannot be recovered. A quarter of
    # the frames at a quarter of the exposure captures them.
    strongest = truth.transport().sparse.max(axis=1).toarray()
    exposure = float(1 / np.quantile(strongest, 0.8))
    one = lm.simulate(truth, patterns, exposure=exposure)
    two = lm.simulate(truth, patterns, exposure=f"{exposure}:0.75,{exposure / 4}:0.25")
    estimates = {
        "row by row": lm.estimate(one, coherent=False),
        "coherent": lm.estimate(one),
        "coherent, two exposures": lm.estimate(two),
    }
    errors = {}
    drawing = Figure(figsize=(9.6, 3.2), layout="constrained")
    panels = drawing.subplots(1, 3)
    for axes, (name, estimate) in zip(panels, estimates.items(), strict=True):
        errors[name] = lm.evaluate(estimate, truth).relative_error
        print(f"{name:24s} relative error {errors[name]:.3f}")
        wrong, whole = squared_errors(estimate, truth.transport())
        row_errors = np.sqrt(wrong / whole).reshape(truth.camera_shape)
        image = axes.imshow(row_errors.clip(1e-3), cmap="magma", norm=LogNorm(1e-3, 1))
        axes.set_title(f"{name}: {errors[name]:.3f}", fontsize=10)
        axes.set_axis_off()
    drawing.colorbar(image, ax=panels, label="relative error of a row")
    drawing.savefig(out / "errors.png")
    return errors


if __name__ == "__main__":
    main(Path(sys.argv[1]))
