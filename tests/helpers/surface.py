"""The light transport matrix of a textured surface, small enough for a dense array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.sensor import Sensor
from lightmatrix.patterns.pattern_set import PatternSet

PROJECTOR = (16, 20)
CAMERA = (18, 22)


def surface(seed: int = 0, diffuse: float = 0.3) -> NDArray[np.float64]:
    """T, (camera pixels, projector pixels): each row sees 2 x 2 pixels, and diffuse light."""
    generator = np.random.default_rng(seed)
    rows = np.add.outer(np.linspace(0, PROJECTOR[0] - 2, CAMERA[0]), np.zeros(CAMERA[1]))
    cols = np.add.outer(np.zeros(CAMERA[0]), np.linspace(0, PROJECTOR[1] - 2, CAMERA[1]))
    albedo = generator.uniform(0.2, 1, CAMERA)
    matrix = np.zeros((*CAMERA, *PROJECTOR))
    for r in range(CAMERA[0]):
        for c in range(CAMERA[1]):
            y, x = int(rows[r, c]), int(cols[r, c])
            fy, fx = rows[r, c] - y, cols[r, c] - x
            weights = np.outer([1 - fy, fy], [1 - fx, fx])
            matrix[r, c, y : y + 2, x : x + 2] = albedo[r, c] * weights
    matrix += diffuse * albedo[..., None, None] / np.prod(PROJECTOR)
    return matrix.reshape(-1, int(np.prod(PROJECTOR)))


def photographs(
    patterns: PatternSet,
    *,
    gain: NDArray[np.floating] | float = 1.0,
    noise: float = 0.005,
    exposure: float = 0.9,
    diffuse: float = 0.3,
) -> NDArray[np.uint8]:
    """Photographs (K, rows, cols) of the surface; the light of each frame times its gain."""
    light = patterns.forward(surface(0, diffuse)) * gain
    raw = Sensor(exposure, read_noise=noise).expose(np.asarray(light, np.float32), seed=0)
    return np.ascontiguousarray(raw.T).reshape(-1, *CAMERA)
