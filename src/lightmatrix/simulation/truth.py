"""`Truth`: a known light transport matrix with its direct part, and its file T.npz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.settings import DEPTH as DEPTH_NAME
from lightmatrix.capture.settings import GEOMETRY as GEOMETRY_NAME
from lightmatrix.capture.settings import TRUTH as TRUTH_NAME
from lightmatrix.errors import InputError
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.outputs.kinds import TRUTH
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.regions import Region
from lightmatrix.reprs import short_repr
from lightmatrix.simulation.scenes import names, scene
from lightmatrix.simulation.scenes.scene import Scene
from lightmatrix.simulation.surface import Surface, finer, trace_surface
from lightmatrix.store.npz import VERSION, read_sparse_npz
from lightmatrix.transport.matrix import LightTransport


@dataclass(frozen=True, eq=False)
class Truth:
    """A known light transport matrix, direct and global light kept apart.

    Parameters
    ----------
    matrix : (M, N) csr_array float32
        The whole of T, >= 0, in camera full scale at exposure 1 per unit of projector pixel.
    direct_data : (matrix.nnz,) float32
        The direct part of each stored entry, in [0, matrix.data].
    camera_shape : (rows, cols) or (rows, cols, channels)
        Shape of a camera image.
    projector_shape : (rows, cols)
        Shape of a pattern.
    metadata : mapping
        Scene, samples per pixel, seed, noise estimate and versions, JSON-ready.
    geometry : RigGeometry, optional
        Where camera and projector stand, in the world's frame of the scene; None where T is not of
        a rendered scene.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> 0 < known.direct_data.sum() < known.matrix.sum()
    np.True_
    >>> known.save("T.npz")
    >>> lm.truth("T.npz").camera_shape
    (64, 64)
    >>> round(float(known.depth[0, 0]), 3), known.normals.shape
    (4.0, (64, 64, 3))
    """

    matrix: csr_array
    direct_data: NDArray[np.float32]
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    geometry: RigGeometry | None = None

    __repr__ = short_repr

    @property
    def direct(self) -> csr_array:
        """The direct part: light that met one surface."""
        return self.with_data(self.direct_data)

    @property
    def indirect(self) -> csr_array:
        """The global part: light that met at least two surfaces."""
        return self.with_data(self.matrix.data - self.direct_data)

    @property
    def depth(self) -> NDArray[np.float64] | None:
        """Exact depth along the camera's axis at each pixel's centre, (rows, cols).

        NaN where a pixel sees nothing; None if the scene or its geometry is not known, or the scene
        has changed since T was rendered.
        """
        return None if self._surface is None else self._surface.depth

    @property
    def normals(self) -> NDArray[np.float64] | None:
        """Unit normals (rows, cols, 3) that face the camera, in the world's frame; as `depth`."""
        return None if self._surface is None else self._surface.normals

    def depths_within(self, side: int) -> NDArray[np.float64] | None:
        """Exact depths on a grid of `side` x `side` points in each pixel, (rows, cols, side^2).

        A pixel at an edge sees several surfaces; the depth of its centre belongs to one of them.
        """
        if self._scene is None or self.geometry is None:
            return None
        fine = trace_surface(self._scene, finer(self.geometry, side)).depth
        rows, cols = self.geometry.camera_shape
        blocks = fine.reshape(rows, side, cols, side).swapaxes(1, 2)
        return blocks.reshape(rows, cols, side * side)

    @cached_property
    def _scene(self) -> Scene | None:
        """The scene that was rendered, if it is one of ours and has not changed since."""
        name = self.metadata.get("scene")
        if name not in names():
            return None
        built = scene(str(name))
        return built if built.version == self.metadata.get("scene_version") else None

    @cached_property
    def _surface(self) -> Surface | None:
        if self._scene is None or self.geometry is None:
            return None
        return trace_surface(self._scene, self.geometry)

    def with_data(self, data: NDArray[Any]) -> csr_array:
        """A matrix with the same places of entries but other values, (nnz,)."""
        return csr_array((data, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape)

    def crop(self, region: Region) -> Truth:
        """The truth of a rectangle of the camera's pixels."""
        rows = region.samples(self.camera_shape)
        shape = (*region.shape, *self.camera_shape[2:])
        direct = self.direct[rows].data
        geometry = self.geometry and self.geometry.cropped(region.corner, region.shape)
        return replace(
            self,
            matrix=self.matrix[rows],
            direct_data=direct,
            camera_shape=shape,
            geometry=geometry,
        )

    def transport(self) -> LightTransport:
        """The truth as a LightTransport without background."""
        return LightTransport.from_matrix(
            self.matrix, self.camera_shape, self.projector_shape, provenance=dict(self.metadata)
        )

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write a truth file, T.npz, which `scipy.sparse.load_npz` reads too."""
        matrix = self.matrix
        known: dict[str, Any] = {}
        if self.geometry is not None:
            known["geometry"] = np.array(json.dumps(self.geometry.as_dict()))
        with (
            atomic_file(path, TRUTH, overwrite=overwrite) as temporary,
            open(temporary, "wb") as stream,
        ):
            np.savez_compressed(
                stream,
                # This key comes first, so that even a truncated file is recognised as a truth.
                lightmatrix_truth=np.array(VERSION),
                format=np.array("csr").astype("S"),
                # SciPy writes this key to tell arrays from matrices.
                _is_array=np.array(True),
                shape=np.array(matrix.shape),
                data=matrix.data,
                indices=matrix.indices,
                indptr=matrix.indptr,
                camera_shape=np.array(self.camera_shape),
                projector_shape=np.array(self.projector_shape),
                direct_data=self.direct_data,
                metadata=np.array(json.dumps(dict(self.metadata))),
                **known,
            )

    def save_beside(self, folder: Path) -> None:
        """Write truth.npz into a folder, and geometry.json and depth.tiff where they are known."""
        self.save(folder / TRUTH_NAME)
        if self.geometry is not None:
            self.geometry.save(folder / GEOMETRY_NAME)
        if self.depth is not None:
            tifffile.imwrite(folder / DEPTH_NAME, self.depth.astype(np.float32))

    @classmethod
    def load(cls, path: Path) -> Truth:
        """Read a truth file.

        Raises
        ------
        InputError
            If the file is missing, damaged, no npz file, of a later format version, or lacks the
            shapes that lightmatrix adds.
        """
        content = read_sparse_npz(path)
        if content.camera_shape is None or content.projector_shape is None:
            raise InputError(
                f"{path} does not hold the shapes of camera and projector",
                hint="give a T.npz file from `lightmatrix render` or `lightmatrix export`",
            )
        if content.background is not None and content.background.any():
            raise InputError(
                f"{path} holds its background separately, so its matrix is not the whole of T",
                hint="export it with --dense-background",
            )
        direct = content.direct_data
        return cls(
            content.matrix,
            np.zeros_like(content.matrix.data) if direct is None else direct,
            content.camera_shape,
            content.projector_shape,
            dict(content.metadata),
            content.geometry,
        )
