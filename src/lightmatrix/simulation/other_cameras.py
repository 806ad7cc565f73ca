"""A truth as other cameras see it: cropped, turned, mirrored, keystoned; and blur by depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError
from lightmatrix.simulation.truth import Truth

# The disparity map is smoothed by a median filter of this many camera pixels a side, which removes
# single footprints whose strongest entry is global light. Chosen by hand.
_SMOOTHING = 5
# The nearest and the farthest depth are these quantiles of the disparity (and of its mirror image),
# so that single outliers do not set the range. Chosen by hand.
_EXTREME = 0.02
# Blur is rounded to this many levels, so that rows of the same blur are blurred together.
_LEVELS = 8


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
    shift = median_filter(col - step * np.arange(cols), size=_SMOOTHING)
    low, high = np.quantile(shift, [_EXTREME, 1 - _EXTREME])
    share = np.clip((shift - low) / max(high - low, 1e-9), 0, 1)
    return np.asarray(widest * np.rint(share * _LEVELS) / _LEVELS).ravel()
