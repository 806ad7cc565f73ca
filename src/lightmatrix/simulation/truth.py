"""`Truth`: a known light transport matrix with its direct part, and its file T.npz."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture import settings
from lightmatrix.errors import InputError
from lightmatrix.files.images import fill_image
from lightmatrix.files.kinds import TRUTH
from lightmatrix.files.reading import parse_json
from lightmatrix.files.writing import atomic_file
from lightmatrix.geometry.rig_geometry import RigGeometry, checked_fields
from lightmatrix.regions import Region
from lightmatrix.reprs import ShortRepr
from lightmatrix.simulation.scenes import Scene, names, scene
from lightmatrix.simulation.shapes import Mesh, merge
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.npz import VERSION, matrix_arrays, read_transport, text_of
from lightmatrix.transport.sparse_rows import checked_float32

# The surface that each camera pixel of a scene sees: exact depth and normals, without a renderer.
#
# Every pixel's ray meets the planes of the triangles whose images cover the pixel, and the nearest
# one counts.

# Pairs of a triangle and a pixel that are tested at a time: about 300 MB of temporary arrays.
_PAIRS = 1 << 21
# Rays through an edge belong to both triangles: they may miss each by this share of its area.
_EDGE = 1e-9


def view_geometry(
    scene: Scene, camera_shape: tuple[int, ...], projector_shape: tuple[int, int]
) -> RigGeometry:
    """The geometry of a scene's camera and projector for images of these sizes."""
    rows, cols = camera_shape[:2]
    return RigGeometry(
        scene.camera.matrix((rows, cols)), scene.projector.matrix(projector_shape), (rows, cols),
        projector_shape, units="scene unit",
    )  # fmt: skip


def trace_surface(
    scene: Scene, geometry: RigGeometry
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth (rows, cols) and unit normals (rows, cols, 3) of a scene; NaN where nothing is seen.

    As a camera without distortion sees it at the centres of its pixels. Depth is along its axis,
    and normals face it, in the world's frame.
    """
    mesh = merge([part.mesh for part in scene.parts])
    corners = mesh.vertices[mesh.faces]
    # Triangles behind the camera do not occur, since scenes lie in front of it.
    depth, nearest = _nearest(mesh, geometry)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(invalid="ignore"):
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = ((corners[:, 0] - geometry.camera_centre) * normals).sum(axis=1) > 0
    normals[away] *= -1
    seen = np.where((nearest >= 0)[:, None], normals[nearest], np.nan)
    return depth.reshape(geometry.camera_shape), seen.reshape(*geometry.camera_shape, 3)


def _nearest(mesh: Mesh, geometry: RigGeometry) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Depth (pixels,) of the nearest triangle at each pixel centre and its number, -1 for none."""
    matrix = geometry.camera_matrix
    rows, cols = geometry.camera_shape
    # In homogeneous pixels, the third number of a point is its depth.
    points = (mesh.vertices @ matrix[:, :3].T + matrix[:, 3])[mesh.faces]
    image = points[..., :2] / points[..., 2:]
    first = np.ceil(image.min(axis=1) - _EDGE).astype(np.int64).clip(0)
    last = np.floor(image.max(axis=1) + _EDGE).astype(np.int64)
    last = np.minimum(last, [cols - 1, rows - 1])
    sizes = (last - first + 1).clip(0)
    counts = sizes.prod(axis=1)
    depth = np.full(rows * cols, np.inf)
    nearest = np.full(rows * cols, -1, np.int64)
    # Triangles in batches of about as many pixels; one triangle may have more.
    batch = np.cumsum(counts) // _PAIRS
    cuts = [0, *(np.flatnonzero(np.diff(batch)) + 1).tolist(), len(counts)]
    for start, stop in pairwise(cuts):
        triangle = np.repeat(np.arange(start, stop), counts[start:stop])
        within = np.arange(len(triangle)) - np.repeat(
            np.cumsum(counts[start:stop]) - counts[start:stop], counts[start:stop]
        )
        row, col = np.divmod(within, sizes[triangle, 0])
        col, row = first[triangle, 0] + col, first[triangle, 1] + row
        hit, distance = _hits(points[triangle], np.column_stack([col, row]))
        pixel, distance, triangle = (row * cols + col)[hit], distance[hit], triangle[hit]
        # The nearest of each pixel comes last, and is the one that an assignment keeps.
        order = np.argsort(-distance)
        closer = order[distance[order] < depth[pixel[order]]]
        depth[pixel[closer]] = distance[closer]
        nearest[pixel[closer]] = triangle[closer]
    return np.where(nearest >= 0, depth, np.nan), nearest


def _hits(
    points: NDArray[np.float64], pixels: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether rays of pixels (n, 2) meet triangles (n, 3, 3) in homogeneous pixels, and the depth.

    With a ray r = (col, row, 1), corners a, b, c and their determinant [a b c], the ray meets the
    plane at the depth [a b c] / ([r b c] + [a r c] + [a b r]), inside if all terms have one sign.
    """
    a, b, c = points[:, 0], points[:, 1], points[:, 2]
    ray = np.column_stack([pixels, np.ones(len(pixels))])
    terms = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    parts = np.einsum("ntk,nk->nt", terms, ray)
    total = parts.sum(axis=1)
    volume = (a * terms[:, 0]).sum(axis=1)
    parts *= np.sign(total)[:, None]
    with np.errstate(all="ignore"):
        depth = volume / total
        inside = (parts >= -_EDGE * np.abs(total)[:, None]).all(axis=1)
    return inside & (total != 0) & (depth > 0), depth


@dataclass(frozen=True, eq=False, repr=False)
class Truth(ShortRepr):
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
        return None if self._surface is None else self._surface[0]

    @property
    def normals(self) -> NDArray[np.float64] | None:
        """Unit normals (rows, cols, 3) that face the camera, in the world's frame; as `depth`."""
        return None if self._surface is None else self._surface[1]

    @cached_property
    def _surface(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Depth and normals of a scene of ours that has not changed since it was rendered."""
        name = self.metadata.get("scene")
        built = scene(str(name)) if name in names() else None
        if self.geometry is None or built is None:
            return None
        same = built.version == self.metadata.get("scene_version")
        return trace_surface(built, self.geometry) if same else None

    def with_data(self, data: NDArray[Any]) -> csr_array:
        """A matrix with the same places of entries but other values, (nnz,)."""
        return csr_array((data, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape)

    def scaled(self, gain: np.float32 | NDArray[np.floating]) -> "Truth":
        """The truth with its entries multiplied by a gain, or each by its own, (nnz,)."""
        direct = np.asarray(self.direct_data * gain, np.float32)
        return replace(self, matrix=self.with_data(self.matrix.data * gain), direct_data=direct)

    def crop(self, region: Region) -> "Truth":
        """The truth of a rectangle of the camera's pixels."""
        rows = region.samples(self.camera_shape)
        shape = (*region.shape, *self.camera_shape[2:])
        return replace(
            self, matrix=self.matrix[rows], direct_data=self.direct[rows].data, camera_shape=shape,
            geometry=self.geometry and self.geometry.cropped(region.corner, region.shape),
        )  # fmt: skip

    def transport(self) -> LightTransport:
        """The truth as a LightTransport without background."""
        return LightTransport.from_matrix(
            self.matrix, self.camera_shape, self.projector_shape, provenance=dict(self.metadata)
        )

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write a truth file, T.npz, which `scipy.sparse.load_npz` reads too."""
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
                **matrix_arrays(self.matrix),
                camera_shape=np.array(self.camera_shape),
                projector_shape=np.array(self.projector_shape),
                direct_data=self.direct_data,
                metadata=np.array(json.dumps(dict(self.metadata))),
                **known,
            )

    def save_beside(self, folder: Path) -> None:
        """Write truth.npz into a folder, and geometry.json and depth.tiff where they are known."""
        self.save(folder / settings.TRUTH)
        if self.geometry is not None:
            self.geometry.save(folder / settings.GEOMETRY)
        if self.depth is not None:
            fill_image(folder / settings.DEPTH, self.depth, missing=True)

    @classmethod
    def load(cls, path: Path) -> "Truth":
        """Read a truth file.

        Raises
        ------
        InputError
            If the file is missing, damaged, no npz file, of a later format version, or lacks the
            shapes that lightmatrix adds.
        """
        known, content = read_transport(path)
        if known.background.any():
            raise InputError(
                f"{path} holds its background separately, so its matrix is not the whole of T",
                hint="export it with dense_background=True",
            )
        matrix, geometry = known.sparse, None
        if "geometry" in content:
            fields = parse_json(text_of(content["geometry"]), f"{path}: geometry")
            geometry = RigGeometry(**checked_fields(fields, str(path)))
        try:
            direct = content.get("direct_data", np.zeros_like(matrix.data))
            direct = checked_float32(direct, "the direct part")
            if direct.shape != matrix.data.shape:
                raise ValueError(f"{direct.shape} direct parts for {matrix.nnz} entries")
            sizes = known.camera_shape[:2], known.projector_shape
            if geometry and (geometry.camera_shape, geometry.projector_shape) != sizes:
                raise ValueError("its geometry has other image sizes")
        except ValueError as error:
            hint = "the file is damaged; write it again"
            raise InputError(f"{path}: contradicts itself: {error}", hint=hint) from error
        shapes = known.camera_shape, known.projector_shape
        return cls(matrix, direct, *shapes, dict(known.provenance), geometry)


def binned(truth: Truth, camera_factor: int, projector_factor: int | None = None) -> Truth:
    """T as devices of lower resolution measure it: blocks averaged (camera), summed (projector).

    Without a factor of its own, the projector has the camera's.
    """
    projector_factor = camera_factor if projector_factor is None else projector_factor
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
