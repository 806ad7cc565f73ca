"""`Shape`: the surface that a camera sees, pixel by pixel."""

import re
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix import pictures
from lightmatrix.errors import InputError, warn
from lightmatrix.files.images import fill_image
from lightmatrix.files.kinds import CLOUD, DEPTH, OUR_MARK
from lightmatrix.files.writing import atomic_file
from lightmatrix.geometry.rig_geometry import Array, RigGeometry, decomposed
from lightmatrix.paths import as_path
from lightmatrix.reprs import ShortRepr
from lightmatrix.uses.separation import shifted


def millimetres(geometry: RigGeometry) -> float:
    """Millimetres in the unit of a geometry, or an InputError."""
    known = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8}
    if (factor := known.get(geometry.units or "")) is None:
        given = f"is {geometry.units!r}" if geometry.units else "is unknown"
        raise InputError(
            f"depths cannot be converted to millimetres: the unit of the geometry {given}",
            hint="write the depth as .tif or .npy, in that unit; or calibrate with a length in "
            f"{', '.join(known)}",
        )
    return factor


# Normals and triangles of a surface of which the depth of each camera pixel is known.


def _steepest_step(depth: NDArray[np.floating], geometry: RigGeometry) -> Array:
    """The largest change of depth from a pixel to the next on one surface, (rows, cols)."""
    focal = float(np.sqrt(np.prod(np.diag(geometry.camera_intrinsics)[:2])))
    # Surfaces inclined by more than 70 degrees to the image plane reflect little of the projector's
    # light. Chosen by hand.
    return np.asarray(depth / focal * np.tan(np.radians(70)), np.float64)


def surface_normals(
    points: NDArray[np.float32], depth: NDArray[np.float32], geometry: RigGeometry
) -> NDArray[np.float32]:
    """Unit normals (rows, cols, 3) that face the camera, by planes through 5 x 5 points.

    The plane n . x = 1, relative to the camera, is the least-squares solution over the neighbours
    on the same surface; its right-hand side weighs all of them alike.
    """
    rows, cols = depth.shape
    centre = geometry.camera_centre
    # Relative to the camera, and of size about 1, so that the normal equations stay well scaled.
    scale = float(np.nanmedian(depth)) if np.isfinite(depth).any() else 1.0
    local = (points - centre) / scale
    limit = _steepest_step(depth, geometry)
    known = np.nan_to_num(local.astype(np.float64))
    # The products of two coordinates, the coordinates, and 1: what the normal equations sum up.
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    terms = [known[..., i] * known[..., j] for i, j in pairs]
    terms += [*np.moveaxis(known, -1, 0), np.ones((rows, cols))]
    sums = np.zeros((len(terms), rows, cols))
    for down, right in np.ndindex(5, 5):
        here = shifted(rows, 2 - down), shifted(cols, 2 - right)
        there = shifted(rows, down - 2), shifted(cols, right - 2)
        steps = max(abs(down - 2), abs(right - 2))
        near = np.abs(depth[there] - depth[here]) <= steps * limit[here]
        for total, term in zip(sums, terms, strict=True):
            total[here] += term[there] * near
    good = sums[-1] >= 6
    normals = np.full((rows, cols, 3), np.nan)
    if good.any():
        # A trace of the unit matrix keeps points on a line from being singular.
        matrix = np.empty((int(good.sum()), 3, 3))
        for total, (i, j) in zip(sums, pairs, strict=False):
            matrix[:, i, j] = matrix[:, j, i] = total[good]
        right_side = sums[len(pairs) : -1][:, good].T[..., None]
        plane = np.linalg.solve(matrix + 1e-12 * np.eye(3), right_side)[..., 0]
        # The plane through the points does not pass through the camera, which lies at n . x = 0.
        normals[good] = -plane / np.linalg.norm(plane, axis=1, keepdims=True)
    return normals.astype(np.float32)


def surface_faces(depth: NDArray[np.float32], geometry: RigGeometry) -> NDArray[np.int64]:
    """Triangles (n, 3) of pixel numbers, two for each square of four pixels on one surface.

    They are counter-clockwise as the camera sees them.
    """
    number = np.arange(depth.size).reshape(depth.shape)
    limit = _steepest_step(depth, geometry)
    corners = (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:])
    faces = []
    for one, two, three in ((0, 1, 2), (0, 2, 3)):
        chosen = [corners[k] for k in (one, two, three)]
        depths = np.stack([depth[corner] for corner in chosen])
        # Comparisons with NaN are False.
        flat = np.ptp(depths, axis=0) <= 1.5 * limit[chosen[0]]
        faces.append(np.stack([number[corner][flat] for corner in chosen], axis=1))
    return np.concatenate(faces)


def write_cloud(
    part: Path, points: NDArray[np.float32], light: NDArray[np.float32],
    more: dict[str, NDArray[Any]], faces: NDArray[np.int64] | None = None,
) -> None:  # fmt: skip
    """Write the finite ones of points (..., 3), in the format of a file's ending.

    `light` (...) becomes grey values, `more` names further columns (...), and `faces` (n, 3) are
    numbers of points. Binary PLY (Turk 1994) holds all of it, binary PCD (of the Point Cloud
    Library) all but faces, OBJ points, colours and faces, and XYZ bare coordinates.
    """
    known = np.isfinite(points).all(axis=-1)
    # Light at this quantile is shown white, and bent for screens, which undo it.
    bright = float(np.nanquantile(light, 0.99)) if np.isfinite(light).any() else 0.0
    level = np.clip(np.nan_to_num(light[known]) / max(bright, 1e-12), 0, 1) ** (1 / 2.2)
    grey = np.rint(255 * level).astype(np.uint8)
    colours: dict[str, NDArray[Any]] = dict.fromkeys(("red", "green", "blue"), grey)
    further = {name: np.nan_to_num(values[known]) for name, values in more.items()}
    corners = None if faces is None else (np.cumsum(known.ravel()) - 1)[faces]
    with part.open("wb") as stream:
        if part.suffix == ".xyz":
            np.savetxt(stream, points[known], "%.7g")
            return
        if part.suffix == ".obj":
            stream.write(f"# {OUR_MARK}\n".encode())
            shown = np.column_stack([points[known], *[grey / 255] * 3])
            np.savetxt(stream, shown, "v %.7g %.7g %.7g %.3g %.3g %.3g")
            if corners is not None:
                np.savetxt(stream, corners + 1, "f %d %d %d")
            return
        if part.suffix == ".pcd":
            # PCL keeps a colour in the bits of a float, and has names of its own for normals.
            colours = {"rgb": (grey.astype(np.uint32) * 0x10101).view(np.float32)}
            further = {re.sub("^n([xyz])$", r"normal_\1", name): v for name, v in further.items()}
        columns = {**dict(zip("xyz", points[known].T, strict=True)), **colours, **further}
        small = {name: each.dtype == np.uint8 for name, each in columns.items()}
        table = np.empty(len(grey), [(name, "u1" if small[name] else "<f4") for name in columns])
        for name, values in columns.items():
            table[name] = values
        if part.suffix == ".pcd":
            lines = [f"# {OUR_MARK}", "VERSION 0.7", f"FIELDS {' '.join(columns)}"]
            lines += [f"SIZE {' '.join('1' if small[name] else '4' for name in columns)}"]
            lines += [f"TYPE {' '.join('U' if small[name] else 'F' for name in columns)}"]
            lines += [f"COUNT {' '.join('1' for _ in columns)}", f"WIDTH {len(table)}", "HEIGHT 1"]
            lines += ["VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(table)}", "DATA binary"]
        else:
            lines = ["ply", "format binary_little_endian 1.0", f"comment {OUR_MARK}"]
            lines += [f"element vertex {len(table)}"] + [
                f"property {'uchar' if small[name] else 'float'} {name}" for name in columns
            ]
            if corners is not None:
                of_faces = "property list uchar int vertex_indices"
                lines += [f"element face {len(corners)}", of_faces]
            lines += ["end_header"]
        stream.write(("\n".join(lines) + "\n").encode("ascii"))
        stream.write(table.tobytes())
        if part.suffix == ".ply" and corners is not None:
            triangles = np.empty(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
            triangles["count"], triangles["corners"] = 3, corners
            stream.write(triangles.tobytes())


# A shape as pictures: maps of depth and normals, and why pixels have none.

_NORMALS = "Normals: right, up, near as red, green, blue"


def depth_map(depth: NDArray[np.floating], units: str | None) -> "pictures.maps.Map":
    """Depth (rows, cols) as a map over the camera, near surfaces bright."""
    known = depth[np.isfinite(depth)]
    # A few wrong points must not make all others alike.
    low, high = np.quantile(known, [0.02, 0.98]).tolist() if known.size else (0.0, 1.0)
    # A plane that faces the camera has one depth only.
    high = max(high, low + 1e-6 * max(1.0, abs(low)))
    title, values = "Depth along the camera's axis", depth.astype(np.float64)
    return pictures.maps.Map(title, units or "unit of the geometry", values, low, high, "viridis_r")


def normal_colours(normals: NDArray[np.floating]) -> Array:
    """Normals (rows, cols, 3) in the camera's frame as colours in [0, 1].

    Right, up and towards the camera are red, green and blue; pixels without a normal are grey.
    """
    colours = 0.5 + 0.5 * normals.astype(np.float64) * np.array([1, -1, -1])
    known = np.isfinite(colours).all(axis=-1, keepdims=True)
    return np.asarray(np.where(known, colours, np.array(pictures.maps.UNKNOWN)))


def normals_picture(normals: NDArray[np.float32]) -> "pictures.style.Picture":
    """Normals (rows, cols, 3) in the camera's frame."""
    with pictures.style.figure(4.4, 3.6) as drawing:
        pictures.style.panel(drawing.subplots(), normal_colours(normals), _NORMALS)
    return drawing


class ShapeTest(IntEnum):
    """What became of a camera pixel, the values of `Shape.test`."""

    KEPT = 0
    # There is no light beside its epipolar line, or its code is not readable.
    NO_LIGHT = 1
    # The spot lies more than a projector pixel from the line.
    OFF_LINE = 2
    # The point would lie behind the camera or the projector.
    BEHIND = 3
    # It is less probably right than asked for.
    IMPROBABLE = 4


@dataclass(frozen=True, eq=False, repr=False)
class Shape(ShortRepr):
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
    probability : (rows, cols) float32
        How probably the point lies within the tolerated error, 1 % of the distance by default, of a
        surface; 0 where no light lies on the line. It comes from the distance from the line, the
        width of the spot, the row's stated error, and how the depth continues in the neighbours.
    test : (rows, cols) uint8
        Which test a pixel failed first, see `ShapeTest`; 0 where the point was kept.
    place : (rows, cols, 2) float32
        Row and column of the projector pixel that lights each point, before its projection onto the
        epipolar line.
    from_line : (rows, cols) float32
        Its distance from the line, in projector pixels.
    geometry : RigGeometry
        Of images of these sizes.
    """

    depth: NDArray[np.float32]
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    albedo: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    probability: NDArray[np.float32]
    test: NDArray[np.uint8]
    place: NDArray[np.float32]
    from_line: NDArray[np.float32]
    geometry: RigGeometry

    @property
    def kept(self) -> NDArray[np.bool_]:
        """The pixels that have a depth, (rows, cols)."""
        return self.test == ShapeTest.KEPT

    @property
    def camera_normals(self) -> NDArray[np.float32]:
        """The normals in the camera's frame: to the right, down, forwards; (rows, cols, 3)."""
        turn = decomposed(self.geometry.camera_matrix)[1]
        return np.asarray(self.normals @ turn.T, np.float32)

    @property
    def depth_map(self) -> "pictures.maps.Map":
        """The depth as a picture."""
        return depth_map(self.depth, self.geometry.units)

    @property
    def probability_map(self) -> "pictures.maps.Map":
        """The probability as a picture."""
        values = self.probability.astype(float)
        return pictures.maps.Map("How probably the depth is right", "", values, 0, 1)

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
        """Write points or the depth, in the format of the file's ending.

        Points: .ply with normals, grey values, uncertainty and probability, and with triangles
        between neighbouring pixels on one surface if `mesh` is set; .pcd without triangles; .obj
        with grey values and triangles; .xyz with coordinates alone. Depth: .tif, .tiff and .npy as
        float32, NaN where there is none, or .png of 16 bits in millimetres, 0 where there is none.

        An OutputError refuses a file that exists, unless `overwrite` is set, or that cannot be
        written, an InputError millimetres of a geometry in unknown units.
        """
        kind = DEPTH if as_path(path).suffix.lower() in DEPTH.suffixes else CLOUD
        with atomic_file(path, kind, overwrite=overwrite) as part:
            self.write(part, mesh=mesh)

    def write(self, part: Path, *, mesh: bool = False) -> None:
        """Write points or depth as `save` does, but in place."""
        if part.suffix == ".png":
            level = np.rint(np.nan_to_num(self.depth * millimetres(self.geometry)))
            if far := int((level > 65535).sum()):
                warn(f"{far} depths beyond 65.5 m are 0 in 16 bits of millimetres")
            fill_image(part, np.where(level > 65535, 0, level).astype(np.uint16))
        elif part.suffix in DEPTH.suffixes:
            fill_image(part, self.depth, missing=True)
        else:
            columns = dict(zip(("nx", "ny", "nz"), np.moveaxis(self.normals, -1, 0), strict=True))
            columns |= {"uncertainty": self.uncertainty, "probability": self.probability}
            faces = surface_faces(self.depth, self.geometry) if mesh else None
            write_cloud(part, self.points, self.albedo, columns, faces)

    def show(self) -> "pictures.style.Picture":
        """A Matplotlib figure: maps of depth, normals, probability and failed tests."""
        style = pictures.style
        with style.figure(14.5, 3.4) as drawing:
            depths, directions, certain, tests = drawing.subplots(1, 4)
            pictures.transport.draw_into(drawing, depths, self.depth_map)
            style.panel(directions, normal_colours(self.camera_normals), _NORMALS)
            pictures.transport.draw_into(drawing, certain, self.probability_map)
            names = [test.name.lower().replace("_", " ") for test in ShapeTest]
            style.kinds_panel(tests, self.test, names, "Which test a pixel failed")
        return drawing
