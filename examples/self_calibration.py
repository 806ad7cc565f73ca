"""Depth without a calibration: the scene itself tells where the projector stands.

    python examples/self_calibration.py OUT_FOLDER

The matches of 32 random patterns give the fundamental matrix. With the camera's focal length and
the distance to the projector, that is the geometry of the rig.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "depth.png": "Depth from 32 random patterns without a calibration; near is bright",
}


def main(out: Path) -> float:
    """Write a depth map and return its median relative error."""
    truth = lm.truth("corner")
    assert truth.geometry is not None
    assert truth.depth is not None
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    estimate = lm.estimate(lm.simulate(truth, patterns, exposure=0.3))

    rig = lm.self_calibrate(
        estimate, truth.geometry.camera_intrinsics, baseline=truth.geometry.baseline
    )
    shape = lm.triangulate(estimate, rig)
    error = float(np.nanmedian(np.abs(shape.depth / truth.depth - 1)))

    low, high = np.nanquantile(shape.depth, (0.01, 0.99))
    nearness = np.clip((high - np.nan_to_num(shape.depth, nan=high)) / (high - low), 0, 1)
    lm.write_image(out / "depth.png", np.kron(nearness, np.ones((4, 4))))
    print(f"the median error of the depth is {100 * error:.2f} %")
    return error


if __name__ == "__main__":
    main(Path(sys.argv[1]))
