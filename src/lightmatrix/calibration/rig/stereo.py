"""The rig's geometry from the corners of a board in several poses: Zhang's method, for two devices.

The projector counts as a second camera. OpenCV calibrates each by itself, then both together. Five
poses do not support more than two coefficients of radial distortion, so tangential terms and the
third coefficient stay 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.calibration.rig.board import BoardCorners
from lightmatrix.files.extras import load_opencv

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
