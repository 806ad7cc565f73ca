"""Two projectors before one scene, made of a T that is known: no renderer is needed."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, hstack

from lightmatrix.simulation.truth import Truth


def two_projectors(one: Truth, camera: int = 1) -> Truth:
    """A truth of two projectors of one T's size whose pictures overlap by a third of it.

    The second one hangs upside down. A second camera is the first one upside down.
    """
    rows, cols = one.projector_shape
    pixels = np.arange(rows * cols).reshape(rows, cols)
    column = pixels % cols
    left = one.matrix.multiply((column < 2 * cols // 3).ravel())
    right = one.matrix.multiply((column >= cols // 3).ravel())
    turned = csr_array(right.tocsc()[:, pixels[::-1, ::-1].ravel()])
    matrix = csr_array(hstack([csr_array(left), turned]), dtype=np.float32)
    if camera == 2:
        matrix = csr_array(matrix[np.arange(matrix.shape[0])[::-1]])
    matrix.eliminate_zeros()
    matrix.sort_indices()
    about = {"scene": "two projectors", "projectors": [[rows, cols], [rows, cols]]}
    nothing = np.zeros_like(matrix.data)
    return Truth(matrix, nothing, one.camera_shape, (2 * rows, cols), about)
