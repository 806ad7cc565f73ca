"""Make a scene show a picture in colour: the three primaries are compensated jointly.

    python examples/colour_compensation.py OUT_FOLDER

The filters of a camera overlap: green light of the projector also reaches the red and the blue
channel. The projector is measured as three, one for each primary, from 32 photographs each. If each
primary is compensated by itself, for its own channel, colours are pale; jointly they are right.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm

PICTURES = {
    "projected.png": "The wanted picture; each primary compensated by itself; the three jointly; "
    "and the same rows of the pattern for that"
}
PRIMARIES = ("red", "green", "blue")
# The first row and column of the part of the camera's image, and its shape.
CORNER, SHAPE = (14, 0), (36, 64)


def main(out: Path) -> tuple[float, float]:
    """Write the picture; the PSNR in dB, of primaries by themselves and jointly."""
    truth = lm.truth("l_objects")
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    exposure = lm.plan(truth, frames=32).exposure
    captures = [
        lm.simulate(truth, patterns, exposure=exposure, primary=primary).crop(CORNER, SHAPE)
        for primary in PRIMARIES
    ]
    estimates = [lm.estimate(capture) for capture in captures]
    wanted = picture()
    joint = lm.compensate(estimates, wanted)

    alone = []
    for number, estimate in enumerate(estimates):
        own = np.tile(np.arange(3) == number, (*SHAPE, 1))
        # As if the primary reached no other channel: the white of this channel is its own.
        share = white(estimate)[number] / sum(white(one)[number] for one in estimates)
        found = lm.compensate(estimate, wanted, mask=own, brightness=joint.brightness / share)
        alone.append(found.pattern)
    # Both are photographed through the true matrices.
    known = [capture.truth.transport() for capture in captures]
    photographs = [lm.relight(known, np.stack(alone, axis=-1)), lm.relight(known, joint.pattern)]

    # The camera's own white, that of the scene under white light, is white in the picture.
    level = joint.brightness * sum(white(one) for one in estimates)
    gap = np.ones((SHAPE[0], 4, 3))
    shown = [image / level for image in photographs]
    pattern = joint.pattern[CORNER[0] : CORNER[0] + SHAPE[0]]
    panels = np.hstack([wanted, gap, shown[0], gap, shown[1], gap, pattern])
    enlarged = np.kron(panels.clip(0, 1) ** (1 / 2.2), np.ones((4, 4, 1)))
    lm.write_image(out / "projected.png", enlarged)

    errors = [((image - joint.target) / level)[joint.reachable] for image in photographs]
    by_itself, jointly = (float(-10 * np.log10(np.mean(error**2))) for error in errors)
    return by_itself, jointly


def picture() -> NDArray[np.float64]:
    """A white photograph of another scene, in colours that turn from left to right."""
    scene = lm.truth("gripper").transport()
    light = scene.relight(np.ones(scene.projector_shape))[CORNER[0] : CORNER[0] + SHAPE[0]]
    light = np.clip(light / np.quantile(light, 0.99), 0, 1)
    turn = np.linspace(0, 1, light.shape[1])[:, None] + np.arange(3) / 3
    return light[..., None] * (0.6 + 0.4 * np.cos(2 * np.pi * turn))


def white(estimate: lm.LightTransport) -> NDArray[np.floating]:
    """The light of each camera channel under all of a primary, a median."""
    image = estimate.relight(np.ones(estimate.projector_shape))
    return np.median(image, axis=(0, 1))


if __name__ == "__main__":
    print("{:.1f} dB by themselves, {:.1f} dB jointly".format(*main(Path(sys.argv[1]))))
