"""The light transport matrix of a textured surface, small enough for a dense array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
