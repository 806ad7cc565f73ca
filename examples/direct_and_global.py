"""Split a scene's light into direct and global light, from 32 simulated photographs.

    python examples/direct_and_global.py OUT_FOLDER

Direct light met one surface, global light several. T tells them apart by epipolar geometry and by
neighbours, for any pattern.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "direct.png": "Direct light under a white pattern",
    "global.png": "Global light under a white pattern, four times as bright",
}


def main(out: Path) -> float:
    """Write both images; returns the relative error of the global one."""
    capture = lm.simulate("l_objects", lm.BernoulliPatterns((64, 64), 32), exposure=0.7)
    parts = lm.separate(lm.estimate(capture))

    white = np.ones(parts.direct.projector_shape)
    direct, others = parts.direct.relight(white), parts.global_.relight(white)
    top = np.quantile(direct + others, 0.99)
    for name, image in (("direct", direct), ("global", 4 * others)):
        shown = np.clip(image / top, 0, 1) ** (1 / 2.2)
        lm.write_image(out / f"{name}.png", shown.repeat(6, axis=0).repeat(6, axis=1))

    known = np.asarray(capture.truth.indirect.sum(axis=1)).reshape(others.shape)
    return float(np.linalg.norm(others - known) / np.linalg.norm(known))


if __name__ == "__main__":
    print(f"error of the global image: {main(Path(sys.argv[1])):.2f}")
