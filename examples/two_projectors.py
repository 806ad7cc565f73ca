"""Two projectors on one surface make one picture: overlap and edges blend.

    python examples/two_projectors.py OUT_FOLDER

Each projector lights two thirds of the scene; the right one hangs upside down and is darker. One
camera measures both, 32 photographs each. Without compensation their light adds up where they
overlap. `lm.compensate` with both matrices blends them, since [T1 T2] is a matrix like any other.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "blended.png": "The wanted picture; both projectors show it as it is; the photograph with "
    "compensation; and the light of the left and of the right projector in it"
}
# The columns of the simulated projector that each of the two has, and its brightness.
LEFT, RIGHT, DARKER = slice(0, 42), slice(22, 64), 0.7


def main(out: Path) -> tuple[float, float]:
    """Write the picture; the PSNR on reachable pixels, in dB, without and with compensation."""
    whole, picture = lm.truth("l_objects"), lm.truth("gripper").transport()
    truths = [part_of(whole, LEFT), part_of(whole, RIGHT, brightness=DARKER, turned=True)]
    estimates = [measured(truth) for truth in truths]

    wanted = picture.relight(np.ones(picture.projector_shape))
    wanted = np.clip(wanted / np.quantile(wanted, 0.99), 0, 1)
    found = lm.compensate(estimates, wanted)

    # Uncompensated: each projector shows the picture where it lands in the camera.
    seen = [one.dual(np.ones(one.camera_shape)) for one in estimates]
    plain = [
        np.clip(found.brightness * one.dual(wanted) / np.maximum(weight, 1e-9), 0, 1)
        for one, weight in zip(estimates, seen, strict=True)
    ]
    known = [truth.transport() for truth in truths]
    lights = [one.relight(pattern) for one, pattern in zip(known, found.patterns, strict=True)]
    before = sum(one.relight(pattern) for one, pattern in zip(known, plain, strict=True))
    photographs = np.asarray(before), np.asarray(lights[0] + lights[1])

    gap = np.ones((64, 4), np.float32)
    panels = [wanted]
    for image in (*photographs, *lights):
        panels += [gap, image / found.scale]
    enlarged = np.kron(np.hstack(panels).clip(0, 1) ** (1 / 2.2), np.ones((4, 4)))
    lm.write_image(out / "blended.png", enlarged)

    errors = [(image - found.target)[found.reachable] / found.scale for image in photographs]
    uncompensated, compensated = (float(-10 * np.log10(np.mean(e**2))) for e in errors)
    return uncompensated, compensated


def part_of(
    whole: lm.Truth, cols: slice, *, brightness: float = 1.0, turned: bool = False
) -> lm.Truth:
    """T of a projector that has some columns of another one, perhaps upside down."""
    pixels = np.arange(whole.matrix.shape[1]).reshape(whole.projector_shape)[:, cols]
    chosen = (pixels[::-1, ::-1] if turned else pixels).ravel()
    matrix = brightness * whole.matrix[:, chosen]
    direct = (brightness * whole.direct[:, chosen]).data
    return lm.Truth(matrix, direct, whole.camera_shape, (pixels.shape[0], pixels.shape[1]))


def measured(truth: lm.Truth) -> lm.LightTransport:
    """T of one projector, estimated from 32 photographs."""
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)
    exposure = lm.plan(truth, frames=32).exposure
    return lm.estimate(lm.simulate(truth, patterns, exposure=exposure))


if __name__ == "__main__":
    print("{:.1f} dB uncompensated, {:.1f} dB compensated".format(*main(Path(sys.argv[1]))))
