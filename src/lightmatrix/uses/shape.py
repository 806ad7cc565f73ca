"""`Shape`: the surface that a camera sees, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import MissingExtraError
from lightmatrix.geometry.projection import decomposed
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.pictures.transport import Picture
from lightmatrix.reprs import short_repr
from lightmatrix.uses.shape_files import write_cloud, write_depth
from lightmatrix.uses.shape_picture import shape_picture
from lightmatrix.uses.surfaces import surface_faces


class ShapeTest(IntEnum):
    """What became of a camera pixel, the values of `Shape.test`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> shape = lm.triangulate(known.transport(), known.geometry)
    >>> bool((shape.test == lm.ShapeTest.OFF_LINE).any())
    True
    """

    KEPT = 0
    # There is no light beside its epipolar line, or its code is not readable.
    NO_LIGHT = 1
    # The spot holds too small a share of the row's light.
    WEAK = 2
    # The spot lies too far from the line.
    OFF_LINE = 3
    # The estimate states too large an error.
    UNCERTAIN = 4
    # The point would lie behind the camera or the projector.
    BEHIND = 5


@dataclass(frozen=True, eq=False)
class Shape:
    """The surface that a camera sees, pixel by pixel.

    Parameters
    ----------
    depth : (rows, cols) float32
        Distance along the camera's axis in the unit of the geometry; NaN where there is none.
    points : (rows, cols, 3) float32
        Points of the world; NaN where there is none.
    normals : (rows, cols, 3) float32
        Unit normals that face the camera, from the neighbours within 2 pixels; NaN where too few
        neighbours have a depth.
    albedo : (rows, cols) float32
        Direct light under a white pattern, in units of the clip level.
    uncertainty : (rows, cols) float32
        Standard deviation of the depth, from how far this pixel and its neighbours lie from their
        epipolar lines, on which exact places would lie.
    test : (rows, cols) uint8
        Which test a pixel failed first, see `ShapeTest`; 0 where the point was kept.
    place : (rows, cols, 2) float32
        Row and column of the projector pixel that lights each point, before its projection onto the
        epipolar line.
    from_line : (rows, cols) float32
        Its distance from the line, in projector pixels.
    geometry : RigGeometry
        Of images of these sizes.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("l_objects")
    >>> shape = lm.triangulate(known.transport(), known.geometry)
    >>> bool(np.nanmedian(np.abs(shape.depth - known.depth)) < 0.01)
    True
    """

    depth: NDArray[np.float32]
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    albedo: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    test: NDArray[np.uint8]
    place: NDArray[np.float32]
    from_line: NDArray[np.float32]
    geometry: RigGeometry

    __repr__ = short_repr

    @property
    def kept(self) -> NDArray[np.bool_]:
        """The pixels that have a depth, (rows, cols)."""
        return self.test == ShapeTest.KEPT

    @property
    def camera_normals(self) -> NDArray[np.float32]:
        """The normals in the camera's frame: to the right, down, forwards; (rows, cols, 3)."""
        turn = decomposed(self.geometry.camera_matrix)[1]
        return np.asarray(self.normals @ turn.T, np.float32)

    def summary(self) -> dict[str, Any]:
        """Number of points, their median depth and uncertainty, and pixels by `ShapeTest`."""
        points = int(self.kept.sum())
        depth, error = (
            float(np.median(values[self.kept])) if points else float("nan")
            for values in (self.depth, self.uncertainty)
        )
        return {
            "points": points,
            "median_depth": depth,
            "median_uncertainty": error,
            "pixels": {test.name.lower(): int((self.test == test).sum()) for test in ShapeTest},
        }

    def save(self, path: str | Path, *, mesh: bool = False, overwrite: bool = False) -> None:
        """Write the points as PLY, with normals, grey values and the uncertainty of the depth.

        Parameters
        ----------
        path : str or Path
            The file, .ply.
        mesh : bool
            Whether to write triangles between neighbouring pixels on one surface too.
        overwrite : bool
            Whether an existing point cloud may be replaced.

        Raises
        ------
        OutputError
            If the file exists, is not one of ours, or cannot be written.
        """
        faces = surface_faces(self.depth, self.geometry) if mesh else None
        write_cloud(
            path,
            self.points,
            self.normals,
            self.albedo,
            self.uncertainty,
            faces,
            overwrite=overwrite,
        )

    def save_depth(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the depth as float32, NaN where there is none: .tif, .tiff or .npy.

        Raises
        ------
        OutputError
            If the file exists or cannot be written.
        """
        write_depth(path, self.depth, overwrite=overwrite)

    def show(self) -> Picture:
        """A Matplotlib figure: maps of depth and normals, and which test a pixel failed."""
        names = [test.name for test in ShapeTest]
        units = self.geometry.units
        return shape_picture(self.depth, self.camera_normals, self.test, names, units)

    def mesh(self) -> Any:
        """The surface as a `trimesh.Trimesh`, which writes STL, OBJ and GLB and measures meshes.

        Raises
        ------
        MissingExtraError
            If trimesh is not installed.
        """
        try:
            import trimesh
        except ImportError as error:
            raise MissingExtraError(
                "meshes need trimesh", hint="install it with `pip install 'lightmatrix[shape]'`"
            ) from error
        faces = surface_faces(self.depth, self.geometry)
        used, corners = np.unique(faces, return_inverse=True)
        points = self.points.reshape(-1, 3)[used]
        return trimesh.Trimesh(points, corners.reshape(-1, 3), process=False)
