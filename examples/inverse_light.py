"""Cancel global light: a pattern under which a corner looks as if light met one surface only.

    python examples/inverse_light.py OUT_FOLDER

The walls of a corner light each other. `lm.cancel_global` finds, from an estimate of T from 32
photographs, the pattern that is darker by just that light (Seitz, Matsushita & Kutulakos 2005).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "cancelled.png": "A corner under white; its direct light alone; its photograph under the "
    "pattern that cancels global light; the pattern; and what both photographs have too much, "
    "under white and under the pattern, twice as bright"
}


def main(out: Path) -> tuple[float, float]:
    """Write the picture; the global light left, relative to direct light, without and with it."""
    truth = lm.truth("corner")
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    exposure = lm.plan(truth, frames=32).exposure
    estimate = lm.estimate(lm.simulate(truth, patterns, exposure=exposure))
    found = lm.cancel_global(estimate)

    white = np.ones(truth.projector_shape, np.float32)
    direct = (truth.direct @ white.ravel()).reshape(truth.camera_shape)
    known = truth.transport()
    photographs = known.relight(white), known.relight(found.pattern)
    left = [image - direct for image in photographs]

    top, gap = np.quantile(photographs[0], 0.99), np.ones((64, 4))
    too_much = [2 * np.abs(image) / top for image in left]
    panels = [photographs[0] / top]
    for image in (direct / top, photographs[1] / top, found.pattern, *too_much):
        panels += [gap, image]
    enlarged = np.kron(np.hstack(panels).clip(0, 1) ** (1 / 2.2), np.ones((4, 4)))
    lm.write_image(out / "cancelled.png", enlarged)

    before, after = (float(np.linalg.norm(x) / np.linalg.norm(direct)) for x in left)
    return before, after


if __name__ == "__main__":
    print("global light left: {:.3f} under white, {:.3f}".format(*main(Path(sys.argv[1]))))
