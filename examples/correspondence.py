"""Which projector pixel each camera pixel sees: structured light from 32 random patterns.

    python examples/correspondence.py OUT_FOLDER

A Gray code needs 26 photographs of 64 x 64 pixels with their inverses, and fails where light
arrives by several paths. T tells such pixels apart: the confidence is the share of their light that
comes from one place.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "map.png": "Projector row and column that each camera pixel sees, and how sure that is",
}


def main(out: Path) -> float:
    """Write the map and return the share of confident pixels that are right."""
    truth = lm.truth("metal")
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    estimate = lm.estimate(lm.simulate(truth, patterns, exposure=0.3))
    lm.show_correspondence(estimate).savefig(out / "map.png")

    found = lm.correspondence(estimate)
    known = lm.correspondence(truth.transport())
    away = np.abs(found.place - known.place).max(axis=2)
    sure = found.confidence > 0.5
    right = float(np.mean(away[sure] < 0.5))
    print(
        f"{100 * sure.mean():.0f} % of the pixels are confident, {100 * right:.1f} % of them right"
    )
    return right


if __name__ == "__main__":
    main(Path(sys.argv[1]))
