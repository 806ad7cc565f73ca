"""One adjustment of all cameras and projectors of a rig to a board in several poses.

A camera shows the corners of the board with the errors of finding them, about a tenth of a pixel. A
projector sees nothing: its pixel belongs to the place that the camera took for the corner. So it is
compared with the image of the point where the camera's ray meets the board, not with that of the
corner. Such matches hold to a few hundredths of a pixel, and they tell how the devices stand to
each other; compared with the corners, they would take over the camera's errors.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.extras import load_opencv
from lightmatrix.geometry.rig_geometry import (
    Array,
    RigGeometry,
    decomposed,
    distort,
    normalised,
    undistort,
)

Size = tuple[int, int]
# Numbers of a device: two focal lengths, the principal point, two coefficients of distortion, and
# the rotation vector and translation from the frame of the first camera to its own; of a pose of
# the board, the last two.
_OWN, _POSE = 12, 6


@dataclass(frozen=True, eq=False)
class Fit:
    """The devices, cameras first, and how far they are from what they show."""

    devices: Array
    poses: Array
    # (cameras, poses, n, 2) in pixels: where each camera puts the corners less where they are seen.
    seen_errors: Array
    # (cameras, projectors, poses, n, 2): the same of the projector pixels that light these places;
    # NaN where they are not known.
    lit_errors: Array
    # (cameras, projectors, poses, n): those that count.
    used: NDArray[np.bool_]
    # Standard errors of each device's turn in degrees and of its place, (devices, 2).
    deviations: Array
    # Whether a corner lies behind a device.
    behind: bool

    def rms(self) -> dict[str, float]:
        """Root mean squares of what cameras and projectors are off by, in pixels."""
        seen, lit = self.seen_errors[self.used.any(axis=1)], self.lit_errors[self.used]
        return {"camera": rms_of(seen), "projector": rms_of(lit)}

    def geometry(self, camera: int, projector: int, shapes: tuple[Size, Size]) -> RigGeometry:
        """The geometry of a pair, in the frame of the first camera."""
        pair = self.devices[camera], self.devices[len(self.seen_errors) + projector]
        one, other = (_intrinsics(d) @ np.column_stack([_turn(d), d[9:]]) for d in pair)
        return RigGeometry(one, other, *shapes, _lens(pair[0]), _lens(pair[1]))


def rms_of(errors: Array) -> float:
    """Root mean square of the lengths of errors (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def largest_turn(poses: Array) -> float:
    """The largest angle between two poses of the board, in degrees."""
    normals = scipy.spatial.transform.Rotation.from_rotvec(poses[:, :3]).as_matrix()[:, :, 2]
    return float(np.degrees(np.arccos(np.abs(normals @ normals.T).clip(0, 1).min())))


def fit_board(seen: Array, lit: Array, board: Array, camera_shape: Size) -> Fit:
    """Fit all devices to all poses, and leave out corners that are far off.

    `seen` (cameras, poses, n, 2) are the corners in the cameras' images, `lit` (cameras,
    projectors, poses, n, 2) the projector pixels that light those places, as (col, row), NaN where
    unknown; the corners are `board` (n, 3). The first camera, whose size is given, sees each pose.
    """
    devices, poses = _start(seen, lit, board, camera_shape)
    if not np.isfinite(devices).all():
        raise InputError("no geometry explains the corners", hint="do poses and patterns match?")
    cameras, projectors = lit.shape[:2]
    # Each camera, with itself and with each projector.
    pairs = [(one, one) for one in range(cameras)]
    pairs += [(c, cameras + p) for c in range(cameras) for p in range(projectors)]
    places = np.concatenate([seen, lit.reshape(-1, *seen.shape[1:])])
    use = np.asarray(np.isfinite(places).all(axis=-1))
    use &= use[[one for one, _ in pairs]]
    of_device = np.array([other for _, other in pairs])
    weights = np.ones(len(devices))
    # On real boards four rounds were enough.
    for number in range(8):
        # At first a pose in which something moved must not bend all others to itself.
        loss = "linear" if number else "soft_l1"
        system = _System(pairs, seen, places, use, weights[of_device], board)
        devices, poses, deviations = system.solved(devices, poses, loss)
        errors = system.errors(devices, poses)
        sizes = np.linalg.norm(errors, axis=-1)
        # What is known better counts more. Exact corners are no better than 0.005 pixels.
        of_devices = [of_device == one for one in range(len(devices))]
        usual = np.array([max(float(np.median(sizes[d][use[d]])), 0.005) for d in of_devices])
        # Random errors reach five times the median once in 10^10; where a board is bent or glares,
        # corners are off by more.
        kept = use & (sizes <= 5 * usual[of_device, None, None])
        # A pose needs four corners to be placed at all.
        kept[:cameras] |= use[:cameras] & (kept[:cameras].sum(axis=-1, keepdims=True) < 4)
        kept &= kept[[one for one, _ in pairs]]
        settled = np.array_equal(kept, use) and np.allclose(weights * usual, 1, atol=0.1)
        use, weights = kept, 1 / usual
        # No geometry explains corners that are off by more.
        if settled or usual.max() > 3:
            break
    turns = scipy.spatial.transform.Rotation.from_rotvec(poses[:, :3]).as_matrix()
    corners = board @ turns.transpose(0, 2, 1) + poses[:, None, 3:]
    depths = [(corners @ _turn(devices[d]).T + devices[d][9:])[..., 2] for d in of_device]
    behind = bool((np.stack(depths)[use] <= 0).any())
    lit_errors, used = errors[cameras:].reshape(lit.shape), use[cameras:].reshape(lit.shape[:-1])
    return Fit(devices, poses, errors[:cameras], lit_errors, used, deviations, behind)


@dataclass(frozen=True, eq=False)
class _System:
    """The errors of one set of corners, weighted."""

    # A camera with itself, or with a projector, by their numbers.
    pairs: list[tuple[int, int]]
    seen: Array
    # (pairs, poses, n, 2) and (pairs, poses, n): where the second shows what the first sees.
    places: Array
    use: NDArray[np.bool_]
    weights: Array
    board: Array

    def errors(self, devices: Array, poses: Array) -> Array:
        """How far all pairs are from their places, of the same shape; NaN where it is not known."""
        turns = scipy.spatial.transform.Rotation.from_rotvec(poses[:, :3]).as_matrix()
        corners = self.board @ turns.transpose(0, 2, 1) + poses[:, None, 3:]
        normals = turns[:, :, 2]
        offsets = (normals * poses[:, 3:]).sum(axis=1)
        met = []
        for camera, places in zip(devices, self.seen, strict=False):
            plane = (places.reshape(-1, 2) - camera[2:4]) / camera[:2]
            ideal = undistort(plane, _lens(camera))
            rays = np.column_stack([ideal, np.ones(len(ideal))]) @ _turn(camera)
            rays = rays.reshape(*places.shape[:2], 3)
            centre = -camera[9:] @ _turn(camera)
            ahead = (offsets - normals @ centre)[:, None] / (rays @ normals[:, :, None])[..., 0]
            met.append(centre + ahead[..., None] * rays)
        shown = [
            _image(devices[other], corners if one == other else met[one])
            for one, other in self.pairs
        ]
        return np.asarray(shown - self.places)

    def solved(self, devices: Array, poses: Array, loss: str) -> tuple[Array, Array, Array]:
        """The devices and poses of least squares, and the standard errors of the devices."""
        known = np.concatenate([devices.ravel(), poses.ravel()])
        # The first camera stands where it stands.
        free = np.ones(len(known), np.bool_)
        free[_POSE:_OWN] = False

        def whole(numbers: Array) -> tuple[Array, Array]:
            every = known.copy()
            every[free] = numbers
            return every[: devices.size].reshape(-1, _OWN), every[devices.size :].reshape(-1, _POSE)

        def distances(numbers: Array) -> Array:
            weighted = self.errors(*whole(numbers)) * self.weights[:, None, None, None]
            return np.asarray(weighted[self.use].ravel())

        # Steps that turn a point behind a device are not finite, and are shortened.
        with np.errstate(all="ignore"):
            found = scipy.optimize.least_squares(
                distances, known[free], x_scale="jac", max_nfev=100, loss=loss
            )
        spare = max(len(found.fun) - int(free.sum()), 1)
        variances = np.zeros(len(known))
        covariance = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)
        variances[free] = np.diag(covariance) * 2 * found.cost / spare
        of_poses = variances[: devices.size].reshape(-1, 4, 3)[:, 2:]
        return *whole(found.x), np.sqrt(of_poses.sum(axis=-1)) * (180 / np.pi, 1)


def _start(seen: Array, lit: Array, board: Array, camera_shape: Size) -> tuple[Array, Array]:
    """The first camera by OpenCV, without a lens, and the others from the corners in its frame."""
    cv2 = load_opencv("calibrating a rig", "shape")
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    use = np.isfinite(seen[0]).all(axis=-1)
    objects = [board[each].astype(np.float32) for each in use]
    images = [each[own].astype(np.float32) for each, own in zip(seen[0], use, strict=True)]
    _, matrix, _, turns, shifts = cv2.calibrateCamera(
        objects, images, camera_shape[::-1], None, None, flags=flags
    )
    poses = np.hstack([np.reshape(turns, (-1, 3)), np.reshape(shifts, (-1, 3))])
    # Zhang's Fig. 4: the error of the focal length falls steeply with the angle between two boards,
    # and is several times its best below 10 degrees.
    if (turn := largest_turn(poses)) < 10:
        raise InputError(
            f"the poses are nearly parallel: their largest angle is {turn:.1f} degrees",
            hint="add poses with the board tilted by 20 to 40 degrees to the left, right, up, down",
        )
    corners = [board @ _turn(np.append(np.zeros(6), pose)).T + pose[3:] for pose in poses]
    devices = [_numbers(matrix, np.eye(3), np.zeros(3))]
    for places in (*seen[1:, None], *np.moveaxis(lit, 1, 0)):
        known = np.isfinite(places).all(axis=-1)
        points = np.broadcast_to(corners, (*known.shape, 3))
        devices.append(_resected(points[known], places[known]))
    return np.stack(devices), poses


def _resected(points: Array, places: Array) -> Array:
    """The numbers of a device that shows points (n, 3) at places (n, 2).

    The direct linear transformation (Hartley & Zisserman 2004, chapter 7), without skew. Unlike a
    calibration that starts from an axis through the middle of the image, it finds projectors that
    shift theirs.
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
    moved = np.column_stack([np.eye(3) / scale, -middle / scale])
    whole = back @ matrix @ np.vstack([moved, [0, 0, 0, 1]])
    return _numbers(*decomposed(normalised(whole, "projector")))


def _numbers(intrinsics: Array, turn: Array, shift: Array) -> Array:
    vector = scipy.spatial.transform.Rotation.from_matrix(turn).as_rotvec()
    focal = np.diag(intrinsics)[:2]
    return np.concatenate([focal, intrinsics[:2, 2], np.zeros(2), vector, shift])


def _intrinsics(device: Array) -> Array:
    focal, middle = device[:2], device[2:4]
    return np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1]])


def _turn(device: Array) -> Array:
    return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(device[6:9]).as_matrix())


def _lens(device: Array) -> Array:
    return np.append(device[4:6], np.zeros(3))


def _image(device: Array, points: Array) -> Array:
    """Where a device shows points (..., 3), (..., 2)."""
    own = points.reshape(-1, 3) @ _turn(device).T + device[9:]
    plane = distort(own[:, :2] / own[:, 2:], _lens(device))
    return (plane * device[:2] + device[2:4]).reshape(*points.shape[:-1], 2)
