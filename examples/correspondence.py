"""The projector pixel that each camera pixel sees: structured light from 32 random patterns.

    python examples/correspondence.py OUT_FOLDER

A Gray code with inverses needs 26 photographs for 64 x 64 pixels, and fails where light arrives by
several paths. T shows where that happens: the confidence is the share of a pixel's light that comes
from one place.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "map.png": "Projector row and column that each camera pixel sees, and the confidence",
}


def main(out: Path) -> float:
    """Write the map and return the share of confident pixels that are right."""
    truth = lm.truth("metal")
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    estimate = lm.estimate(lm.simulate(truth, patterns, exposure=0.3))
    lm.show(estimate, "correspondence").savefig(out / "map.png")

    matches = lm.correspondence(estimate)
    known = lm.correspondence(truth.transport())
    distance = np.abs(matches.place - known.place).max(axis=2)
    confident = matches.confidence > 0.5
    right = float(np.mean(distance[confident] < 0.5))
    print(f"{100 * confident.mean():.0f} % of the pixels are confident, {100 * right:.1f} % right")
    return right


if __name__ == "__main__":
    main(Path(sys.argv[1]))
