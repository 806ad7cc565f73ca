"""Make a scene look like a picture: uncompensated beside compensated.

    python examples/compensation.py OUT_FOLDER

The picture, a photograph of another scene, is first shown as a projector would show it that knows
only where its pixels land; then with the pattern that `lm.compensate` finds from an estimate of T,
32 photographs. Both are photographed through the true T.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "projected.png": "The wanted picture; projected as it is; the compensated photograph; "
    "and the pattern for it",
}


def main(out: Path) -> tuple[float, float]:
    """Write the picture; the PSNR on reachable pixels, in dB, without and with compensation."""
    truth, picture = lm.truth("l_objects"), lm.truth("gripper").transport()
    known = truth.transport()
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    estimate = lm.estimate(
        lm.simulate(truth, patterns, exposure=lm.plan(truth, frames=32).exposure)
    )

    wanted = picture.relight(np.ones(picture.projector_shape))
    wanted = np.clip(wanted / np.quantile(wanted, 0.99), 0, 1)
    found = lm.compensate(estimate, wanted)

    # Uncompensated: each projector pixel shows the picture where it lands in the camera.
    weight = estimate.dual(np.ones(estimate.camera_shape))
    plain = found.brightness * estimate.dual(wanted) / np.maximum(weight, 1e-9)
    photographs = [known.relight(pattern) for pattern in (plain.clip(0, 1), found.pattern)]

    gap = np.ones((64, 4), np.float32)
    before, after = (photograph / found.scale for photograph in photographs)
    panels = np.hstack([wanted, gap, before, gap, after, gap, found.pattern])
    enlarged = np.kron(panels.clip(0, 1) ** (1 / 2.2), np.ones((4, 4)))
    lm.write_image(out / "projected.png", enlarged)

    errors = [(image - found.target)[found.reachable] / found.scale for image in photographs]
    uncompensated, compensated = (float(-10 * np.log10(np.mean(e**2))) for e in errors)
    return uncompensated, compensated


if __name__ == "__main__":
    print("{:.1f} dB uncompensated, {:.1f} dB compensated".format(*main(Path(sys.argv[1]))))
