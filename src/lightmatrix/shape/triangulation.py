"""`triangulate`: depth, points and normals from what each camera pixel sees of the projector."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CLOUD, DEPTH, PICTURE
from lightmatrix.files.writing import atomic_file, check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.resources.threads import work_ahead
from lightmatrix.shape.shape import Shape, ShapeTest, local_mean, surface_normals
from lightmatrix.transport.correspondence import Correspondence, pixel_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open_matches
from lightmatrix.uses.separation import Spots, blocks_of, camera_pixels, entries_of, spot_deviation

# The middle of a spot lies within this distance of the epipolar line, in projector pixels, and the
# 3 x 3 pixels around it reach as far. Chosen by hand: one pixel and a half leave room for a spot
# that lies between pixels.
_REACH = 1.5

# The brightest spot of each row of T beside its epipolar line: where direct light comes from.


def find_line_spots(
    matrix: csr_array,
    background: NDArray[np.float64],
    lines: NDArray[np.float64],
    pixels: NDArray[np.float64],
    shape: tuple[int, int],
    half_width: float,
) -> Spots:
    """Find the spot of each row of T, (P, N), beside its line.

    Of all 3 x 3 pixels whose middle lies within 1.5 pixels of the line, the brightest are the spot.
    Its place is the centroid of the light in a window around it, whose borders cut pixels in parts,
    so that it moves smoothly.

    `lines` (P, 3) are a, b, c with a^2 + b^2 = 1 and a col + b row + c = 0, `pixels` (N, 2) the
    column and row of each projector pixel without distortion.
    """
    if not matrix.has_sorted_indices:
        matrix = matrix.copy()
        matrix.sort_indices()

    def find(rows: slice) -> tuple[NDArray[np.float64], ...]:
        return _of_block(csr_array(matrix[rows]), lines[rows], pixels, shape, half_width)

    # Two at a time, since each block takes about 400 MiB.
    parts = work_ahead(find, blocks_of(matrix), threads=2)
    place, light, total = map(np.concatenate, zip(*parts, strict=True))
    return Spots(place, light, total + np.maximum(background, 0))


def uncut_places(
    place: NDArray[np.float64], lines: NDArray[np.float64], shape: tuple[int, int], margin: float
) -> NDArray[np.float64]:
    """Places of spots, corrected where the projector's border cuts a spot off.

    Within `margin` of the outermost pixels, the coordinate across the border is where the line
    crosses the other coordinate, which nothing cuts. It moves outwards only, and by a pixel at
    most; distortion hardly matters over so short a way.
    """
    result = place.copy()
    for axis in (0, 1):
        along, across = lines[:, 1 - axis], lines[:, axis]
        low, high = place[:, axis] < margin, place[:, axis] > shape[axis] - 1 - margin
        # Columns of `lines` belong to (col, row), those of `place` to (row, col).
        with np.errstate(invalid="ignore", divide="ignore"):
            crossing = -(across * place[:, 1 - axis] + lines[:, 2]) / along
        # Chosen by hand: errors of the coordinate grow threefold at most.
        steep = np.abs(along) >= 0.3
        outwards = np.where(low, place[:, axis] - crossing, crossing - place[:, axis])
        cut = (low | high) & steep & (outwards > 0) & (outwards <= 1)
        result[cut, axis] = crossing[cut]
    return result


def _of_block(
    matrix: csr_array,
    lines: NDArray[np.float64],
    pixels: NDArray[np.float64],
    shape: tuple[int, int],
    half_width: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Places, light and total light of the spots of some rows."""
    count = int(matrix.shape[0])
    owner, row, col = entries_of(matrix, shape[1])
    # Some estimates allow negative light, which does not count.
    light = np.maximum(matrix.data, 0).astype(np.float64)
    total = np.bincount(owner, light, count).astype(np.float64)
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    ideal_col, ideal_row = np.ascontiguousarray(pixels.T).take(matrix.indices, axis=1)
    across, down, shift = np.ascontiguousarray(lines.T)
    distance = np.abs(across[owner] * ideal_col + down[owner] * ideal_row + shift[owner])
    near = np.flatnonzero(distance <= 2 * _REACH + half_width)
    owner, light, distance = owner[near], light[near], distance[near]
    row, col = row[near], col[near]
    middle_row, middle_col = _brightest(owner, row, col, light, distance <= _REACH, shape, count)
    # The window moves by up to a pixel.
    reach = half_width + _REACH
    inside = np.abs(row - middle_row[owner]) <= reach
    inside &= np.abs(col - middle_col[owner]) <= reach
    owner, row, col, light = owner[inside], row[inside], col[inside], light[inside]
    held = np.zeros(count)
    # The window is centred on the light within it; it then moves by less than 0.01 pixels.
    for _ in range(4):
        share = np.clip(half_width + 0.5 - np.abs(row - middle_row[owner]), 0, 1)
        share *= np.clip(half_width + 0.5 - np.abs(col - middle_col[owner]), 0, 1)
        share *= light
        held = np.bincount(owner, share, count).astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            middle_row = np.bincount(owner, share * row, count) / held
            middle_col = np.bincount(owner, share * col, count) / held
    return np.stack([middle_row, middle_col], axis=1), held, total


def _brightest(
    owner: NDArray[np.int64],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    light: NDArray[np.float64],
    possible: NDArray[np.bool_],
    shape: tuple[int, int],
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Row and column of the brightest 3 x 3 pixels of each row of T, around `possible` entries."""
    # Entries are sorted by row and pixel. The numbers of the pixels of all rows have a border, so
    # that no neighbour lies across an edge.
    width = shape[1] + 2
    place = (row.astype(np.int64) + 1) * width + col.astype(np.int64) + 1
    number = owner * ((shape[0] + 2) * width) + place
    padded = np.append(number, [np.iinfo(np.int64).max] * 3)
    padded_light = np.append(light, [0.0] * 3)
    sums = np.zeros(len(number))
    for down in (-1, 0, 1):
        first = number + down * width - 1
        found = np.searchsorted(number, first)
        for step in range(3):
            sums += np.where(padded[found + step] <= first + 2, padded_light[found + step], 0)
    sums[~possible | (light <= 0)] = 0
    best = np.zeros(count)
    if len(owner):
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        best[owner[starts]] = np.maximum.reduceat(sums, starts)
    strongest = np.flatnonzero((sums == best[owner]) & (sums > 0))[::-1]
    middle_row, middle_col = np.full((2, count), np.nan)
    # In reverse order, so that the first of several equal ones stays.
    middle_row[owner[strongest]] = row[strongest]
    middle_col[owner[strongest]] = col[strongest]
    return middle_row, middle_col


@dataclass(frozen=True, eq=False)
class _Places:
    """What P camera pixels see: place (P, 2), share, light and stated error (P,)."""

    place: NDArray[np.float64]
    share: NDArray[np.float64]
    light: NDArray[np.float64]
    error: NDArray[np.float64]


def triangulate(
    transport: LightTransport | Correspondence | str | Path,
    geometry: RigGeometry | str | Path,
    *,
    strict: bool = False,
    output: str | Path | None = None,
    depth: str | Path | None = None,
    picture: str | Path | None = None,
    mesh: bool = False,
    overwrite: bool = False,
) -> Shape:
    """Triangulate the surface that the camera sees.

    Direct light can only come from a camera pixel's epipolar line on the projector. The brightest
    spot of its row of T beside that line is taken, at the centroid of its light; its foot on the
    line gives the point. Light that took another way lies off the line, or is fainter.

    Parameters
    ----------
    transport : LightTransport, Correspondence, str or Path
        T, or the correspondence of `decode`; or where `open` or `read_correspondence` find it.
    geometry : RigGeometry, str or Path
        Where camera and projector stand, or its file. If its images are larger by whole factors, it
        is scaled to those of T, as after `Capture.bin`.
    strict : bool
        Whether to keep fewer points that are right more often: within 0.5 instead of 1 projector
        pixel of the line, and with a stated error below 0.3 instead of 1 where the estimate states
        one.
    output : str or Path, optional
        The point cloud to write: .ply, with normals, grey values and uncertainties.
    depth : str or Path, optional
        The depth map to write: .tif, .tiff or .npy, NaN where there is no depth.
    picture : str or Path, optional
        The picture to write: .png, maps of depth and normals.
    mesh : bool
        Whether the cloud holds triangles too.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    Shape
        Depth, points, normals, albedo and uncertainty of each camera pixel.

    Raises
    ------
    InputError
        If the geometry has other image sizes, a file is damaged, or no point is found for one to be
        written.
    OutputError
        If a file exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("corner")
    >>> shape = lm.triangulate(known.transport(), known.geometry, strict=True)
    >>> shape.depth.shape, bool(shape.kept.mean() > 0.9)
    ((64, 64), True)
    """
    outputs = ((output, CLOUD), (depth, DEPTH), (picture, PICTURE))
    for path, kind in outputs:
        if path is not None:
            check_output(path, kind, overwrite=overwrite)
    source = open_matches(transport)
    rig = geometry_of(source, geometry)
    grid = rig.camera_shape
    camera = camera_pixels(grid)[:, ::-1]
    # The epipolar lines (P, 3) on the projector without distortion: a col + b row + c = 0 with
    # a^2 + b^2 = 1.
    lines = np.column_stack([rig.undistort_camera(camera), np.ones(len(camera))])
    lines = lines @ rig.fundamental_matrix().T
    lines = lines / np.hypot(lines[:, 0], lines[:, 1])[:, None]
    if isinstance(source, Correspondence):
        found = _decoded_places(source, rig, lines)
    else:
        found = _spots_of(source, rig, lines)
    shape = _shape(found, rig, camera, lines, strict)
    if not shape.kept.any() and any(path is not None for path, _ in outputs):
        raise InputError(
            f"no point is found; pixels by the test that they fail: {shape.summary()['pixels']}",
            hint="OFF_LINE and BEHIND: is this the geometry of this rig, and of images that are "
            "neither binned nor cropped? NO_LIGHT and WEAK: is the scene lit?",
        )
    # The files take their places together, since one alone would stand in the way of the next run.
    with ExitStack() as files:
        for path, kind in outputs:
            if path is None:
                continue
            part = files.enter_context(atomic_file(path, kind, overwrite=overwrite))
            if kind is CLOUD:
                shape.write_points(part, mesh=mesh)
            elif kind is DEPTH:
                shape.write_depth(part)
            else:
                shape.show().draw_file(part)
    return shape


def geometry_of(
    source: LightTransport | Correspondence | Capture, geometry: RigGeometry | str | Path
) -> RigGeometry:
    """Scale the geometry of a rig to the images of T, of a correspondence or of a capture.

    Parameters
    ----------
    source : LightTransport, Correspondence or Capture
        What the geometry is needed for.
    geometry : RigGeometry, str or Path
        Where camera and projector stand, or its file.

    Returns
    -------
    RigGeometry
        The geometry of images of these sizes. It is scaled by whole factors, as `Capture.bin` does.

    Raises
    ------
    InputError
        If it belongs to other images, or the file holds no geometry.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> capture = lm.simulate(known, lm.BernoulliPatterns((64, 64), 8)).bin(camera=2)
    >>> lm.geometry_of(capture, known.geometry).camera_shape
    (32, 32)
    """
    rig = geometry if isinstance(geometry, RigGeometry) else RigGeometry.load(geometry)
    if isinstance(source, Correspondence):
        camera_shape, projector_shape = source.confidence.shape, source.projector_shape
    else:
        camera_shape, projector_shape = source.camera_shape[:2], source.projector_shape
    shapes = {
        "camera": (camera_shape[0], camera_shape[1]),
        "projector": projector_shape or rig.projector_shape,
    }
    blocks = {}
    for device, shape in shapes.items():
        whole = getattr(rig, f"{device}_shape")
        block = tuple(max(1, round(w / s)) for w, s in zip(whole, shape, strict=True))
        # Oblong blocks are no accident if they are stated.
        stated = (1, 1)
        if isinstance(source, LightTransport):
            capture = source.provenance.get("capture_description") or {}
            stated = tuple(capture.get(f"bin_{device}", (1, 1)))
        elif isinstance(source, Capture):
            stated = getattr(source, f"bin_{device}")
        # Blocks at the border may be smaller.
        fits = tuple(-(-w // b) for w, b in zip(whole, block, strict=True)) == tuple(shape)
        if not fits or (block[0] != block[1] and block != stated):
            raise InputError(
                f"the geometry is of {device} images of {whole[0]} x {whole[1]} pixels, but these "
                f"are of {shape[0]} x {shape[1]}",
                hint="give the geometry of these images: calibrate at their size, scale it by the "
                "blocks of their pixels (RigGeometry.scaled), or cut it to their crop "
                "(RigGeometry.cropped)",
            )
        blocks[device] = block
    if set(blocks.values()) == {(1, 1)}:
        return rig
    scaled = rig.scaled(camera=blocks["camera"], projector=blocks["projector"])
    return replace(scaled, camera_shape=shapes["camera"], projector_shape=shapes["projector"])


def _spots_of(
    transport: LightTransport, geometry: RigGeometry, lines: NDArray[np.float64]
) -> _Places:
    """The strongest spot of each row beside its line; a row's stated error, or 0 without one."""
    rows, background = pixel_rows(transport)
    shape = transport.projector_shape
    pixels = geometry.undistort_projector(camera_pixels(shape)[:, ::-1])
    # The window reaches 1.5 projector pixels to each side of sharp spots, and 2.5 under a blur of 1
    # pixel. Chosen by hand.
    half_width = max(1.5, 2.4 * spot_deviation(transport, rows))
    spots = find_line_spots(rows, background, lines, pixels, shape, half_width)
    # A spot that the projector's border cuts off seems to lie farther inside than it does.
    place = uncut_places(spots.place, _counted(lines, geometry), shape, half_width - 1)
    channels = int(np.prod(transport.camera_shape[2:]))
    error = np.zeros(len(lines))
    if "estimated_error" in transport.diagnostics:
        stated = np.asarray(transport.diagnostics["estimated_error"], float)
        error = np.nan_to_num(stated.reshape(-1, channels).mean(axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(spots.total > 0, spots.light / spots.total, 0)
    return _Places(place, share, spots.light, error)


def _counted(lines: NDArray[np.float64], geometry: RigGeometry) -> NDArray[np.float64]:
    """Lines (P, 3) for columns as the projector counts them, which mirrors may reverse."""
    if not geometry.projector_mirrored:
        return lines
    a, b, c = lines.T
    return np.column_stack([-a, b, c + a * (geometry.projector_shape[1] - 1)])


def _decoded_places(
    matches: Correspondence, geometry: RigGeometry, lines: NDArray[np.float64]
) -> _Places:
    """The places of a correspondence; with columns or rows only, where they cross the line."""
    lines = _counted(lines, geometry)
    place = matches.place.reshape(-1, 2).astype(np.float64)
    known = np.isfinite(place)
    if not known.all(axis=1).any():
        a, b, c = lines.T
        with np.errstate(invalid="ignore", divide="ignore"):
            row = -(a * place[:, 1] + c) / b
            col = -(b * place[:, 0] + c) / a
        place = np.column_stack(
            [np.where(known[:, 0], place[:, 0], row), np.where(known[:, 1], place[:, 1], col)]
        )
    else:
        # Places within half a pixel of the border may be cut off, as for a sharp spot of T.
        place = uncut_places(place, lines, geometry.projector_shape, 0.5)
    confidence = matches.confidence.ravel().astype(np.float64)
    light = confidence if matches.light is None else matches.light.ravel().astype(np.float64)
    return _Places(place, confidence, light, np.zeros(len(place)))


def _shape(
    found: _Places,
    geometry: RigGeometry,
    camera: NDArray[np.float64],
    lines: NDArray[np.float64],
    strict: bool,
) -> Shape:
    """The shape of camera pixels (P, 2) as (col, row) from the places that they see."""
    grid = geometry.camera_shape
    seen = found.place[:, ::-1]
    ideal = geometry.undistort_projector(seen)
    away = (lines[:, :2] * ideal).sum(axis=1) + lines[:, 2]
    points = geometry.triangulate(camera, seen)
    depth = geometry.depth(points)
    # How far a projector pixel along the line moves the depth.
    along = np.column_stack([-lines[:, 1], lines[:, 0]])
    along *= (-1, 1) if geometry.projector_mirrored else (1, 1)
    moved = geometry.depth(geometry.triangulate(camera, seen + 0.1 * along))
    slope = np.abs(moved - depth) / 0.1
    axis = geometry.projector_matrix[2]
    before = (depth > 0) & (points @ axis[:3] + axis[3] > 0)
    # A row that is all wrong has an error of 1 or more, as many rows of shadows have. On the scene
    # vase (64 x 64, 32 patterns) 1.6 % of the depths are wrong without the test of errors and 0.3 %
    # with it, for 0.03 % of the right ones. A spot holds a tenth of the row's light at least, and a
    # code explains as much of the variance of its samples.
    from_line, most_error = (0.5, 0.3) if strict else (1.0, 1.0)
    test = np.full(len(depth), ShapeTest.KEPT, np.uint8)
    test[~before] = ShapeTest.BEHIND
    test[~(found.error < most_error)] = ShapeTest.UNCERTAIN
    test[~(np.abs(away) <= from_line)] = ShapeTest.OFF_LINE
    test[~(found.share > 0.1)] = ShapeTest.WEAK
    test[~np.isfinite(found.place).all(axis=1) | ~(found.light > 0)] = ShapeTest.NO_LIGHT
    kept = test == ShapeTest.KEPT
    spread = np.sqrt(local_mean(np.where(kept, away**2, np.nan).reshape(grid))).ravel()
    # No depth is called exact: no estimate of a rendered scene was closer than 0.01 pixels.
    uncertainty = slope * np.maximum(spread, 0.01)

    def mapped(values: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        shown = np.where(mask if values.ndim == 1 else mask[:, None], values, np.nan)
        return shown.astype(np.float32).reshape(*grid, *values.shape[1:])

    depth_map = mapped(depth, kept)
    return Shape(
        depth_map,
        mapped(points, kept),
        surface_normals(mapped(points, kept), depth_map, geometry),
        found.light.astype(np.float32).reshape(grid),
        mapped(uncertainty, kept),
        test.reshape(grid),
        found.place.astype(np.float32).reshape(*grid, 2),
        np.abs(away).astype(np.float32).reshape(grid),
        geometry,
    )
