"""A truth as other cameras see it: cropped, turned, mirrored, keystoned; and blur by depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError
from lightmatrix.simulation.realism import defocus
from lightmatrix.simulation.truth import Truth


def seen(truth: Truth, place: NDArray[np.integer]) -> Truth:
    """The truth of a camera whose pixels are those at `place` (rows, cols); -1 is dark."""
    if len(truth.camera_shape) != 2:
        raise InputError("a view of a colour camera", hint="choose one of its channels")
    dark = csr_array((1, truth.matrix.shape[1]), dtype=np.float32)
    # The dark row comes last, where the index -1 selects it.
    matrix, direct = (
        csr_array(vstack([part, dark], format="csr")[place.ravel()])
        for part in (truth.matrix, truth.direct)
    )
    # The geometry of the scene is that of another camera.
    return replace(
        truth, matrix=matrix, direct_data=direct.data, camera_shape=place.shape, geometry=None
    )


def mapped(shape: tuple[int, int], homography: NDArray[np.float64]) -> NDArray[np.int64]:
    """The pixel that each pixel of a frame sees through a homography, (rows, cols); -1 outside.

    The homography (3, 3) maps (row, col, 1) to the same, in half sides from the frame's middle.
    """
    sides = np.array(shape).reshape(2, 1)
    middle, half = (sides - 1) / 2, sides / 2
    grid = (np.indices(shape).reshape(2, -1) - middle) / half
    to = homography @ np.concatenate([grid, np.ones((1, grid.shape[1]))])
    place = np.rint(to[:2] / to[2] * half + middle).astype(np.int64)
    inside = ((place >= 0) & (place < sides)).all(axis=0)
    return np.where(inside, place[0] * shape[1] + place[1], -1).reshape(shape)


def depth_blur(truth: Truth, widest: float) -> NDArray[np.float64]:
    """Blur that grows with depth, (M,) in projector pixels (std), for a grey camera.

    Depth follows from disparity. The projector is in focus where its pixels lie furthest to one
    side of the camera's, and blurred by `widest` where they lie furthest to the other side.
    """
    rows, cols = truth.camera_shape[:2]
    col = np.asarray(truth.matrix.argmax(axis=1)).reshape(rows, cols) % truth.projector_shape[1]
    step = truth.projector_shape[1] / cols
    # The filter removes single footprints whose strongest entry is global light, the quantiles
    # keep single outliers from setting the range.
    shift = median_filter(col - step * np.arange(cols), size=5)
    low, high = np.quantile(shift, [0.02, 0.98])
    share = np.clip((shift - low) / max(high - low, 1e-9), 0, 1)
    # Eight levels, so that rows of the same blur are blurred together.
    return np.asarray(widest * np.rint(share * 8) / 8).ravel()


def varying_defocus(truth: Truth, sigmas: NDArray[np.float64]) -> Truth:
    """Blur the projector differently for each camera sample: `sigmas` (M,) in projector pixels."""
    widths, group = np.unique(sigmas, return_inverse=True)
    order = np.argsort(group, kind="stable")
    parts = []
    for number, sigma in enumerate(widths):
        rows = np.flatnonzero(group == number)
        part = replace(truth, matrix=truth.matrix[rows], direct_data=truth.direct[rows].data)
        # A width near 0 leaves rows sharp but thins them as it does the others.
        parts.append(defocus(part, max(float(sigma), 1e-9)))
    matrix, direct = (
        csr_array(csr_array(vstack(blocks, format="csr"))[np.argsort(order)])
        for blocks in ([part.matrix for part in parts], [part.direct for part in parts])
    )
    return replace(truth, matrix=matrix, direct_data=direct.data)
