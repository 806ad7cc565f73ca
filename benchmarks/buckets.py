"""Pictures that one detector sees, from a quarter of the patterns: `python -m benchmarks.buckets`.

A single-pixel detector collects the light of a whole scene of 64 x 64 projector pixels; its row of
T is the scene as the projector sees it. It measures 1,024 of the 4,096 Hadamard patterns, the
coarsest or any, with 12 bits and noise of 0.001. Relative errors of `--solver total-variation` as
it is, beside least squares, and total variation of scikit-image on these at the weight that the
truth tells is best.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.restoration import denoise_tv_chambolle

import lightmatrix as lm
from experiments.harness import markdown, options

SCENES = ("l_objects", "gripper", "metal")
SHAPE, COUNT, NOISE = (64, 64), 1024, 0.001
Images = NDArray[Any]
# scikit-image states no types.
denoise: Any = denoise_tv_chambolle


def pictures() -> Images:
    """What a detector sees under one projector pixel after the other, (scenes, N), mean 1 / N."""
    rows = [np.asarray(lm.truth(name).transport().sparse.sum(axis=0)) for name in SCENES]
    return np.stack([row.ravel() / row.sum() for row in rows])


def errors(found: Images, true: Images) -> list[str]:
    """Relative errors of all pictures."""
    apart = np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)
    return [f"{value:.3f}" for value in apart]


def smoothed(rough: Images, true: Images) -> Images:
    """Each picture by scikit-image, at its best weight."""
    best = []
    for own, right in zip(rough, true, strict=True):
        scale = float(np.abs(own).max())
        tried = [
            scale * denoise(own.reshape(SHAPE) / scale, weight=weight).ravel()
            for weight in np.geomspace(0.003, 1, 24)
        ]
        best.append(min(tried, key=lambda one: float(np.linalg.norm(one - right))))
    return np.stack(best)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a table."""
    options("benchmarks.buckets", __doc__).parse_args(arguments)
    true, lines = pictures(), []
    for order in ("sequency", "random"):
        patterns = lm.make_patterns("hadamard", SHAPE, count=COUNT, order=order)
        noise = NOISE * np.random.default_rng(0).standard_normal((len(true), COUNT))
        seen = np.clip(np.rint((patterns.forward(true) + noise) * 4095), 0, 4095).astype(np.uint16)
        frames = seen.T.reshape(COUNT, 1, len(true))
        capture = lm.Capture.from_arrays(patterns, frames, lm.Sensor(bits=12))
        found = lm.estimate(capture, solver="total-variation", check=False).sparse.toarray()
        dense = patterns.images().reshape(COUNT, -1).astype(np.float64)
        rough = np.linalg.lstsq(dense, seen.T / 4095, rcond=None)[0].T
        for name, one in (
            ("least squares", rough),
            ("scikit-image, best weight", smoothed(rough, true)),
            ("total-variation", found.astype(np.float64)),
        ):
            lines.append([order, name, *errors(one, true)])
    print(markdown(["patterns", "method", *SCENES], lines))


if __name__ == "__main__":
    main()
