"""Camera pixels on a grid: some of them, evenly spread, as if they were all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.transport.sparse_rows import SparseRows

# Camera samples that are read at a time while those on the grid are picked out.
READ = 1 << 16


@dataclass(frozen=True, eq=False)
class CameraGrid:
    """Every so-manieth pixel of a camera both ways.

    Parameters
    ----------
    capture : Capture
        M camera samples.
    spacing : int
        1 takes all pixels.
    """

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

    def grown(self, coarser: CameraGrid, found: SparseRows) -> SparseRows:
        """What was found on a coarser grid of the same camera in its places, nothing elsewhere."""
        place = coarser._places(self)
        entries = np.zeros(self.count, np.int64)
        entries[place] = np.diff(found.coefficients.indptr)
        parts = (
            found.coefficients.data,
            found.coefficients.indices,
            np.append(0, np.cumsum(entries)).astype(found.coefficients.indptr.dtype),
        )
        background = np.zeros((self.count, found.background.shape[1]), found.background.dtype)
        background[place] = found.background
        facts = {}
        for name, values in found.diagnostics.items():
            facts[name] = np.zeros(self.count, values.dtype)
            facts[name][place] = values
        shape = (self.count, found.coefficients.shape[1])
        return SparseRows(csr_array(parts, shape=shape), background, facts)

    def movement(self, coarser: CameraGrid, moved: NDArray[np.float32]) -> NDArray[np.float32]:
        """How footprints move on this grid, (M', 4), by how they move on a coarser one."""
        times = coarser.spacing // self.spacing
        rows, cols, channels = self.camera
        each = (moved / times).reshape(*coarser.camera, 4).astype(np.float32)
        finer = each.repeat(times, axis=0).repeat(times, axis=1)[:rows, :cols]
        return np.ascontiguousarray(finer).reshape(rows * cols * channels, 4)

    def _places(self, finer: CameraGrid) -> NDArray[np.int64]:
        """Where the samples lie among those of a finer grid."""
        rows, cols, channels = finer.camera
        index = np.arange(rows * cols * channels).reshape(rows, cols, channels)
        times = self.spacing // finer.spacing
        return index[::times, ::times].ravel()

    @cached_property
    def _all(self) -> Samples:
        """All samples on the grid, picked out of the camera's once."""
        whole = CameraGrid(self.capture)
        places = self._places(whole)
        parts = []
        for start in range(0, whole.count, READ):
            stop = min(start + READ, whole.count)
            first, last = np.searchsorted(places, (start, stop))
            if first < last:
                parts.append(self.capture.samples(start, stop).rows(places[first:last] - start))
        return Samples.joined(parts)
