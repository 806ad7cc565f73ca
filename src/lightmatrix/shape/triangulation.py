"""`triangulate`: depth, points and normals from what each camera pixel sees of the projector."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError, warn
from lightmatrix.files.kinds import CLOUD, DEPTH, PICTURE
from lightmatrix.files.writing import atomic_files, check_output
from lightmatrix.geometry.rig_geometry import Array, RigGeometry, load_rig
from lightmatrix.paths import as_path
from lightmatrix.shape.shape import Shape, ShapeTest, millimetres, surface_normals
from lightmatrix.shape.spots import Seen, check_thresholds, seen_by, surface_probability
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open_matches

# What makes light come from beside its epipolar line.
_CAUSES = (
    "is this the geometry of this rig, and of images that are neither binned nor cropped? Did the "
    "camera move, or its focus? Are the photographs in order, and neither mirrored nor turned?"
)


def triangulate(
    transport: LightTransport | Correspondence | str | Path,
    geometry: RigGeometry | str | Path,
    *,
    tolerance: float = 0.01,
    least_probability: float = 0.5,
    output: str | Path | None = None,
    depth: str | Path | None = None,
    picture: str | Path | None = None,
    mesh: bool = False,
    overwrite: bool = False,
) -> Shape:
    """Triangulate the surface that the camera sees.

    Direct light can only come from a camera pixel's epipolar line on the projector. Of the spots of
    its row of T beside that line the one is taken that most probably is a surface, at the centroid
    of its light; its foot on the line gives the point. The probability is that of a regression on
    known scenes, see `Shape.probability`.

    Parameters
    ----------
    transport : LightTransport, Correspondence, str or Path
        T, or a correspondence; or where `open` or `read_correspondence` find it.
    geometry : RigGeometry, str or Path
        Where camera and projector stand, or its file. If its images are larger by whole factors, it
        is scaled to those of T, as after `Capture.bin`.
    tolerance : float
        The error of a depth that counts as right, as a share of the distance.
    least_probability : float
        How probably a point is right to be kept, in [0, 1]; 0.99 keeps fewer points, of which
        hardly any is wrong.
    output : str or Path, optional
        The point cloud to write: .ply or .obj, see `Shape.save`.
    depth : str or Path, optional
        The depth map to write: .tif, .tiff or .npy, or .png of 16 bits in millimetres.
    picture : str or Path, optional
        The picture to write: .png, maps of depth and normals.
    mesh : bool
        Whether the cloud, a .ply or .obj, holds triangles too.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    Shape
        Depth, points, normals, albedo and uncertainty of each camera pixel.

    Warns
    -----
    LightMatrixWarning
        If much of the light comes from beside the epipolar lines, or few points are probable.

    Raises
    ------
    InputError
        If the geometry has other image sizes or hardly any light comes from its epipolar lines, a
        file is damaged, a threshold is out of range, or no point is found for a file.
    OutputError
        If a file exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("l_objects")
    >>> shape = lm.triangulate(known.transport(), known.geometry, least_probability=0.99)
    >>> shape.depth.shape, bool(shape.kept.mean() > 0.9)
    ((64, 64), True)
    """
    check_thresholds(tolerance, least_probability)
    wanted = ((output, CLOUD), (depth, DEPTH), (picture, PICTURE))
    outputs = {path: kind for path, kind in wanted if path is not None}
    for path, kind in outputs.items():
        check_output(path, kind, overwrite=overwrite)
    if mesh and output is not None and as_path(output).suffix.lower() in (".pcd", ".xyz"):
        raise InputError(f"{output}: holds no triangles", hint="end it in .ply or .obj for a mesh")
    source = open_matches(transport)
    rig = geometry_of(source, geometry)
    if depth is not None and as_path(depth).suffix.lower() == ".png":
        millimetres(rig)
    seen = seen_by(source, rig)
    grid, probability = seen.grid, surface_probability(seen, tolerance)
    _check_fit(seen, probability, tolerance)
    chosen = np.arange(len(probability)), probability.argmax(axis=1)
    found = probability[chosen]
    place, away, light = seen.place[chosen], seen.away[chosen], seen.light[chosen]
    test = np.full(len(found), ShapeTest.KEPT, np.uint8)
    test[found < least_probability] = ShapeTest.IMPROBABLE
    test[~np.isfinite(seen.depth[chosen])] = ShapeTest.BEHIND
    test[~seen.on_line[chosen]] = ShapeTest.OFF_LINE
    test[~np.isfinite(place).all(axis=1) | ~(light > 0)] = ShapeTest.NO_LIGHT
    kept = test == ShapeTest.KEPT
    # The root mean square of the distances from the line within 5 x 5 pixels. No depth is called
    # exact: no estimate of a rendered scene was closer than 0.01 pixels.
    both = np.stack([np.where(kept, away**2, 0), kept * 1.0]).reshape(2, *grid)
    sums = scipy.ndimage.uniform_filter(both, (1, 5, 5))
    spread = np.sqrt(np.maximum(sums[0] / np.maximum(sums[1], 0.02), 0.01**2)).ravel()
    uncertainty = seen.slope[chosen] * spread

    def mapped(values: Array) -> NDArray[np.float32]:
        shown = np.where(kept if values.ndim == 1 else kept[:, None], values, np.nan)
        return shown.astype(np.float32).reshape(*grid, *values.shape[1:])

    depths, points = mapped(seen.depth[chosen]), mapped(seen.points[chosen])
    shape = Shape(
        depths, points, surface_normals(points, depths, rig),
        light.astype(np.float32).reshape(grid), mapped(uncertainty),
        found.astype(np.float32).reshape(grid), test.reshape(grid),
        place.astype(np.float32).reshape(*grid, 2), np.abs(away).astype(np.float32).reshape(grid),
        rig,
    )  # fmt: skip
    if outputs and not shape.kept.any():
        raise InputError(
            f"no point is found; pixels by the test that they fail: {shape.summary()['pixels']}",
            hint=f"NO_LIGHT: is the scene lit? Others: {_CAUSES}",
        )
    with atomic_files(outputs, overwrite=overwrite) as parts:
        for kind, part in zip(outputs.values(), parts, strict=True):
            if kind is PICTURE:
                shape.show().draw_file(part)
            else:
                shape.write(part, mesh=mesh)
    return shape


def _check_fit(seen: Seen, probability: Array, tolerance: float) -> None:
    """Refuse or warn of a geometry that does not fit where camera pixels see their light."""
    strongest = np.arange(len(seen.light)), seen.light.argmax(axis=1)
    away = np.abs(seen.away[strongest])
    lit = np.isfinite(away) & (seen.light[strongest] > 0)
    # A few pixels may all see a reflection.
    if lit.sum() < 100:
        return
    near, median = float(np.mean(away[lit] <= 1)), float(np.median(away[lit]))
    # A surface behind the camera has no depth.
    change = np.nan_to_num(away * seen.slope[strongest] / seen.depth[strongest], nan=1)
    changed = float(np.median(change[lit]))
    probable = float(np.mean(probability[lit].max(axis=1) >= 0.5))
    # What moves light off the line moves it as far along the line. Of 11 scenes, from T and from
    # codes, blurred and noisy, and of a real board, 71 % (polished balls) to 100 % lie so near, 80
    # to 100 % give a probable point; where the median exceeded a tenth of a pixel, it changed a
    # depth by 0.4 % at most. Mirrored, turned or shuffled, 0 to 11 % lie so near.
    fits = median <= 0.1 or changed <= tolerance / 2
    # A strict tolerance makes points improbable, whatever the geometry.
    if fits and near >= 0.5 and (probable >= 0.5 or tolerance < 0.01):
        return
    message = (
        f"the geometry does not fit: camera pixels see their light {median:.2g} projector pixels "
        "off their epipolar lines in the median; as much along the lines changes a depth by "
        f"{100 * changed:.2g} %; {100 * near:.0f} % see it within a pixel, and "
        f"{100 * probable:.0f} % give a point that is probably right to {100 * tolerance:g} %"
    )
    if near < 0.12:
        raise InputError(message, hint=_CAUSES)
    warn(f"{message}\n  {_CAUSES}")


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
    if isinstance(source, Correspondence):
        camera_shape, projector_shape = source.confidence.shape, source.projector_shape
    else:
        camera_shape, projector_shape = source.camera_shape[:2], source.projector_shape
    # The stated blocks of pixels that are averaged.
    stated = {"camera": (1, 1), "projector": (1, 1)}
    if isinstance(source, LightTransport):
        capture = source.provenance.get("capture_description") or {}
        stated = {name: tuple(capture.get(f"bin_{name}", (1, 1))) for name in stated}
    elif isinstance(source, Capture):
        stated = {"camera": source.bin_camera, "projector": source.bin_projector}
    if isinstance(geometry, RigGeometry):
        rig = geometry
    else:
        # Files that state no image sizes belong to these images, before they were binned.
        whole = [
            shape and (shape[0] * stated[name][0], shape[1] * stated[name][1])
            for name, shape in (("camera", camera_shape), ("projector", projector_shape))
        ]
        rig = load_rig(geometry, usual=(whole[0], whole[1]))
    shapes = {
        "camera": (camera_shape[0], camera_shape[1]),
        "projector": projector_shape or rig.projector_shape,
    }
    if isinstance(source, Correspondence) and projector_shape is None:
        row, col = np.fmax.reduce(source.place.reshape(-1, 2))
        if row > rig.projector_shape[0] or col > rig.projector_shape[1]:
            raise InputError(
                f"places reach row {row:g} and column {col:g} of a projector of "
                f"{rig.projector_shape[0]} x {rig.projector_shape[1]} pixels",
                hint="give pixels of this projector, x as the column and y as the row; files of "
                "`map` hold shares of an image: give T itself in their place",
            )
    blocks = {}
    for device, shape in shapes.items():
        whole = getattr(rig, f"{device}_shape")
        block = tuple(max(1, round(w / s)) for w, s in zip(whole, shape, strict=True))
        # Blocks at the border may be smaller.
        fits = tuple(-(-w // b) for w, b in zip(whole, block, strict=True)) == tuple(shape)
        # Oblong blocks are no accident if they are stated.
        if not fits or (block[0] != block[1] and block != stated[device]):
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
