"""A bucket detector: 64 x 64 pixels from a quarter of the Hadamard patterns, beside peers.

python -m benchmarks.bucket      needs scikit-image

Peers are told the picture's sum, and get their best strength by the true picture, which no user
has: least squares, as SPyRiT's `PinvNet`, and FISTA whose step denoises by scikit-image's total
variation or non-local means.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from skimage import data
from skimage.restoration import denoise_nl_means, denoise_tv_chambolle

from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth

SIDE = 64
DENOISERS: dict[str, Callable[..., Any]] = {
    "total variation": lambda image, weight: denoise_tv_chambolle(  # type: ignore[no-untyped-call]
        image, weight, max_num_iter=50
    ),
    "non-local means": lambda image, weight: denoise_nl_means(image, 5, 7, h=weight),
}


def fista(samples: np.ndarray, signs: np.ndarray, denoise: Callable[..., Any]) -> np.ndarray:
    """The picture after 100 accelerated steps from least squares; rows of `signs` are +-1."""
    x = ahead = samples @ signs / SIDE**2
    unit, momentum = float(np.abs(x).max()), 1.0
    for _ in range(100):
        moved = ahead + (samples - signs @ ahead) @ signs / SIDE**2
        new = np.maximum(denoise(moved.reshape(SIDE, SIDE) / unit).ravel() * unit, 0)
        later = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead, x, momentum = new + (momentum - 1) / later * (new - x), new, later
    return x


def main() -> None:
    print("picture, order: lightmatrix (stated) | least squares, total variation, non-local means")
    for name in ("camera", "coins", "moon"):
        photograph = getattr(data, name)()
        block = min(photograph.shape) // SIDE
        image = block_mean(photograph[: SIDE * block, : SIDE * block], (block, block))
        row = (image / image.sum()).reshape(1, -1).astype(np.float32)
        truth = Truth(csr_array(row), row[0], (1, 1), (SIDE, SIDE))
        for order in ("sequency", "random"):
            patterns = HadamardPatterns((SIDE, SIDE), SIDE**2 // 4, order=order)
            exposure = 0.9 / float(np.sort(patterns.forward(row).ravel())[-2])
            capture = simulate(truth, patterns, exposure=exposure, bits=12, noise=0.001)
            made = estimate(capture, progress=False)
            stated = float(made.diagnostics["estimated_error"][0])

            def error(picture: np.ndarray, row: np.ndarray = row) -> float:
                return float(np.linalg.norm(picture - row) / np.linalg.norm(row))

            signs = 2 * patterns.dense().astype(float) - 1
            values = 2 * capture.samples().values[0] - 1
            values[patterns.sums == SIDE**2] = 1
            results = [error(values @ signs / SIDE**2)]
            for denoise in DENOISERS.values():
                tried = [partial(denoise, weight=weight) for weight in (0.001, 0.003, 0.01, 0.03)]
                results.append(min(error(fista(values, signs, each)) for each in tried))
            own = error(made.sparse.toarray()[0])
            print(
                f"{name}, {order}: {own:.4f} ({stated:.3f}) |",
                *(f"{e:.4f}" for e in results),
                flush=True,
            )


if __name__ == "__main__":
    main()
