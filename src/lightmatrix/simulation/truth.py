"""Truth files: a light transport matrix that is known, with its direct part, as T.npz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import TRUTH
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.regions import Region
from lightmatrix.reprs import short_repr
from lightmatrix.store.sparse_npz import VERSION, read_sparse_npz
from lightmatrix.transport.matrix import LightTransport


@dataclass(frozen=True, eq=False)
class Truth:
    """A known light transport matrix, direct and global light kept apart.

    Parameters
    ----------
    matrix : (M, N) csr_array float32
        The whole of T: camera full scale at exposure 1 per unit of projector pixel, >= 0.
    direct_data : (matrix.nnz,) float32
        The direct part of each stored entry, in [0, matrix.data].
    camera_shape : (rows, cols) or (rows, cols, channels)
    projector_shape : (rows, cols)
    metadata : mapping
        JSON-ready: scene, samples per pixel, seed, noise estimate, versions.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> 0 < known.direct_data.sum() < known.matrix.sum()
    np.True_
    >>> known.save("T.npz")
    >>> lm.truth("T.npz").camera_shape
    (64, 64)
    """

    matrix: csr_array
    direct_data: NDArray[np.float32]
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    @property
    def direct(self) -> csr_array:
        """The direct part: light that met one surface."""
        return self.with_data(self.direct_data)

    @property
    def indirect(self) -> csr_array:
        """The global part: light that met two surfaces or more."""
        return self.with_data(self.matrix.data - self.direct_data)

    def with_data(self, data: NDArray[Any]) -> csr_array:
        """A matrix with other values at the places of this one's entries."""
        return csr_array((data, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape)

    def crop(self, region: Region) -> Truth:
        """The rows of a rectangle of the camera's pixels."""
        rows = region.samples(self.camera_shape)
        shape = (*region.shape, *self.camera_shape[2:])
        direct = self.direct[rows].data
        return replace(self, matrix=self.matrix[rows], direct_data=direct, camera_shape=shape)

    def transport(self) -> LightTransport:
        """The truth as a LightTransport without background."""
        return LightTransport.from_matrix(
            self.matrix, self.camera_shape, self.projector_shape, provenance=dict(self.metadata)
        )

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write T.npz, which `scipy.sparse.load_npz` reads too; whole or not at all."""
        matrix = self.matrix
        with (
            atomic_file(path, TRUTH, overwrite=overwrite) as temporary,
            open(temporary, "wb") as stream,
        ):
            np.savez_compressed(
                stream,
                # First, so that even a file that was cut off is known as ours.
                lightmatrix_truth=np.array(VERSION),
                format=np.array("csr").astype("S"),
                # scipy writes this key for arrays, as against matrices.
                _is_array=np.array(True),
                shape=np.array(matrix.shape),
                data=matrix.data,
                indices=matrix.indices,
                indptr=matrix.indptr,
                camera_shape=np.array(self.camera_shape),
                projector_shape=np.array(self.projector_shape),
                direct_data=self.direct_data,
                metadata=np.array(json.dumps(dict(self.metadata))),
            )

    @classmethod
    def load(cls, path: Path) -> Truth:
        """Read a truth file.

        Raises
        ------
        InputError
            If the file is missing, is no npz, contradicts itself, lacks the shapes that
            lightmatrix adds, or is of a later format version.
        """
        found = read_sparse_npz(path)
        if found.camera_shape is None or found.projector_shape is None:
            raise InputError(
                f"{path}: does not say the shapes of camera and projector",
                hint="give a T.npz file from `lightmatrix render` or `lightmatrix export`",
            )
        if found.background is not None and found.background.any():
            raise InputError(
                f"{path} keeps its background apart, so its matrix is not the whole of T",
                hint="export it with --dense-background",
            )
        direct = found.direct_data
        return cls(
            found.matrix,
            np.zeros_like(found.matrix.data) if direct is None else direct,
            found.camera_shape,
            found.projector_shape,
            dict(found.metadata),
        )
