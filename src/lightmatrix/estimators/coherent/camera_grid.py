"""Grids of camera pixels, and means over the neighbours of a camera pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.resources.computed_once import computed_once
from lightmatrix.transport.sparse_rows import SparseRows

# Camera samples that are read at a time to pick those on the grid. Chosen by hand: their frames fit
# into memory many times.
_READ_ROWS = 1 << 16


@dataclass(frozen=True, eq=False)
class CameraGrid:
    """Every `spacing`-th pixel of a camera along both axes."""

    capture: Capture
    spacing: int = 1

    @property
    def camera(self) -> tuple[int, int, int]:
        """Rows, columns and channels of the grid."""
        rows, cols, *channels = self.capture.camera_shape
        return -(-rows // self.spacing), -(-cols // self.spacing), channels[0] if channels else 1

    @property
    def count(self) -> int:
        """Number of samples on the grid."""
        rows, cols, channels = self.camera
        return rows * cols * channels

    def samples(self, start: int, stop: int) -> Samples:
        """Samples start..stop of the grid."""
        if self.spacing == 1:
            return self.capture.samples(start, stop)
        return self._all.rows(slice(start, stop))

    def spread(self, coarser: CameraGrid, rows: SparseRows) -> SparseRows:
        """The rows of a coarser grid in their places on this one, with empty rows between."""
        place = coarser._places(self)
        entries = np.zeros(self.count, np.int64)
        entries[place] = np.diff(rows.coefficients.indptr)
        parts = (
            rows.coefficients.data,
            rows.coefficients.indices,
            np.append(0, np.cumsum(entries)).astype(rows.coefficients.indptr.dtype),
        )
        background = np.zeros((self.count, rows.background.shape[1]), rows.background.dtype)
        background[place] = rows.background
        diagnostics = {}
        for name, values in rows.diagnostics.items():
            diagnostics[name] = np.zeros(self.count, values.dtype)
            diagnostics[name][place] = values
        shape = (self.count, rows.coefficients.shape[1])
        return SparseRows(csr_array(parts, shape=shape), background, diagnostics)

    def refine_jacobian(
        self, coarser: CameraGrid, jacobian: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The Jacobian per pixel of this grid, (M', 4), from that of a coarser grid."""
        times = coarser.spacing // self.spacing
        rows, cols, channels = self.camera
        each = (jacobian / times).reshape(*coarser.camera, 4).astype(np.float32)
        finer = each.repeat(times, axis=0).repeat(times, axis=1)[:rows, :cols]
        return np.ascontiguousarray(finer).reshape(rows * cols * channels, 4)

    def _places(self, finer: CameraGrid) -> NDArray[np.int64]:
        """The numbers of these samples among those of a finer grid."""
        rows, cols, channels = finer.camera
        index = np.arange(rows * cols * channels).reshape(rows, cols, channels)
        times = self.spacing // finer.spacing
        return index[::times, ::times].ravel()

    @computed_once
    def _all(self) -> Samples:
        """All samples on the grid, which are picked from those of the camera once."""
        whole = CameraGrid(self.capture)
        places = self._places(whole)
        parts = []
        for start in range(0, whole.count, _READ_ROWS):
            stop = min(start + _READ_ROWS, whole.count)
            first, last = np.searchsorted(places, (start, stop))
            if first < last:
                parts.append(self.capture.samples(start, stop).rows(places[first:last] - start))
        return Samples.joined(parts)


def mean_around(image: NDArray[Any], known: NDArray[np.bool_], side: int) -> NDArray[np.float64]:
    """Means of the known values in squares around pixels, (rows, cols, channels), or NaN."""
    window = (side, side, 1)
    sums = uniform_filter(np.where(known, image, 0).astype(np.float64), window, mode="nearest")
    shares = uniform_filter(known.astype(np.float64), window, mode="nearest")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(shares > 1e-9, sums / shares, np.nan)
