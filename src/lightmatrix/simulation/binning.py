"""A truth as a camera or projector of lower resolution would measure it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.simulation.truth import Truth


def coarse(truth: Truth, factor: int) -> Truth:
    """A truth with camera and projector pixels binned by the same factor; see `binned`."""
    return binned(truth, factor, factor)


def binned(truth: Truth, camera_factor: int, projector_factor: int) -> Truth:
    """Average T over square blocks of camera pixels, and sum it over those of the projector."""
    camera, projector = truth.camera_shape, truth.projector_shape
    for factor, sizes in ((camera_factor, camera[:2]), (projector_factor, projector)):
        if factor < 1 or any(size % factor for size in sizes):
            raise InputError(f"a factor of {factor} for sizes {sizes}", hint="use a common divisor")
    if camera_factor == projector_factor == 1:
        return truth
    channels = camera[2] if len(camera) == 3 else 1
    small_camera = (camera[0] // camera_factor, camera[1] // camera_factor, *camera[2:])
    small_projector = (projector[0] // projector_factor, projector[1] // projector_factor)

    row = np.repeat(np.arange(truth.matrix.shape[0]), np.diff(truth.matrix.indptr))
    pixel, channel = np.divmod(row, channels)
    y, x = np.divmod(pixel, camera[1])
    row = ((y // camera_factor) * small_camera[1] + x // camera_factor) * channels + channel
    v, u = np.divmod(truth.matrix.indices, projector[1])
    col = (v // projector_factor) * small_projector[1] + u // projector_factor
    shape = (int(np.prod(small_camera)), int(np.prod(small_projector)))

    # Direct light is the imaginary part of the same entries, so that both are summed alike.
    mean = camera_factor**2
    both = truth.matrix.data / mean + 1j * (truth.direct_data / mean)
    summed = csr_array((both, (row, col)), shape=shape)
    summed.sum_duplicates()
    parts = (summed.indices, summed.indptr)
    matrix = csr_array((summed.data.real.astype(np.float32), *parts), shape=shape)
    metadata = {**truth.metadata, "coarse": [camera_factor, projector_factor]}
    direct = summed.data.imag.astype(np.float32)
    geometry = truth.geometry and truth.geometry.scaled(camera_factor, projector_factor)
    return Truth(matrix, direct, small_camera, small_projector, metadata, geometry)
