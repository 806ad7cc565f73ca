"""The shape of a scene whose surfaces light each other, from 32 random patterns.

    python examples/shape.py OUT_FOLDER

The brightest light beside a camera pixel's epipolar line is the surface. Light that bounced between
the two walls and the floor arrives elsewhere, where it is passed over.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "maps.png": "Depth and normals of the camera's pixels, and which test the others failed",
}


def main(out: Path) -> float:
    """Write the cloud and the maps, and return the share of depths within 1 % of the truth."""
    truth = lm.truth("corner")
    assert truth.geometry is not None
    assert truth.depth is not None
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    estimate = lm.estimate(lm.simulate(truth, patterns, exposure=0.3))
    shape = lm.triangulate(
        estimate, truth.geometry, output=out / "corner.ply", picture=out / "maps.png", mesh=True
    )
    right = float(np.mean(np.abs(shape.depth / truth.depth - 1) < 0.01))
    print(f"{shape.summary()['points']} points, {100 * right:.1f} % within 1 % of the distance")
    return right


if __name__ == "__main__":
    main(Path(sys.argv[1]))
