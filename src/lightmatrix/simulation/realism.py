"""What a real rig adds to a rendered T: blur, leaking black, vignetting, ambient light.

All but ambient light act on T, so that relighting and estimation see one consistent matrix.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_number
from lightmatrix.simulation.thinning import sparse_rows, stacked
from lightmatrix.simulation.truth import Truth

# Share of a row's sum that is kept after blurring; its total stays the same.
_KEEP = 0.9995
# Places of dense rows that are blurred at once.
_BLOCK_PLACES = 1 << 23


def check_realism(
    projector_shape: tuple[int, int],
    *,
    blur: float = 0.0,
    vignetting: float = 0.0,
    leak: float = 0.0,
    ambient: float = 0.0,
) -> None:
    """Refuse numbers out of range, before a scene is rendered for them.

    Raises
    ------
    InputError
        On a blur wider than the projector, a vignetting or leak outside of [0, 1), or room light
        that is negative or a thousand times the projector's.
    """
    widest = max(projector_shape)
    hint = f"use projector pixels from 0 to {widest}, as many as the projector has"
    check_number("a blur", blur, most=widest, hint=hint)
    if not 0 <= vignetting < 1:
        raise InputError(f"a vignetting of {vignetting}", hint="use a share from 0 to below 1")
    if not 0 <= leak < 1:
        raise InputError(f"a leak of {leak}", hint="use a share from 0 to below 1, such as 0.001")
    hint = "use a share of the white image, from 0 to 1000"
    check_number("an ambient level", ambient, most=1000, hint=hint)


def defocus(truth: Truth, sigma: float) -> Truth:
    """Blur the projector: each pixel spreads as a Gaussian over its neighbours.

    Parameters
    ----------
    sigma : float
        Standard deviation in projector pixels, >= 0. A camera pixel that sees the border of the
        projector's field gets less light: beyond the border there is no pixel to blur into it.
    """
    return varying_defocus(truth, np.full(truth.matrix.shape[0], float(sigma)))


def varying_defocus(truth: Truth, sigmas: NDArray[np.float64]) -> Truth:
    """Blur the projector by an amount that depends on what a camera sample sees, as depth does.

    Parameters
    ----------
    sigmas : (M,)
        Standard deviation in projector pixels, >= 0, for each camera sample.
    """
    widths, group = np.unique(sigmas, return_inverse=True)
    for sigma in widths:
        check_realism(truth.projector_shape, blur=float(sigma))
    parts, order = [], []
    for number, sigma in enumerate(widths):
        chosen = np.flatnonzero(group == number)
        order.append(chosen)
        parts += _defocused(truth, chosen, float(sigma))
    if len(widths) == 1 and widths[0] == 0:
        return truth
    matrix, direct_data = stacked(parts)
    if len(widths) == 1:
        return replace(truth, matrix=matrix, direct_data=direct_data)
    back = np.argsort(np.concatenate(order), kind="stable")
    direct = csr_array((direct_data, matrix.indices, matrix.indptr), shape=matrix.shape)
    return replace(truth, matrix=csr_array(matrix[back]), direct_data=csr_array(direct[back]).data)


def _defocused(truth: Truth, chosen: NDArray[np.integer], sigma: float) -> list[Any]:
    """Chosen rows, blurred alike, in parts."""
    rows, cols = truth.projector_shape
    across, along = _blur_matrix(rows, sigma), _blur_matrix(cols, sigma)

    def blurred(part: csr_array) -> NDArray[np.float32]:
        # As two plain products of large matrices, far faster than many products of small ones.
        once = (part.toarray().reshape(-1, cols) @ along).reshape(-1, rows, cols)
        twice = once.swapaxes(1, 2).reshape(-1, rows) @ across
        return twice.reshape(-1, cols, rows).swapaxes(1, 2).reshape(-1, rows * cols)

    step = max(1, _BLOCK_PLACES // (rows * cols))
    direct = truth.direct
    parts = []
    for start in range(0, len(chosen), step):
        block = chosen[start : start + step]
        # A blurred row has many entries that hold next to nothing.
        parts.append(sparse_rows(blurred(truth.matrix[block]), blurred(direct[block]), _KEEP))
    return parts


def vignetting(truth: Truth, strength: float) -> Truth:
    """Darken the camera's corners: gain 1 - strength * (distance from the middle)^2, 1 at corners.

    Parameters
    ----------
    strength : float
        Light lost in the corners, in [0, 1).
    """
    check_realism(truth.projector_shape, vignetting=strength)
    rows, cols = truth.camera_shape[:2]
    y = np.linspace(-1, 1, rows)[:, None]
    x = np.linspace(-1, 1, cols)[None, :]
    gain = (1 - strength * (x**2 + y**2) / 2).ravel()
    channels = truth.camera_shape[2] if len(truth.camera_shape) == 3 else 1
    gain = np.repeat(gain, channels).astype(np.float32)
    of_entry = np.repeat(gain, np.diff(truth.matrix.indptr))
    matrix = truth.with_data(truth.matrix.data * of_entry)
    return replace(
        truth, matrix=matrix, direct_data=np.asarray(truth.direct_data * of_entry, np.float32)
    )


def leak(patterns: NDArray[np.floating], level: float) -> NDArray[np.float32]:
    """What a projector really shows: black leaks, p -> level + (1 - level) p.

    Parameters
    ----------
    patterns : array
        Patterns in [0, 1].
    level : float
        Light of a black pixel as a share of a white one (1 / contrast), in [0, 1).
    """
    check_realism((1, 1), leak=level)
    return np.asarray(level + (1 - level) * patterns, np.float32)


def ambient(truth: Truth, level: float) -> NDArray[np.float32]:
    """Camera image of the room's light alone, (M,) float32: as diffuse as the scene under white.

    Parameters
    ----------
    level : float
        Its mean as a share of the mean image under a white pattern, >= 0.
    """
    check_realism(truth.projector_shape, ambient=level)
    white = np.asarray(truth.matrix.sum(axis=1), np.float64).reshape(*truth.camera_shape[:2], -1)
    # Room light comes from all sides, so it knows no shadow edges of the projector.
    smooth = gaussian_filter1d(gaussian_filter1d(white, 6, axis=0), 6, axis=1)
    return np.asarray(level * smooth.ravel(), np.float32)


def _blur_matrix(size: int, sigma: float) -> NDArray[np.float32]:
    if sigma == 0:
        return np.eye(size, dtype=np.float32)
    return gaussian_filter1d(np.eye(size, dtype=np.float32), sigma, mode="constant", truncate=3)
