"""A truth as other cameras see it: parts of the frame, turned, mirrored, out of square."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError
from lightmatrix.simulation.truth import Truth

# Depth is told from where footprints lie; single wrong ones are smoothed away.
_SMOOTHING = 5
# Of the camera pixels to both sides, what is nearest and farthest leaves out.
_EXTREME = 0.02
# Blur is rounded to this many levels, so that rows of the same blur are treated together.
_LEVELS = 8


def seen(truth: Truth, place: NDArray[np.integer]) -> Truth:
    """The truth of a camera whose pixels are chosen from those of another.

    Parameters
    ----------
    truth : Truth
        Of a grey camera.
    place : (rows, cols) int
        Which camera pixel of the truth each pixel is; -1 sees nothing.

    Raises
    ------
    InputError
        On a colour camera.
    """
    if len(truth.camera_shape) != 2:
        raise InputError("a view of a colour camera", hint="choose one of its channels")
    dark = csr_array((1, truth.matrix.shape[1]), dtype=np.float32)
    # What -1 chooses comes last.
    matrix, direct = (
        csr_array(vstack([part, dark], format="csr")[place.ravel()])
        for part in (truth.matrix, truth.direct)
    )
    return replace(truth, matrix=matrix, direct_data=direct.data, camera_shape=place.shape)


def mapped(shape: tuple[int, int], homography: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which pixel of a frame each pixel sees through a homography about its middle, -1 beyond it.

    Parameters
    ----------
    shape : (rows, cols)
        Of both frames.
    homography : (3, 3)
        From (row, col, 1), from the middle in half sides, to the same.
    """
    sides = np.array(shape).reshape(2, 1)
    middle, half = (sides - 1) / 2, sides / 2
    grid = (np.indices(shape).reshape(2, -1) - middle) / half
    to = homography @ np.concatenate([grid, np.ones((1, grid.shape[1]))])
    place = np.rint(to[:2] / to[2] * half + middle).astype(np.int64)
    inside = ((place >= 0) & (place < sides)).all(axis=0)
    return np.where(inside, place[0] * shape[1] + place[1], -1).reshape(shape)


def depth_blur(truth: Truth, widest: float) -> NDArray[np.float64]:
    """Blur of each camera sample that grows with depth, as far as disparity tells it, (M,).

    The projector is in focus where its pixels lie furthest to one side of the camera's, and
    blurred by `widest` where they lie furthest to the other.

    Parameters
    ----------
    truth : Truth
        Of a grey camera, beside a projector.
    widest : float
        Standard deviation in projector pixels.
    """
    rows, cols = truth.camera_shape[:2]
    col = np.asarray(truth.matrix.argmax(axis=1)).reshape(rows, cols) % truth.projector_shape[1]
    step = truth.projector_shape[1] / cols
    shift = median_filter(col - step * np.arange(cols), size=_SMOOTHING)
    low, high = np.quantile(shift, [_EXTREME, 1 - _EXTREME])
    share = np.clip((shift - low) / max(high - low, 1e-9), 0, 1)
    return np.asarray(widest * np.rint(share * _LEVELS) / _LEVELS).ravel()
