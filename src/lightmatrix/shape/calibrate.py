"""The geometry of a rig, from captures of a board (`calibrate_rig`) or of any scene.

A board: the projector sees nothing, but each camera pixel knows the projector pixel that lights it.
Around a corner the board is flat and the lenses are straight enough, so that one homography leads
from the camera to the projector (Moreno & Taubin 2012). Fitted to many pixels, it takes the corner
along to a fraction of a pixel. The projector then counts as a second camera (Zhang 2000).

Any scene that is not flat (`self_calibrate`): the matches of camera and projector pixels give the
fundamental matrix F, with seven numbers. If the camera's K is known, six of them are the
projector's focal length, its rotation and the direction in which it stands; how far away it stands,
and so the size of the scene, cannot be known.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.estimate import estimate
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import geometry_kind
from lightmatrix.files.writing import check_output
from lightmatrix.geometry.matches import fit_fundamental, fit_homography, moved, sampson
from lightmatrix.geometry.rig_geometry import Array, RigGeometry, decomposed, normalised
from lightmatrix.patterns.codes import find_codes
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.ranges import check_list, check_number
from lightmatrix.reprs import short_repr
from lightmatrix.shape.decode import decode
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open_matches

Shape = tuple[int, int]
Progress = Callable[[int, int], None]
BoardKind = Literal["chessboard", "charuco", "circles", "asymmetric-circles"]
# A homography takes four corners; twice as many show whether they fit.
_FEWEST = 8


# The corners of a board in the camera's image, and the projector pixels that light them.


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """The inner corners (n, 2) of a board, in the order of its rows, as (col, row)."""

    # In the camera's image.
    camera: Array
    # The projector pixels that light them; NaN where too few pixels around a corner see them.
    projector: Array
    # The share of the lit corners around which the projector's image is mirrored.
    mirrored: float = 0.0

    @property
    def lit(self) -> NDArray[np.bool_]:
        """The corners whose projector pixel is known, (n,)."""
        return np.asarray(np.isfinite(self.projector).all(axis=1))


def find_corners(white: Array, board: Shape, kind: BoardKind = "chessboard") -> Array | None:
    """The inner corners (n, 2) of a board of (corners across, down) in a white image, or None.

    Corners of ChArUco boards that are not seen are NaN; all of other boards must be.
    """
    cv2 = load_opencv("finding a board", "shape")
    # This quantile becomes white, so that glare does not make the board dark.
    level = max(float(np.quantile(white, 0.98)), 1e-12)
    image = np.rint(255 * np.clip(white / level, 0, 1)).astype(np.uint8)
    try:
        find = _charuco_corners if kind == "charuco" else _all_of_grid
        places = find(cv2, image, board, kind)
    except cv2.error:
        # Images of a few pixels are too small for OpenCV's thresholds.
        return None
    if places is None or "circles" in kind:
        return places
    # The window in which a corner is refined reaches a seventh of a square: larger ones average the
    # bend of the lens, smaller ones the camera's noise.
    reach = int(np.clip(0.14 * _side_of(places, board), 2, 11))
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-3)
    seen = np.isfinite(places).all(axis=1)
    corners = places[seen].astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(image, corners, (reach, reach), (-1, -1), criteria)
    places[seen] = np.asarray(refined).reshape(-1, 2)
    return places


def _all_of_grid(cv2: Any, image: NDArray[np.uint8], board: Shape, kind: BoardKind) -> Array | None:
    """The corners of a chessboard or the centres of circles, all of them or None."""
    if kind == "chessboard":
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        good, found = cv2.findChessboardCorners(image, board, flags=flags)
        if not good:
            # Slower, and finds boards that are blurred or unevenly lit.
            flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
            good, found = cv2.findChessboardCornersSB(image, board, flags=flags)
    else:
        even = cv2.CALIB_CB_SYMMETRIC_GRID
        grid = even if kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
        good, found = cv2.findCirclesGrid(image, board, flags=grid)
        if not good:
            # Copes with steeper views.
            good, found = cv2.findCirclesGrid(image, board, flags=grid | cv2.CALIB_CB_CLUSTERING)
    return np.asarray(found, np.float64).reshape(-1, 2) if good else None


def _charuco_corners(
    cv2: Any, image: NDArray[np.uint8], board: Shape, _: BoardKind
) -> Array | None:
    """The corners of a ChArUco board that are seen, of whatever markers it has."""
    places = np.full((board[0] * board[1], 2), np.nan)
    # Older versions of OpenCV began boards of an even number of rows with a white square.
    for bits, legacy in itertools.product((4, 5, 6, 7), (False, True)):
        # Smaller dictionaries are the beginning of these, and markers of half and of nine tenths of
        # a square are found as well as of 0.7.
        name = getattr(cv2.aruco, f"DICT_{bits}X{bits}_1000")
        markers = cv2.aruco.getPredefinedDictionary(name)
        known = cv2.aruco.CharucoBoard((board[0] + 1, board[1] + 1), 1.0, 0.7, markers)
        known.setLegacyPattern(legacy)
        corners, numbers, *_ = cv2.aruco.CharucoDetector(known).detectBoard(image)
        if numbers is not None and len(numbers) >= _FEWEST:
            places[np.ravel(numbers)] = np.reshape(corners, (-1, 2))
            return places
    return None


def _side_of(corners: NDArray[np.floating], board: Shape) -> float:
    """Median side of the board's squares in the image, in pixels."""
    across, down = board
    grid = corners.reshape(down, across, 2)
    return float(np.nanmedian(np.linalg.norm(np.diff(grid, axis=1), axis=2)))


def light_corners(corners: Array, matches: Correspondence, board: Shape) -> BoardCorners:
    """The projector pixels of corners (n, 2), by a homography around each."""
    # On the five poses of a real board, windows from 12 to 30 pixels gave the same corners to 0.01
    # pixels.
    reach = int(np.clip(0.4 * _side_of(corners, board), 4, 30))
    known = np.asarray(np.isfinite(matches.place).all(axis=2))
    weight = np.where(known, matches.confidence, 0).astype(np.float64)
    if matches.uncertainty is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            weight = np.where(known, 1 / (matches.uncertainty**2).sum(axis=2), 0)
    projector = np.full_like(corners, np.nan)
    mirrored: list[bool] = []
    for number in np.flatnonzero(np.isfinite(corners).all(axis=1)):
        corner = corners[number]
        col, row = np.rint(corner).astype(int)
        rows = slice(max(row - reach, 0), row + reach + 1)
        cols = slice(max(col - reach, 0), col + reach + 1)
        use = known[rows, cols] & (weight[rows, cols] > 0)
        if use.sum() < max(16, 0.3 * (2 * reach + 1) ** 2):
            continue
        at = np.argwhere(use) + np.array([rows.start, cols.start])
        target = matches.place[rows, cols][use].astype(np.float64)
        matrix = fit_homography(
            at[:, ::-1].astype(np.float64), target[:, ::-1], weight[rows, cols][use]
        )
        projector[number] = moved(matrix, corner[None])[0]
        # Mirrored images turn to the left where others turn to the right.
        scale = (matrix @ np.append(corner, 1))[2]
        mirrored.append(bool(np.linalg.det(matrix) / scale**3 < 0))
    return BoardCorners(corners, projector, float(np.mean(mirrored)) if mirrored else 0.0)


def pose_images(capture: Capture, projector: int = 1) -> tuple[Array, Correspondence]:
    """The image (rows, cols) under white light, and the correspondence, of one projector.

    Stripes are decoded; of other patterns, and of several projectors at once, T is estimated.
    """
    if capture.projectors or stripes_of(capture.patterns) is None:
        transport = estimate(capture).split()[projector - 1]
        image = np.asarray(
            transport.relight(np.ones(transport.projector_shape, np.float32)), np.float64
        )
        matches = correspondence(transport)
    else:
        white = find_codes(capture.patterns).white
        # Without a white frame, the brightest level of each pixel is nearest to it.
        frames = range(capture.count) if white is None else (white,)
        image = capture.frames.read(frames[0]).astype(np.float64)
        for k in frames[1:]:
            image = np.maximum(image, capture.frames.read(k))
        matches = decode(capture)
    return image if image.ndim == 2 else image.mean(axis=2), matches


# The rig's geometry from the corners of a board in several poses, by OpenCV.


@dataclass(frozen=True, eq=False)
class StereoFit:
    """What OpenCV finds; residuals belong to all corners, those that were left out too."""

    geometry: RigGeometry
    # (poses, 3): the normal of each board in the camera's frame.
    normals: Array
    # (poses, n, 2) in pixels; NaN where a corner has no projector pixel.
    camera_errors: Array
    projector_errors: Array
    # (poses, n): the corners that count.
    used: NDArray[np.bool_]


def board_points(board: Shape, square: float, kind: BoardKind = "chessboard") -> Array:
    """The inner corners (n, 3) of a board of (corners across, down), on the plane z = 0."""
    across, down = board
    row, col = np.mgrid[:down, :across]
    if kind == "asymmetric-circles":
        col = 2 * col + row % 2
    return np.column_stack([col.ravel(), row.ravel(), np.zeros(across * down)]) * float(square)


def fit_stereo(
    poses: Sequence[BoardCorners], points: Array, camera_shape: Shape, projector_shape: Shape
) -> StereoFit:
    """Fit both devices to all poses, and leave out corners that are far off."""
    used = np.stack([pose.lit for pose in poses])
    fit = _fit(poses, points, used, camera_shape, projector_shape)
    # On real boards four rounds were enough.
    for _ in range(8):
        both = np.concatenate([fit.camera_errors, fit.projector_errors], axis=2)
        errors = np.linalg.norm(both, axis=2)
        # Random errors reach five times the median once in 10^10; where a board is bent or glares,
        # corners are off by more. On the five poses of a real board, whose corner is bent, this
        # leaves 304 of 315 corners, and all others within 0.6 pixels.
        kept = used & (errors <= 5 * float(np.median(errors[used])))
        # A pose needs four corners to be placed at all.
        kept = np.where(kept.sum(axis=1, keepdims=True) >= 4, kept, used)
        if np.array_equal(kept, used):
            break
        used = kept
        fit = _fit(poses, points, used, camera_shape, projector_shape)
    return fit


def _fit(
    poses: Sequence[BoardCorners], points: Array, used: NDArray[np.bool_], camera_shape: Shape,
    projector_shape: Shape,
) -> StereoFit:  # fmt: skip
    """One fit to the corners that count."""
    cv2 = load_opencv("calibrating a rig", "shape")
    # Five poses do not support more than two coefficients of radial distortion, so tangential terms
    # and the third coefficient stay 0.
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    objects = [points[use].astype(np.float32) for use in used]
    seen = [pose.camera[use].astype(np.float32) for pose, use in zip(poses, used, strict=True)]
    lit = [pose.projector[use].astype(np.float32) for pose, use in zip(poses, used, strict=True)]
    # Each device by itself, then both together.
    _, *camera_start, turns, shifts = cv2.calibrateCamera(
        objects, seen, camera_shape[::-1], None, None, flags=flags
    )
    # Projectors shift their image, and OpenCV starts from an axis through its middle. The corners
    # in the camera's frame lead straight to another start; the better one counts.
    placed = [
        board @ cv2.Rodrigues(turn)[0].T + shift.ravel()
        for board, turn, shift in zip(objects, turns, shifts, strict=True)
    ]
    # It takes no axis outside of the image, so the image is put in the middle of a larger one.
    wide = (7 * projector_shape[1], 7 * projector_shape[0])
    border = np.array([3 * projector_shape[1], 3 * projector_shape[0]])
    lit = [(each + border).astype(np.float32) for each in lit]
    fits = [cv2.calibrateCamera(objects, lit, wide, None, None, flags=flags)]
    start = projector_start(np.concatenate(placed), np.concatenate(lit))
    if start is not None and (start[:2, 2] > 0).all() and (start[:2, 2] < wide).all():
        guess = flags | cv2.CALIB_USE_INTRINSIC_GUESS
        fits.append(cv2.calibrateCamera(objects, lit, wide, start, None, flags=guess))
    known = *camera_start, *min(fits, key=lambda fit: float(fit[0]))[1:3]
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    end = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9
    answer = cv2.stereoCalibrateExtended(
        objects, seen, lit, *known, camera_shape[::-1], None, None, flags=flags, criteria=end
    )
    camera, camera_lens, projector, projector_lens, turn, shift = answer[1:7]
    projector[:2, 2] -= border

    def errors(rotation: Any, translation: Any, intrinsics: Any, lens: Any, places: Array) -> Array:
        """How far a device shows the points of the board from where they were found, (n, 2)."""
        vector = cv2.Rodrigues(rotation)[0]
        image = cv2.projectPoints(points, vector, translation, intrinsics, lens)[0]
        return np.asarray(image, np.float64).reshape(-1, 2) - places

    normals, camera_errors, projector_errors = [], [], []
    for pose, vector, place in zip(poses, answer[9], answer[10], strict=True):
        own = cv2.Rodrigues(vector)[0]
        normals.append(own[:, 2])
        camera_errors.append(errors(own, place, camera, camera_lens, pose.camera))
        both = turn @ own, turn @ place + shift
        projector_errors.append(errors(*both, projector, projector_lens, pose.projector))
    # A wild fit is judged by its residuals.
    matrices = camera @ np.eye(3, 4), projector @ np.column_stack([turn, shift])
    geometry = RigGeometry(*matrices, camera_shape, projector_shape, camera_lens, projector_lens)
    residuals = np.array(camera_errors), np.array(projector_errors)
    return StereoFit(geometry, np.array(normals), *residuals, used)


def projector_start(points: NDArray[np.floating], places: NDArray[np.floating]) -> Array | None:
    """K of a device that shows points (n, 3) at places (n, 2), by its projection matrix.

    The direct linear transformation (Hartley & Zisserman 2004, chapter 7), without skew; None if
    its focal lengths make no sense.
    """
    middle, scale = points.mean(axis=0), points.std()
    centre, size = places.mean(axis=0), places.std()
    space = np.column_stack([(points - middle) / scale, np.ones(len(points))])
    col, row = (places - centre).T / size
    zero = np.zeros_like(space)
    parts = [[space, zero, -col[:, None] * space], [zero, space, -row[:, None] * space]]
    rows = np.concatenate([np.hstack(part) for part in parts])
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    back = np.array([[size, 0, centre[0]], [0, size, centre[1]], [0, 0, 1]])
    result = back @ decomposed(normalised(matrix, "projector"))[0]
    result[0, 1] = 0
    return result if 0.2 < result[0, 0] / result[1, 1] < 5 else None


@dataclass(frozen=True, eq=False)
class BoardPose:
    """One pose of the board, by the name of its folder."""

    name: str
    # Its corners (n, 2) in the camera's image and on the projector, as (col, row); NaN where they
    # are not seen or not lit.
    camera: Array
    projector: Array
    # The corners that count; others are not lit, or off by more than 5 times the median.
    used: NDArray[np.bool_]
    # Root mean square of the distances of those from where the geometry puts them, in pixels.
    rms_camera: float
    rms_projector: float

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A calibrated rig, and how well it explains the board."""

    # In the camera's frame; its `rms` holds "stereo" (both images), "camera" and "projector".
    geometry: RigGeometry
    # The poses that were used, and why others were not.
    poses: tuple[BoardPose, ...]
    left_out: dict[str, str]
    # The largest angle between two poses of the board, in degrees.
    turn: float

    __repr__ = short_repr

    @property
    def corners(self) -> int:
        """Corners that count, in all poses."""
        return sum(int(pose.used.sum()) for pose in self.poses)

    def as_dict(self) -> dict[str, Any]:
        """The residuals, JSON-ready."""
        poses = [
            {"pose": pose.name, "corners": int(pose.used.sum()),
             "rms_camera": round(pose.rms_camera, 4), "rms_projector": round(pose.rms_projector, 4)}
            for pose in self.poses
        ]  # fmt: skip
        rms = {f"rms_{name}": round(value, 4) for name, value in self.geometry.rms.items()}
        total = sum(len(pose.used) for pose in self.poses)
        return {
            **rms, "corners": self.corners, "of_corners": total, "poses": poses,
            "largest_turn": round(self.turn, 1), "baseline": round(self.geometry.baseline, 4),
            "units": self.geometry.units, "left_out": dict(self.left_out),
        }  # fmt: skip


def calibrate_rig(
    poses: Sequence[Capture | str | Path],
    board: tuple[int, int] = (9, 7),
    square: float = 1.0,
    *,
    kind: BoardKind = "chessboard",
    projector: int = 1,
    units: str | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RigCalibration:
    """Calibrate a projector and a camera with a printed board.

    Show the board in at least three poses, better five to ten: tilted to all sides by 20 to 40
    degrees, each filling much of the image that both camera and projector cover. Photograph each
    pose under a Gray code (see `make_patterns`) or other stripes, which are decoded, or under
    random patterns, whose T is estimated.

    Parameters
    ----------
    poses : sequence of Capture, str or Path
        A capture of each pose, or its folder.
    board : (int, int)
        Inner corners along the rows and the columns of the board: squares less one. Or circles.
    square : float
        Side of a square, or distance of neighbouring circles, in `units`; of asymmetric circles,
        the distance of neighbouring rows.
    kind : {"chessboard", "charuco", "circles", "asymmetric-circles"}
        What is printed. The markers of a ChArUco board may be of any dictionary of 4 x 4 to 7 x 7
        bits; only a part of such a board need be seen. Of any board, 8 corners in two rows and two
        columns must be lit.
    projector : int
        Number of the projector, from 1 on, of several that showed random patterns at once. The
        geometries of all of them are in the frame of the one camera.
    units : str, optional
        Unit of length, such as "mm".
    output : str or Path, optional
        The geometry to write, as `RigGeometry.save` does: .json, or of another program.
    overwrite : bool
        Whether an existing geometry may be replaced.
    progress : callable, optional
        Called with (done, total) poses.

    Returns
    -------
    RigCalibration
        Intrinsics, distortion (two coefficients) and pose of both devices, with the residuals of
        each pose. Warnings name the poses that were left out, or do not fit the others.

    Raises
    ------
    InputError
        If fewer than three poses show a board that both devices see, if the poses are parallel, or
        if they have different image sizes.
    MissingExtraError, OutputError
        Without OpenCV, the extra `shape`; if the file exists or cannot be written.

    References
    ----------
    Zhang 2000, A flexible new technique for camera calibration; Moreno & Taubin 2012, Simple,
    accurate, and robust projector-camera calibration.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> measured = lm.calibrate_rig(["pose_0", "pose_1", "pose_2"])  # doctest: +SKIP
    """
    load_opencv("calibrating a rig", "shape")
    if output is not None:
        check_output(output, geometry_kind(output), overwrite=overwrite)
    check_number("a square", square, above=True, hint="give its side, such as 24")
    if min(board) < 3:
        hint = "use at least 3 x 3"
        raise InputError(f"a board of {board[0]} x {board[1]} inner corners", hint=hint)
    if kind not in get_args(BoardKind):
        hint = f"use one of {', '.join(get_args(BoardKind))}"
        raise InputError(f"a board of the kind {kind!r}", hint=hint)
    check_list(poses, hint="give a capture for each pose of the board")
    _check_count(len(poses), {})
    corners, shapes, left_out = _all_corners(poses, board, kind, projector, progress)
    points = board_points(board, square, kind)
    mirrored = bool(np.mean([pose.mirrored for pose in corners.values()]) > 0.5)
    if mirrored:
        warn(
            "the camera sees the projector's image mirrored (rear projection, a mirror, flipped "
            "patterns): the geometry takes it into account"
        )

    def fitted() -> StereoFit:
        flip, last = ((-1, 1), (shapes[1][1] - 1, 0)) if mirrored else ((1, 1), (0, 0))
        own = [replace(pose, projector=pose.projector * flip + last) for pose in corners.values()]
        return fit_stereo(own, points, *shapes)

    fit = fitted()
    badly = {
        name: f"only {use.sum()} of {len(use)} corners fit the other poses; did the board move?"
        for (name, pose), use in zip(corners.items(), fit.used, strict=True)
        if use.sum() < 0.5 * pose.lit.sum()
    }
    if badly:
        left_out |= badly
        corners = {name: pose for name, pose in corners.items() if name not in badly}
        _check_count(len(corners), left_out)
        fit = fitted()
    turn = float(np.degrees(np.arccos(np.abs(fit.normals @ fit.normals.T).clip(0, 1).min())))
    # Zhang's Fig. 4: the error of the focal length falls steeply with the angle between two boards,
    # and is several times its best below 10 degrees.
    if turn < 10:
        raise InputError(
            f"the poses are nearly parallel: their largest angle is {turn:.1f} degrees",
            hint="add poses with the board tilted by 20 to 40 degrees to the left, right, up, down",
        )
    seen, lit = fit.camera_errors, fit.projector_errors
    rms = {"camera": _rms(seen[fit.used]), "projector": _rms(lit[fit.used])}
    rms["stereo"] = float(np.sqrt((rms["camera"] ** 2 + rms["projector"] ** 2) / 2))
    # Good calibrations reach 0.1 to 0.5 pixels.
    worst = max(rms["camera"], rms["projector"])
    causes = (
        "are all poses in the order of their patterns? Is the board flat and of this many inner "
        "corners, and did it lie still? Did the camera focus anew?"
    )
    off = f"{rms['camera']:.2f} camera pixels and {rms['projector']:.2f} projector pixels (RMS)"
    if worst > 3:
        raise InputError(f"no geometry explains the corners: they are off by {off}", hint=causes)
    if worst > 1:
        warn(f"the corners are off by {off}; good calibrations reach 0.5\n  {causes}")
    geometry = replace(fit.geometry, units=units, rms=rms, projector_mirrored=mirrored)
    used_poses = tuple(
        BoardPose(name, corner.camera, corner.projector, use, _rms(a[use]), _rms(b[use]))
        for (name, corner), use, a, b in zip(corners.items(), fit.used, seen, lit, strict=True)
    )
    for name, reason in left_out.items():
        warn(f"{name} is left out: {reason}")
    usual = float(np.median([pose.rms_projector for pose in used_poses]))
    for pose in used_poses:
        if pose.rms_projector > 3 * usual:
            warn(
                f"{pose.name} fits badly: its corners are off by {pose.rms_projector:.2f} "
                f"projector pixels, those of other poses by {usual:.2f}; photograph it again, or "
                "leave it out"
            )
    if output is not None:
        geometry.save(output, overwrite=overwrite)
    return RigCalibration(geometry, used_poses, left_out, turn)


def _all_corners(
    poses: Sequence[Capture | str | Path], board: Shape, kind: BoardKind, projector: int,
    progress: Progress | None,
) -> tuple[dict[str, BoardCorners], tuple[Shape, Shape], dict[str, str]]:  # fmt: skip
    """The corners of usable poses by name, the image sizes, and why other poses are not usable."""
    found: dict[str, BoardCorners] = {}
    left_out: dict[str, str] = {}
    shapes: tuple[Shape, Shape] | None = None
    for number, pose in enumerate(poses):
        name = f"pose {number}" if isinstance(pose, Capture) else str(pose)
        capture = open_capture(pose)
        rows, cols = capture.camera_shape[:2]
        several = capture.projectors or (capture.projector_shape,)
        if not 0 < projector <= len(several):
            raise InputError(f"{name}: has no projector {projector}", hint=f"it has {len(several)}")
        sizes = ((rows, cols), several[projector - 1])
        if shapes is not None and sizes != shapes:
            hint = "photograph all poses with the same camera and projector"
            raise InputError(f"{name}: has images of other sizes than the poses before", hint=hint)
        shapes = sizes
        try:
            white, matches = pose_images(capture, projector)
        except InputError as error:
            # Frames out of order, or no light of the projector.
            left_out[name] = error.message
            continue
        places = find_corners(white, board, kind)
        corners = None if places is None else light_corners(places, matches, board)
        if corners is None:
            left_out[name] = f"no board of {board[0]} x {board[1]} inner corners is found"
        elif not _suffice(corners.lit, board):
            seen = int(np.isfinite(corners.camera).all(axis=1).sum())
            left_out[name] = (
                f"the camera sees {seen} of {len(corners.lit)} corners, and the projector lights "
                f"{corners.lit.sum()} of them: {_FEWEST} in two rows and two columns are needed"
            )
        else:
            found[name] = corners
        if progress is not None:
            progress(number + 1, len(poses))
    _check_count(len(found), left_out)
    assert shapes is not None
    return found, shapes, left_out


def _suffice(lit: NDArray[np.bool_], board: Shape) -> bool:
    """Whether enough corners of a board are lit, in two of its rows and columns at least."""
    grid = lit.reshape(board[1], board[0])
    return lit.sum() >= _FEWEST and min(grid.any(axis=1).sum(), grid.any(axis=0).sum()) >= 2


def _check_count(usable: int, left_out: dict[str, str]) -> None:
    # Each pose gives two equations for the four numbers of K (Zhang 2000); a third pose leaves some
    # for the distortion and for the residuals to mean anything.
    if usable >= 3:
        return
    reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
    raise InputError(
        f"{usable} usable poses{reasons}",
        hint="photograph 3 poses at least, better 5 to 10, each tilted differently and "
        "lit by the projector; a board's size is its inner corners, squares less one",
    )


def _rms(errors: Array) -> float:
    """Root mean square of the lengths of errors (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


# The rig's geometry from any scene that is not flat.


def self_calibrate(
    matches: Correspondence | LightTransport | str | Path,
    camera_intrinsics: ArrayLike | None,
    *,
    principal: tuple[float, float] | None = None,
    projector_intrinsics: ArrayLike | None = None,
    camera_distortion: ArrayLike = (0, 0, 0, 0, 0),
    baseline: float = 1.0,
    units: str | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> RigGeometry:
    """Find where the projector stands from any scene that is not flat.

    Parameters
    ----------
    matches : Correspondence, LightTransport, str or Path
        What each camera pixel sees, from `decode` or `correspondence`; or T; or a file of either.
        Of photographs that are neither binned nor cropped.
    camera_intrinsics : (3, 3) array-like or float
        K of the camera, from a calibration; or its focal length in pixels, from its data sheet: the
        focal length divided by the size of a pixel. The axis then passes `principal`.
    principal : (float, float), optional
        Where the camera's axis passes its image, as (col, row); None: in the middle. Only with a
        focal length.
    projector_intrinsics : (3, 3) array-like, optional
        K of the projector. None: square pixels, and the focal length and the row of the axis that
        fit best, with its column in the middle. The row stays in the middle unless the matches
        contradict it, as under projectors that shift their image upwards.
    camera_distortion : (5,) array-like
        Coefficients of the camera's lens.
    baseline : float
        Distance from the camera to the projector, in `units`. The matches do not tell it: all
        lengths are proportional to it.
    units, output, overwrite
        As in `calibrate_rig`.

    Returns
    -------
    RigGeometry
        In the camera's frame; its `rms` holds "epipolar", the distances of matches that fit from
        their epipolar lines, in pixels, and "projector_focal_length", its standard error.

    Warns
    -----
    LightMatrixWarning
        If the projector's image is mirrored, or the axes of the devices contradict the matches.

    Raises
    ------
    InputError
        Without the camera's intrinsics, on too few matches, on a flat scene, and if matches lie
        behind a device.
    OutputError
        If the file exists or cannot be written.

    References
    ----------
    Hartley & Zisserman 2004, Multiple View Geometry, chapters 9 to 11.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("l_objects")
    >>> rig = lm.self_calibrate(known.transport(), known.geometry.camera_intrinsics)
    >>> rig.rms["epipolar"] < 0.3
    True
    """
    if camera_intrinsics is None:
        raise InputError(
            "without the camera's intrinsics, shape is known only up to a projective distortion",
            hint="give camera_intrinsics, calibrate with a board, or divide the focal length by "
            "the size of a pixel",
        )
    check_number("a baseline", baseline, above=True, hint="give a length above 0, such as 1")
    if output is not None:
        check_output(output, geometry_kind(output), overwrite=overwrite)
    opened = open_matches(matches)
    found = correspondence(opened) if isinstance(opened, LightTransport) else opened
    projector_shape = found.projector_shape
    if projector_shape is None:
        hint = "give T or a file of `decode`; in Python, replace(matches, projector_shape=...)"
        raise InputError("the correspondence does not say the projector's size", hint=hint)
    # Matches of less confidence come from several places at once; chosen by hand.
    at = np.argwhere(np.isfinite(found.place).all(axis=2) & (found.confidence >= 0.3))
    if len(at) < 50:
        hint = "50 are needed, better thousands, with stripes or patterns along both axes"
        raise InputError(f"{len(at)} camera pixels see one place of the projector", hint=hint)
    # More matches than these cost time and change nothing.
    at = at[np.random.default_rng(0).permutation(len(at))[:20_000]]
    seen = at[:, ::-1].astype(np.float64)
    lit = found.place[at[:, 0], at[:, 1]].astype(np.float64)[:, ::-1]
    # Lends its checks and its lens to the points; where the projector stands is not known yet.
    rows, cols = found.valid.shape
    if np.ndim(camera_intrinsics) == 0:
        focal = float(np.asarray(camera_intrinsics))
        check_number("a focal length", focal, above=True, hint="give it in pixels, such as 1200")
        camera_intrinsics = _centred(focal, (rows, cols))
        if principal is not None:
            camera_intrinsics[:2, 2] = principal
    own, sizes = _centred(max(projector_shape), projector_shape), ((rows, cols), projector_shape)
    camera = RigGeometry.from_intrinsics(
        camera_intrinsics, own, np.eye(3), (1, 0, 0), *sizes, camera_distortion=camera_distortion
    )
    seen = camera.undistort_camera(seen)
    finite = np.isfinite(seen).all(axis=1)
    seen, lit = seen[finite], lit[finite]
    fundamental = fit_fundamental(seen, lit)
    distance = np.abs(sampson(fundamental, seen, lit))
    # A scene is flat if a homography explains nearly all matches, but for noise: parallax is what
    # shows shape. Both images share the distance to a line, and the noise of a place has two
    # dimensions: five standard deviations of it are 10 medians.
    plane = moved(fit_homography(seen, lit, np.ones(len(seen))), seen)
    noise = max(0.5, 10 * float(np.median(distance)))
    share = float((np.linalg.norm(plane - lit, axis=1) > noise).mean())
    if share < 0.05:
        hint = "put objects of different depth into the scene, or calibrate with a board"
        shown = f"only {100 * share:.1f} % of the matches show parallax"
        raise InputError(f"the scene is flat: {shown}", hint=hint)
    fits = distance < max(4.4 * float(np.median(distance)), 0.1)
    seen, lit = seen[fits], lit[fits]
    free = float(np.sqrt((distance[fits] ** 2).mean()))

    def fitted(mirrored: bool) -> tuple[RigGeometry, float]:
        """The rig by matches that are mirrored or not, and the share of them behind a device."""
        own = lit * (-1, 1) + (projector_shape[1] - 1, 0) if mirrored else lit
        known = None if projector_intrinsics is None else np.asarray(projector_intrinsics, float)
        matrix = fit_fundamental(seen, own) if mirrored else fundamental
        lens = camera.camera_intrinsics
        pose, deviation = _pose(matrix, seen, own, lens, known, projector_shape, free)
        rig = RigGeometry.from_intrinsics(
            lens, *pose[:2], pose[2] * baseline, *sizes, camera_distortion=camera_distortion
        )
        away = sampson(rig.fundamental_matrix(), seen, own)
        rms = {"epipolar": float(np.sqrt((away**2).mean()))}
        if known is None:
            rms["projector_focal_length"] = deviation
        # Here matches count as the camera shows them without its lens.
        ideal = replace(rig, camera_distortion=np.zeros(5))
        points = ideal.triangulate(seen, own)
        ahead = points @ rig.projector_matrix[2, :3] + rig.projector_matrix[2, 3]
        # Points at infinity have no parallax that exceeds the distances from the lines.
        parallax = rig.projector_intrinsics[0, 0] * baseline / np.maximum(ahead, 1e-12)
        ahead = (rig.depth(points) > 0) & (ahead > 0) & (parallax > 3 * rms["epipolar"])
        behind = float(1 - ahead.mean())
        return replace(rig, rms=rms, units=units, projector_mirrored=mirrored), behind

    rig, behind = fitted(mirrored=False)
    # Right geometries have no match behind a device, and wrong ones a quarter at least.
    if behind > 0.1:
        other, of_other = fitted(mirrored=True)
        if of_other > 0.1:
            raise InputError(
                f"{100 * min(behind, of_other):.0f} % of the matches would lie behind the camera "
                "or the projector, or at infinity",
                hint="the focal length is wrong, or the axis of a device does not pass the middle "
                "of its image: give the column and row of the camera's (principal), or K of the "
                "projector (projector_intrinsics, in Python)",
            )
        warn("the camera sees the projector's image mirrored: the geometry takes it into account")
        rig = other
    if rig.rms["epipolar"] > 3 * free + 0.1:
        warn(
            f"the matches lie {rig.rms['epipolar']:.2f} pixels from their epipolar lines, and "
            f"{free:.2f} if the axes of the devices are free\n  do they pass the middle of their "
            "images? Give principal, projector_intrinsics, or calibrate with a board"
        )
    if output is not None:
        rig.save(output, overwrite=overwrite)
    return rig


def _centred(focal: float, shape: tuple[int, int]) -> Array:
    """K of square pixels and an axis through the middle of an image of (rows, cols)."""
    rows, cols = shape
    return np.array([[focal, 0, (cols - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]])


def _pose(
    fundamental: Array, seen: Array, lit: Array, camera: Array, projector: Array | None,
    projector_shape: Shape, free: float,
) -> tuple[tuple[Array, Array, Array], float]:  # fmt: skip
    """K of the projector, R and t of length 1, that bring the matches nearest to their lines.

    `free` is how near those of the fundamental matrix come. The standard error of the projector's
    focal length comes last.
    """
    # Angles of view from 8 to 90 degrees.
    focals = [f * max(projector_shape) for f in np.geomspace(0.5, 7, 60)]
    best: tuple[float, Any, float] | None = None
    # The axis passes the middle of the image, or its lower or upper edge.
    for row in [None] if projector is not None else [None, 1.0, 0.0]:
        if best is not None and best[0] < 2 * free + 0.02:
            break
        candidates = [_centred(f, projector_shape) for f in focals]
        for each in candidates:
            each[1, 2] = each[1, 2] if row is None else row * (projector_shape[0] - 1)
        if projector is not None:
            candidates = [projector]
        # The two singular values of an essential matrix are equal.
        values = [
            np.linalg.svd(each.T @ fundamental @ camera, compute_uv=False) for each in candidates
        ]
        start = candidates[int(np.argmin([(a - b) / a for a, b, _ in values]))]
        turn, shift = _decomposed(start.T @ fundamental @ camera, camera, start, seen, lit)

        def parts(
            numbers: Array, start: Array = start, turn: Array = turn, shift: Array = shift
        ) -> tuple[Array, Array, Array]:
            own = start.copy()
            if len(numbers) > 6:
                own[[0, 1], [0, 1]] *= np.exp(numbers[6])
            if len(numbers) > 7:
                own[1, 2] += numbers[7] * projector_shape[0]
            moved_shift = shift + numbers[3:6]
            rotation = Rotation.from_rotvec(numbers[:3]).as_matrix() @ turn
            return own, rotation, moved_shift / np.linalg.norm(moved_shift)

        def distances(numbers: Array, parts: Any = parts) -> Array:
            own, rotation, (x, y, z) = parts(numbers)
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            matrix = np.linalg.inv(own).T @ cross @ rotation @ np.linalg.inv(camera)
            return sampson(matrix, seen, lit)

        first = np.zeros(6 if projector is not None else 7 if row is None else 8)
        spread = max(float(np.median(np.abs(distances(first)))), 1e-3)
        found = least_squares(distances, first, loss="soft_l1", f_scale=spread)
        rms = float(np.sqrt((distances(found.x) ** 2).mean()))
        # Errors of neighbours are alike: all matches tell as much as a hundred that are not.
        inverse = np.linalg.pinv(found.jac.T @ found.jac / len(seen) * 100)
        pose = parts(found.x)
        error = 0.0 if len(first) < 7 else rms * float(np.sqrt(inverse[6, 6])) * pose[0][0, 0]
        if best is None or rms < best[0]:
            best = rms, pose, error
    assert best is not None
    return best[1], float(best[2])


def _decomposed(
    essential: Array, camera: Array, projector: Array, seen: Array, lit: Array
) -> tuple[Array, Array]:
    """R and t of an essential matrix, of the four solutions the one with most points in front."""
    left, _, right = np.linalg.svd(essential)
    left, right = left * np.linalg.det(left), right * np.linalg.det(right)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns, shifts = (left @ quarter @ right, left @ quarter.T @ right), (left[:, 2], -left[:, 2])

    def in_front(pose: tuple[Array, Array]) -> int:
        matrices = camera @ np.eye(3, 4), projector @ np.column_stack(pose)
        rig = RigGeometry(*matrices, (1, 1), (1, 1))
        points = rig.triangulate(seen, lit)
        ahead = points @ pose[0].T + pose[1]
        return int(((points[:, 2] > 0) & (ahead[:, 2] > 0)).sum())

    return max(((turn, shift) for turn in turns for shift in shifts), key=in_front)
