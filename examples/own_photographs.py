"""T from two folders of images, with a report.

    python examples/own_photographs.py OUT_FOLDER

One folder holds the projected patterns, the other the photographs in the same order. Here the
photographs are simulated; replace them by your own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "clipping.png": "Share of each camera pixel's samples that clipped",
    "white.png": "The scene under a white pattern, computed from T",
}


def main(out: Path) -> dict[str, object]:
    """Write patterns and photographs, estimate T from them, and write the report."""
    patterns = lm.BernoulliPatterns((64, 64), 32)
    lm.write_patterns(out / "patterns", patterns)
    simulated = lm.simulate("metal", patterns, exposure=0.3)
    for k in range(simulated.count):
        lm.write_image(out / "photos" / f"photo_{k:04d}.png", simulated.frame(k))

    # Begin here if you have your own photographs.
    capture = lm.Capture.from_folders(out / "patterns", out / "photos")
    estimate = lm.estimate(capture, output=out / "scene.zarr")
    report = lm.report(out / "report", estimate, capture)
    print(lm.Verdicts.from_dict(report["verdicts"]).transport)

    lm.show(estimate, "clipping").savefig(out / "clipping.png")
    white = np.ones(estimate.projector_shape)
    relit = estimate.relight(white)
    shown = (relit / np.quantile(relit, 0.99)).clip(0, 1) ** (1 / 2.2)
    lm.write_image(out / "white.png", np.kron(shown, np.ones((6, 6))))
    return report


if __name__ == "__main__":
    main(Path(sys.argv[1]))
