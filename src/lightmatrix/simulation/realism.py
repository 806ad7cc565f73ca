"""Effects of real projectors and cameras on a rendered T: blur, vignetting, room light.

Blur and vignetting change T itself, so that relighting and estimation see one consistent matrix.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array, eye_array, kron

from lightmatrix.errors import InputError
from lightmatrix.ranges import as_float, check_number
from lightmatrix.simulation.thinning import joined, thinned_in_steps
from lightmatrix.simulation.truth import Truth


def check_realism(
    projector_shape: tuple[int, int],
    *,
    blur: float = 0.0,
    camera_blur: float = 0.0,
    vignetting: float = 0.0,
    leak: float = 0.0,
    ambient: float = 0.0,
) -> None:
    """Raise InputError on settings out of range, before a scene is rendered for them."""
    widest = max(projector_shape)
    hint = f"use projector pixels from 0 to {widest}, as many as the projector has"
    check_number("a blur", blur, most=widest, hint=hint)
    hint = "use camera pixels from 0 to 100"
    check_number("a blur of the camera", camera_blur, most=100, hint=hint)
    if not 0 <= as_float(vignetting) < 1:
        raise InputError(f"a vignetting of {vignetting}", hint="use a share from 0 to below 1")
    if not 0 <= as_float(leak) < 1:
        raise InputError(f"a leak of {leak}", hint="use a share from 0 to below 1, such as 0.001")
    hint = "use a share of the white image, from 0 to 1000"
    check_number("an ambient level", ambient, most=1000, hint=hint)


def defocus(truth: Truth, sigma: float) -> Truth:
    """Blur the projector by a Gaussian of `sigma` >= 0 projector pixels; its border loses light."""
    if sigma == 0:
        return truth
    rows, cols = truth.projector_shape
    across, along = (
        gaussian_filter1d(np.eye(size, dtype=np.float32), sigma, mode="constant", truncate=3)
        for size in (rows, cols)
    )

    def blurred(part: csr_array) -> NDArray[np.float32]:
        # Two products of large matrices are far faster than many products of small ones.
        once = (part.toarray().reshape(-1, cols) @ along).reshape(-1, rows, cols)
        twice = once.swapaxes(1, 2).reshape(-1, rows) @ across
        return twice.reshape(-1, cols, rows).swapaxes(1, 2).reshape(-1, rows * cols)

    # Dense rows of 32 MiB are blurred at once. Of their many entries, those stay that hold nearly
    # all of the light; the others are gathered (see `thinned`).
    step = max(1, (1 << 23) // (rows * cols))
    direct, parts = truth.direct, []
    for start in range(0, truth.matrix.shape[0], step):
        part = slice(start, start + step)
        whole = csr_array(blurred(truth.matrix[part]))
        row = np.repeat(np.arange(whole.shape[0]), np.diff(whole.indptr))
        straight = blurred(direct[part])[row, whole.indices]
        parts.append(thinned_in_steps(whole, straight, 0.9995))
    matrix, direct_data = joined(parts)
    return replace(truth, matrix=matrix, direct_data=direct_data)


def camera_defocus(truth: Truth, sigma: float) -> Truth:
    """Blur the camera by a Gaussian of `sigma` >= 0 camera pixels, which mixes the rows of T."""
    if sigma == 0:
        return truth
    sides = truth.camera_shape[:2]
    across, along = (
        csr_array(gaussian_filter1d(np.eye(n), sigma, axis=0, mode="nearest", truncate=3))
        for n in sides
    )
    channels = eye_array(truth.matrix.shape[0] // (sides[0] * sides[1]))
    mixed = csr_array(kron(kron(across, along), channels), dtype=np.float32)
    # Direct light travels along as the imaginary part, so that both have the same entries.
    both = truth.with_data(truth.matrix.data + 1j * truth.direct_data)
    parts = []
    for start in range(0, mixed.shape[0], 1024):
        part = mixed[start : start + 1024] @ both
        whole = csr_array((part.data.real, part.indices, part.indptr), shape=part.shape)
        parts.append(thinned_in_steps(whole, np.ascontiguousarray(part.data.imag), 0.9995))
    matrix, direct_data = joined(parts)
    return replace(truth, matrix=matrix, direct_data=direct_data)


def vignetting(truth: Truth, strength: float) -> Truth:
    """Gain 1 - strength r^2, r from the middle to 1 in the corners; strength in [0, 1)."""
    rows, cols = truth.camera_shape[:2]
    y = np.linspace(-1, 1, rows)[:, None]
    x = np.linspace(-1, 1, cols)[None, :]
    gain = (1 - strength * (x**2 + y**2) / 2).ravel()
    channels = truth.camera_shape[2] if len(truth.camera_shape) == 3 else 1
    gain = np.repeat(gain, channels).astype(np.float32)
    entry_gain = np.repeat(gain, np.diff(truth.matrix.indptr))
    return truth.scaled(entry_gain)


def ambient(truth: Truth, level: float) -> NDArray[np.float32]:
    """Image of the room's light alone, (M,) float32; its mean is `level` times that under white."""
    white = np.asarray(truth.matrix.sum(axis=1), np.float64).reshape(*truth.camera_shape[:2], -1)
    # Room light comes from all sides and has no shadow edges, so the white image is blurred by six
    # camera pixels (standard deviation).
    smooth = gaussian_filter1d(gaussian_filter1d(white, 6, axis=0), 6, axis=1)
    return np.asarray(level * smooth.ravel(), np.float32)
