"""`lm.calibrate_rig`: the geometry of a rig from captures of a board in several poses."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.estimators.estimate import estimate
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import GEOMETRY
from lightmatrix.files.writing import check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.ranges import check_number
from lightmatrix.reprs import short_repr
from lightmatrix.shape.board import BoardCorners, find_corners, light_corners
from lightmatrix.shape.decode import decode, find_codes
from lightmatrix.transport.correspondence import Correspondence, correspondence

# What calibration needs of a capture: its white image, and the projector pixel each pixel sees.


def pose_images(capture: Capture) -> tuple[NDArray[np.float64], Correspondence]:
    """The image (rows, cols) under white light, and the correspondence.

    Stripes are decoded; of other patterns, T is estimated.
    """
    if stripes_of(capture.patterns) is not None:
        return _white_of_stripes(capture), decode(capture)
    transport = estimate(capture)
    white = transport.relight(np.ones(transport.projector_shape, np.float32))
    return _grey(np.asarray(white, np.float64)), correspondence(transport)


def _white_of_stripes(capture: Capture) -> NDArray[np.float64]:
    """The white frame, or the brightest level of each pixel in frames of stripes."""
    white = find_codes(capture.patterns).white
    if white is not None:
        return _grey(capture.frames.read(white).astype(np.float64))
    brightest = capture.frames.read(0).astype(np.float64)
    for k in range(1, capture.count):
        brightest = np.maximum(brightest, capture.frames.read(k))
    return _grey(brightest)


def _grey(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean over a colour camera's channels."""
    return image if image.ndim == 2 else image.mean(axis=2)


# The rig's geometry from the corners of a board in several poses: Zhang's method, for two devices.
#
# The projector counts as a second camera. OpenCV calibrates each by itself, then both together.
# Five poses do not support more than two coefficients of radial distortion, so tangential terms
# and the third coefficient stay 0.


Shape = tuple[int, int]
# A corner is left out if it is off by more than this multiple of the median, which random errors
# reach once in 10^10. It is where a board is bent or glares: on the five poses of a real board,
# whose corner is bent, this leaves 304 of 315 corners, and all others within 0.6 pixels.
_MOST_OFF = 5.0
# Rounds of leaving out corners; on real boards four were enough.
_ROUNDS = 8
# OpenCV stops when the residual changes by less than this share, or after this many iterations.
_ITERATIONS, _PRECISION = 200, 1e-9


@dataclass(frozen=True, eq=False)
class StereoFit:
    """What OpenCV finds; residuals belong to all corners, those that were left out too.

    Parameters
    ----------
    camera_intrinsics, projector_intrinsics : (3, 3) float64
        K of each.
    camera_distortion, projector_distortion : (5,) float64
        Coefficients of each lens.
    rotation, translation : (3, 3) and (3,) float64
        From the camera's frame to the projector's.
    normals : (poses, 3) float64
        Normal of each board in the camera's frame.
    camera_errors, projector_errors : list of (n, 2) float64
        Residuals of each pose, in pixels; NaN where a corner has no projector pixel.
    used : list of (n,) bool
        The corners that count, by pose.
    """

    camera_intrinsics: NDArray[np.float64]
    projector_intrinsics: NDArray[np.float64]
    camera_distortion: NDArray[np.float64]
    projector_distortion: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    normals: NDArray[np.float64]
    camera_errors: list[NDArray[np.float64]]
    projector_errors: list[NDArray[np.float64]]
    used: list[NDArray[np.bool_]]


def board_points(board: Shape, square: float) -> NDArray[np.float64]:
    """The inner corners (n, 3) of a board of (corners across, down), on the plane z = 0."""
    across, down = board
    row, col = np.mgrid[:down, :across]
    return np.column_stack([col.ravel(), row.ravel(), np.zeros(across * down)]) * float(square)


def fit_stereo(
    poses: Sequence[BoardCorners],
    points: NDArray[np.float64],
    camera_shape: Shape,
    projector_shape: Shape,
) -> StereoFit:
    """Fit both devices to all poses, and leave out corners that are far off."""
    used = [pose.lit for pose in poses]
    fit = _fit(poses, points, used, camera_shape, projector_shape)
    for _ in range(_ROUNDS):
        errors = [
            np.hypot(np.linalg.norm(seen, axis=1), np.linalg.norm(lit, axis=1))
            for seen, lit in zip(fit.camera_errors, fit.projector_errors, strict=True)
        ]
        counted = [each[use] for each, use in zip(errors, used, strict=True)]
        most = _MOST_OFF * float(np.median(np.concatenate(counted)))
        kept = [use & (each <= most) for each, use in zip(errors, used, strict=True)]
        # A pose needs four corners to be placed at all.
        kept = [keep if keep.sum() >= 4 else use for keep, use in zip(kept, used, strict=True)]
        if all(np.array_equal(keep, use) for keep, use in zip(kept, used, strict=True)):
            break
        used = kept
        fit = _fit(poses, points, used, camera_shape, projector_shape)
    return fit


def _fit(
    poses: Sequence[BoardCorners],
    points: NDArray[np.float64],
    used: list[NDArray[np.bool_]],
    camera_shape: Shape,
    projector_shape: Shape,
) -> StereoFit:
    """One fit to the corners that count."""
    cv2 = load_opencv("calibrating a rig", "shape")
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, _ITERATIONS, _PRECISION)
    objects = [points[use].astype(np.float32) for use in used]
    seen = [pose.camera[use].astype(np.float32) for pose, use in zip(poses, used, strict=True)]
    lit = [pose.projector[use].astype(np.float32) for pose, use in zip(poses, used, strict=True)]
    first = [
        cv2.calibrateCamera(objects, image, shape[::-1], None, None, flags=flags)[1:3]
        for image, shape in ((seen, camera_shape), (lit, projector_shape))
    ]
    answer = cv2.stereoCalibrateExtended(
        objects,
        seen,
        lit,
        *first[0],
        *first[1],
        camera_shape[::-1],
        None,
        None,
        flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=criteria,
    )
    camera, camera_lens, projector, projector_lens, turn, shift = answer[1:7]
    turns, shifts = answer[9], answer[10]
    normals, camera_errors, projector_errors = [], [], []
    for pose, vector, place in zip(poses, turns, shifts, strict=True):
        own = cv2.Rodrigues(vector)[0]
        normals.append(own[:, 2])
        camera_errors.append(_project(cv2, points, own, place, camera, camera_lens) - pose.camera)
        both = turn @ own, turn @ place + shift
        image = _project(cv2, points, *both, projector, projector_lens)
        projector_errors.append(image - pose.projector)
    return StereoFit(
        camera,
        projector,
        np.resize(camera_lens, 5),
        np.resize(projector_lens, 5),
        turn,
        shift.ravel(),
        np.array(normals),
        camera_errors,
        projector_errors,
        used,
    )


def _project(
    cv2: Any,
    points: NDArray[np.float64],
    rotation: NDArray[np.float64],
    translation: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    lens: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Where a device shows points (n, 3) of the board, (n, 2)."""
    image = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], translation, intrinsics, lens)[0]
    return np.asarray(image, np.float64).reshape(-1, 2)


Progress = Callable[[int, int], None]
# Each pose gives two equations for the four numbers of K (Zhang 2000); a third pose leaves some for
# the distortion and for the residuals to mean anything.
FEWEST_POSES = 3
# Boards must be turned against each other by this angle, in degrees. Zhang's Fig. 4: the error of
# the focal length falls steeply with the angle, and is several times its best below 10 degrees.
_LEAST_TURN = 10.0
# A pose is left out if fewer than this share of the board's corners are lit or fit the others.
_LEAST_CORNERS = 0.5
# A pose is named as bad if its residual is this multiple of the median of all poses.
_BAD = 3.0


@dataclass(frozen=True, eq=False)
class BoardPose:
    """One pose of the board.

    Parameters
    ----------
    name : str
        Its folder.
    camera, projector : (n, 2) float64
        The board's corners in the camera's image and on the projector as (col, row); NaN where the
        projector pixel is not known.
    used : (n,) bool
        The corners that count. Others are not lit, or off by more than 5 times the median, as where
        a board is bent.
    rms_camera, rms_projector : float
        Root mean square of the distances of corners that count from where the geometry puts them,
        in pixels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> measured = lm.calibrate_rig(["pose_0", "pose_1", "pose_2"])  # doctest: +SKIP
    >>> {pose.name: pose.rms_projector for pose in measured.poses}  # doctest: +SKIP
    """

    name: str
    camera: NDArray[np.float64]
    projector: NDArray[np.float64]
    used: NDArray[np.bool_]
    rms_camera: float
    rms_projector: float

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A calibrated rig, and how well it explains the board.

    Parameters
    ----------
    geometry : RigGeometry
        In the camera's frame; its `rms` holds "stereo" (both images), "camera" and "projector".
    poses : tuple of BoardPose
        The poses that were used.
    left_out : mapping of str to str
        Poses that were not, with the reason.
    turn : float
        The largest angle between two poses of the board, in degrees.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> measured = lm.calibrate_rig(["pose_0", "pose_1", "pose_2"])  # doctest: +SKIP
    """

    geometry: RigGeometry
    poses: tuple[BoardPose, ...]
    left_out: dict[str, str]
    turn: float

    __repr__ = short_repr

    @property
    def corners(self) -> int:
        """Corners that count, in all poses."""
        return sum(int(pose.used.sum()) for pose in self.poses)

    def as_dict(self) -> dict[str, Any]:
        """The residuals, JSON-ready."""
        return {
            **{f"rms_{name}": round(value, 4) for name, value in self.geometry.rms.items()},
            "corners": self.corners,
            "of_corners": sum(len(pose.used) for pose in self.poses),
            "largest_turn": round(self.turn, 1),
            "baseline": round(self.geometry.baseline, 4),
            "units": self.geometry.units,
            "poses": [
                {
                    "pose": pose.name,
                    "corners": int(pose.used.sum()),
                    "rms_camera": round(pose.rms_camera, 4),
                    "rms_projector": round(pose.rms_projector, 4),
                }
                for pose in self.poses
            ],
            "left_out": dict(self.left_out),
        }


def calibrate_rig(
    poses: Sequence[Capture | str | Path],
    board: tuple[int, int] = (9, 7),
    square: float = 1.0,
    *,
    units: str | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RigCalibration:
    """Calibrate a projector and a camera with a printed chessboard.

    Show the board in at least three poses, better five to ten: tilted to all sides by 20 to 40
    degrees, each filling much of the image that both camera and projector cover. Photograph each
    pose under a Gray code (see `make_patterns`) or other stripes, which are decoded, or under
    random patterns, whose T is estimated.

    Parameters
    ----------
    poses : sequence of Capture, str or Path
        A capture of each pose, or its folder.
    board : (int, int)
        Inner corners along the rows and the columns of the board: squares less one.
    square : float
        Side of a square in `units`.
    units : str, optional
        Unit of length, such as "mm".
    output : str or Path, optional
        A .json file of the geometry to write.
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
    MissingExtraError
        Without OpenCV, the extra `shape`.
    OutputError
        If the file exists or cannot be written.

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
        check_output(output, GEOMETRY, overwrite=overwrite)
    check_number("a square", square, above=True, hint="give its side, such as 24")
    if min(board) < 3:
        raise InputError(
            f"a board of {board[0]} x {board[1]} inner corners", hint="use at least 3 x 3"
        )
    _check_count(len(poses), {})
    corners, names, shapes, left_out = _all_corners(poses, board, progress)
    points = board_points(board, square)
    fit = fit_stereo(corners, points, *shapes)
    badly = {
        name: f"only {use.sum()} of {len(use)} corners fit the other poses; did the board move?"
        for name, use in zip(names, fit.used, strict=True)
        if use.sum() < _LEAST_CORNERS * len(use)
    }
    if badly:
        left_out |= badly
        keep = [k for k, name in enumerate(names) if name not in badly]
        corners, names = [corners[k] for k in keep], [names[k] for k in keep]
        _check_count(len(names), left_out)
        fit = fit_stereo(corners, points, *shapes)
    turn = _largest_turn(fit.normals)
    if turn < _LEAST_TURN:
        raise InputError(
            f"the poses are nearly parallel: their largest angle is {turn:.1f} degrees",
            hint="add poses with the board tilted by 20 to 40 degrees to the left, right, up, down",
        )
    measured = _measured(fit, corners, names, shapes, units, left_out, turn)
    _warn(measured)
    if output is not None:
        measured.geometry.save(output, overwrite=overwrite)
    return measured


def _all_corners(
    poses: Sequence[Capture | str | Path], board: tuple[int, int], progress: Progress | None
) -> tuple[list[BoardCorners], list[str], tuple[tuple[int, int], tuple[int, int]], dict[str, str]]:
    """Corners and names of usable poses, the image sizes, and why the others are not usable."""
    found: list[BoardCorners] = []
    names: list[str] = []
    left_out: dict[str, str] = {}
    shapes: tuple[tuple[int, int], tuple[int, int]] | None = None
    for number, pose in enumerate(poses):
        name = f"pose {number}" if isinstance(pose, Capture) else str(pose)
        capture = open_capture(pose)
        rows, cols = capture.camera_shape[:2]
        sizes = ((rows, cols), capture.projector_shape)
        if shapes is not None and sizes != shapes:
            raise InputError(
                f"{name}: has images of other sizes than the poses before",
                hint="photograph all poses with the same camera and projector",
            )
        shapes = sizes
        white, matches = pose_images(capture)
        places = find_corners(white, board)
        corners = None if places is None else light_corners(places, matches, board)
        if corners is None:
            left_out[name] = f"no board of {board[0]} x {board[1]} inner corners is found"
        elif corners.lit.mean() < _LEAST_CORNERS:
            left_out[name] = (
                f"the camera sees the board, but the projector lights only {corners.lit.sum()} of "
                f"its {len(corners.lit)} corners"
            )
        else:
            found.append(corners)
            names.append(name)
        if progress is not None:
            progress(number + 1, len(poses))
    _check_count(len(found), left_out)
    assert shapes is not None
    return found, names, shapes, left_out


def _check_count(usable: int, left_out: dict[str, str]) -> None:
    if usable >= FEWEST_POSES:
        return
    reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
    raise InputError(
        f"{usable} usable poses{reasons}",
        hint=f"photograph {FEWEST_POSES} poses at least, better 5 to 10, each tilted differently "
        "and lit by the projector; a board's size is its inner corners, squares less one",
    )


def _largest_turn(normals: NDArray[np.float64]) -> float:
    """The largest angle between two planes, in degrees."""
    cosine = np.abs(normals @ normals.T).clip(0, 1)
    return float(np.degrees(np.arccos(cosine.min())))


def _measured(
    fit: StereoFit,
    corners: list[BoardCorners],
    names: list[str],
    shapes: tuple[tuple[int, int], tuple[int, int]],
    units: str | None,
    left_out: dict[str, str],
    turn: float,
) -> RigCalibration:
    """The result, with its residuals."""
    seen = [error[use] for error, use in zip(fit.camera_errors, fit.used, strict=True)]
    lit = [error[use] for error, use in zip(fit.projector_errors, fit.used, strict=True)]
    rms = {"camera": _rms(np.concatenate(seen)), "projector": _rms(np.concatenate(lit))}
    rms["stereo"] = float(np.sqrt((rms["camera"] ** 2 + rms["projector"] ** 2) / 2))
    geometry = RigGeometry.from_intrinsics(
        fit.camera_intrinsics,
        fit.projector_intrinsics,
        fit.rotation,
        fit.translation,
        *shapes,
        camera_distortion=fit.camera_distortion,
        projector_distortion=fit.projector_distortion,
        units=units,
        rms=rms,
    )
    poses = tuple(
        BoardPose(name, corner.camera, corner.projector, use, _rms(a), _rms(b))
        for name, corner, use, a, b in zip(names, corners, fit.used, seen, lit, strict=True)
    )
    return RigCalibration(geometry, poses, left_out, turn)


def _rms(errors: NDArray[np.float64]) -> float:
    """Root mean square of the lengths of errors (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def _warn(measured: RigCalibration) -> None:
    """Name the poses that were left out, and those that fit much worse than the others."""
    for name, reason in measured.left_out.items():
        warnings.warn(f"{name} is left out: {reason}", LightMatrixWarning, stacklevel=3)
    usual = float(np.median([pose.rms_projector for pose in measured.poses]))
    for pose in measured.poses:
        if pose.rms_projector > _BAD * usual:
            warnings.warn(
                f"{pose.name} fits badly: its corners are off by {pose.rms_projector:.2f} "
                f"projector pixels, those of other poses by {usual:.2f}; photograph it again, or "
                "leave it out",
                LightMatrixWarning,
                stacklevel=3,
            )
