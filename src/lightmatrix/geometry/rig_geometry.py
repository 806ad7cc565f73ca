"""`RigGeometry`: where camera and projector stand, and what each pixel sees or lights."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import rq

from lightmatrix.errors import InputError
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import GEOMETRY, GEOMETRY_FORMAT
from lightmatrix.files.reading import parse_json, read_json, read_text
from lightmatrix.files.writing import atomic_file
from lightmatrix.paths import as_path
from lightmatrix.ranges import check_sides
from lightmatrix.regions import Region
from lightmatrix.reprs import jsonable, short_repr

Shape = tuple[int, int]
Array = NDArray[np.float64]

# Checks of the numbers that a geometry is made of.


def points_of(points: ArrayLike, size: int) -> NDArray[np.float64]:
    """Points as (n, size) float64."""
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != size:
        names = "(col, row)" if size == 2 else "(X, Y, Z)"
        raise InputError(
            f"points of shape {array.shape}", hint=f"give an array (n, {size}) of {names}"
        )
    return array


def numbers(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """An array of finite float64 of a shape."""
    size = " x ".join(map(str, shape))
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {what} holds no numbers", hint=f"give {size} numbers") from error
    if array.shape != shape or not np.isfinite(array).all():
        hint = f"give {size} finite numbers"
        raise InputError(f"the {what} has shape {array.shape}, or is not finite", hint=hint)
    return array


def intrinsics_of(values: ArrayLike, shape: Shape, device: str) -> NDArray[np.float64]:
    """K (3, 3) of a device with images of `shape`; other conventions of K are refused."""
    matrix = numbers(values, (3, 3), f"{device}'s K")
    if not np.allclose(matrix[[1, 2, 2], [0, 0, 1]], 0, atol=1e-6 * np.abs(matrix).max()):
        hint = "MATLAB stores it transposed: give [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
        raise InputError(f"the {device}'s K has numbers below its diagonal", hint=hint)
    focal = np.diag(matrix)[:2] / matrix[2, 2]
    check_sides(f"an image of the {device}", shape)
    rows, cols = shape
    # Lenses see between 170 and 0.3 degrees.
    if not ((focal > 0.04 * max(rows, cols)) & (focal < 200 * max(rows, cols))).all():
        raise InputError(
            f"the {device}'s K has focal lengths of {focal[0]:g} and {focal[1]:g}, for images of "
            f"{rows} x {cols} pixels",
            hint="give K in pixels: a focal length in millimetres divided by the size of a pixel; "
            "a normalised one times the width of the image",
        )
    return matrix


def distortion(values: ArrayLike, device: str) -> NDArray[np.float64]:
    """Five coefficients; OpenCV leaves out those at the end that are 0."""
    given = np.trim_zeros(np.ravel(np.asarray(values)), "b")
    if len(given) > 5:
        hint = "calibrate with OpenCV's model of five: k1, k2, p1, p2, k3"
        raise InputError(f"the {device}'s distortion has {len(given)} coefficients", hint=hint)
    return numbers(np.append(given, np.zeros(5 - len(given))), (5,), f"{device}'s distortion")


# Lens distortion, after Brown (1971), with OpenCV's five coefficients.
#
# A point at (x, y) on the plane of distance 1 in front of an ideal lens, r^2 = x^2 + y^2, is seen
# at
#
# x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
# y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y


def distort(points: NDArray[np.float64], lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points (n, 2) as (x, y) on the plane of distance 1 are seen through the lens (5,)."""
    if not lens.any():
        return points
    return _seen(points, lens)[0]


def undistort(points: NDArray[np.float64], lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 2) that the lens (5,) shows at `points`, by Newton's method.

    NaN where there is none, as beyond the field of view of a barrel distortion.
    """
    if not lens.any():
        return points
    ideal = points.copy()
    # Overflow and singular steps end as NaN.
    with np.errstate(all="ignore"):
        # Each step doubles the correct digits, so that strong distortions converge in about six.
        for _ in range(12):
            seen, (xx, xy, yy) = _seen(ideal, lens)
            dx, dy = (points - seen).T
            determinant = xx * yy - xy**2
            step = np.column_stack([yy * dx - xy * dy, xx * dy - xy * dx]) / determinant[:, None]
            ideal += step
            if not (np.abs(step) > 1e-9).any():
                break
        seen, (xx, xy, yy) = _seen(ideal, lens)
        # The lens leads back to within a thousandth of a pixel at a focal length of 10,000 pixels.
        # Where the determinant is negative, it has folded the image over.
        good = np.abs(seen - points).max(axis=1) < 1e-7
        good &= (xx * yy - xy**2 > 0) & (xx + yy > 0)
    return np.where(good[:, None], ideal, np.nan)


def through_lens(
    bend: Callable[[Array, Array], Array],
    points: ArrayLike,
    intrinsics: NDArray[np.float64],
    lens: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Pixels (n, 2) after a lens function that works on the plane of distance 1."""
    pixels = points_of(points, 2)
    if not lens.any():
        return pixels
    inverse = np.linalg.inv(intrinsics)
    plane = bend(pixels @ inverse[:2, :2].T + inverse[:2, 2], lens)
    return np.asarray(plane @ intrinsics[:2, :2].T + intrinsics[:2, 2])


def _seen(
    points: NDArray[np.float64], lens: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], ...]]:
    """Distorted points and the derivatives dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3 = lens
    x, y = points.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    # Derivative of `radial` by the square of the radius.
    slope = k1 + square * (2 * k2 + square * 3 * k3)
    seen = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return seen, (xx, mixed, yy)


# Projection matrices: their scale, and the lens, rotation and place that they consist of.


def normalised(matrix: ArrayLike, device: str) -> NDArray[np.float64]:
    """A projection matrix (3, 4) scaled so that its third row gives the distance along the axis."""
    whole = numbers(matrix, (3, 4), f"{device}'s projection matrix")
    values = np.linalg.svd(whole[:, :3], compute_uv=False)
    # A device at an infinite distance has no depth.
    if not values[-1] > 1e-12 * values[0]:
        raise InputError(
            f"the {device}'s projection matrix has no centre: its left 3 x 3 part is singular",
            hint="give the matrix of a perspective camera, K [R | t]",
        )
    # The determinant of K R is positive, so its sign tells front from back.
    return whole * (np.sign(np.linalg.det(whole[:, :3])) / np.linalg.norm(whole[2, :3]))


def decomposed(
    matrix: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """K (3, 3), R (3, 3) and t (3,) of a normalised projection matrix K [R | t]."""
    intrinsics, rotation = rq(matrix[:, :3])
    signs = np.where(np.diag(intrinsics) < 0, -1.0, 1.0)
    intrinsics, rotation = intrinsics * signs, rotation * signs[:, None]
    translation = np.linalg.solve(intrinsics, matrix[:, 3])
    return intrinsics / intrinsics[2, 2], rotation, translation * intrinsics[2, 2]


def centre_of(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centre (3,) of a device: the point that it projects nowhere."""
    return np.asarray(np.linalg.solve(matrix[:, :3], -matrix[:, 3]))


def binned_matrix(
    matrix: NDArray[np.float64], block: tuple[float, float], corner: Shape = (0, 0)
) -> NDArray[np.float64]:
    """The matrix (3, ...) for pixels cut from a corner (row, col), then binned by a block.

    The centre of the first block of b pixels lies at (b - 1) / 2, so that pixel centres stay at
    whole numbers. A block of 1 / n divides each pixel into n.
    """
    (down, across), (row, col) = block, corner
    change = np.array(
        [
            [1 / across, 0, ((1 - across) / 2 - col) / across],
            [0, 1 / down, ((1 - down) / 2 - row) / down],
            [0, 0, 1],
        ]
    )
    return change @ matrix


def projected(matrix: NDArray[np.float64], points: ArrayLike) -> NDArray[np.float64]:
    """Undistorted pixels (n, 2) as (col, row) of points (n, 3); NaN behind the device."""
    image = points_of(points, 3) @ matrix[:, :3].T + matrix[:, 3]
    with np.errstate(all="ignore"):
        return np.where(image[:, 2:] > 0, image[:, :2] / image[:, 2:], np.nan)


# Files of a rig's geometry: our own, in JSON, and those of OpenCV's FileStorage.


VERSION = 1
# Names that calibration programs give to the same things, in lower case without "_" and "-". The
# first of a line is ours.
_NAMES = {
    "camera_intrinsics": "cameraintrinsics camk camint cameramatrix1 cameramatrix k1 m1 kc kcam "
    "intrinsicscamera cameraintrinsic mtx1 ",
    # SLMaster's second camera has M2, R and T, and its projector M4, Rlp and Tlp.
    "projector_intrinsics": "projectorintrinsics projk projint m4 cameramatrix2 projectormatrix k2 "
    "m2 kp kproj intrinsicsprojector projectorintrinsic mtx2",
    # SLStudio has Kc and kc, which differ in their size only.
    "camera_distortion": "cameradistortion camkc camdist distcoeffs1 distcoeffs d1 dist1 distcam "
    "cameradistcoeffs cameradistortioncoefficients kc",
    "projector_distortion": "projectordistortion projkc projdist d4 distcoeffs2 d2 dist2 distproj "
    "projectordistcoeffs projectordistortioncoefficients kp",
    # One widely copied program misspells it.
    "rotation": "rotation rlp rproj rp r rotationmatrix roration",
    "translation": "translation tlp tproj tp t tvec",
    "camera_shape": "camerashape",
    "projector_shape": "projectorshape",
    "camera_size": "camerasize cameraresolution camsize camres imagesize imagesize1",
    "projector_size": "projectorsize projectorresolution projsize projres imagesize2",
    "rms": "rms stereoerror stereorms rmsstereo",
}
_NEEDED = ("camera_intrinsics", "projector_intrinsics", "rotation", "translation")


def read_geometry(
    file: Path, camera_shape: Shape | None, projector_shape: Shape | None
) -> dict[str, Any]:
    """Arguments of `RigGeometry`, or with "rotation" those of `from_intrinsics`."""
    text = read_text(file)
    start = text.lstrip()[:64]
    if start.startswith("{") and "opencv-matrix" not in text:
        content = parse_json(text, str(file))
        if not isinstance(content, dict) or "format" in content:
            fields = checked_fields(read_json(file, GEOMETRY_FORMAT, VERSION), str(file))
            given = {"camera_shape": camera_shape, "projector_shape": projector_shape}
            return fields | {name: shape for name, shape in given.items() if shape is not None}
        values = {name: _array(value) for name, value in content.items()}
    elif start.startswith(("<?xml", "<opencv_storage", "%YAML", "---", "{")):
        values = _opencv_values(file, text)
    else:
        values = {}
    return _arguments(file, values, camera_shape, projector_shape)


def checked_fields(content: Any, file: str) -> dict[str, Any]:
    """The fields of a geometry in an object of JSON, in which others are ignored."""
    names = set(RigGeometry.__dataclass_fields__)
    given = content if isinstance(content, dict) else {}
    fields = {name: value for name, value in given.items() if name in names}
    missing = sorted(names - {"units", "rms", "projector_mirrored"} - set(fields))
    units, rms = fields.get("units"), fields.get("rms", {})
    named = isinstance(rms, dict) and all(type(value) in (int, float) for value in rms.values())
    if missing or not isinstance(units, str | None) or not named:
        wrong = f"lacks {', '.join(missing)}" if missing else "its units or rms are damaged"
        raise InputError(f"{file}: {wrong}", hint="write it again with `lightmatrix calibrate`")
    return fields


def _array(value: Any) -> NDArray[Any] | None:
    """A value as an array, or None if it holds anything but numbers."""
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.size else None


def _opencv_values(file: Path, text: str) -> dict[str, NDArray[Any] | None]:
    """All matrices and numbers at the top of a file of OpenCV's FileStorage."""
    cv2 = load_opencv(f"{file}: a file of OpenCV", "shape")
    values: dict[str, NDArray[Any] | None] = {}
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        for name in root.keys():  # noqa: SIM118 (a FileNode is no dict)
            node = root.getNode(name)
            if node.isReal() or node.isInt():
                values[name] = _array(node.real())
            elif node.isSeq() and node.size() <= 64:
                values[name] = _array([node.at(k).real() for k in range(node.size())])
            elif node.isMap():
                # A map may be a group of anything.
                with suppress(cv2.error, SystemError, TypeError):
                    values[name] = _array(node.mat())
        storage.release()
    except (cv2.error, SystemError, UnicodeError, TypeError) as error:
        raise InputError(f"{file}: OpenCV cannot read it", hint="is the file damaged?") from error
    return values


def _arguments(
    file: Path,
    values: dict[str, NDArray[Any] | None],
    camera_shape: Shape | None,
    projector_shape: Shape | None,
) -> dict[str, Any]:
    """Arguments of `from_intrinsics` from the values of a calibration program."""
    plain: dict[str, list[str]] = {}
    for name, value in values.items():
        if value is not None:
            plain.setdefault(name.lower().replace("_", "").replace("-", ""), []).append(name)
    found: dict[str, Any] = {}
    for name, others in _NAMES.items():
        fitting: list[Any] = [
            values[known] for other in others.split() for known in plain.get(other, ())
        ]
        # K has 3 x 3 numbers; a distortion that goes by the same name has not.
        lens = name.endswith("distortion")
        if name.endswith(("intrinsics", "distortion")):
            fitting = [each for each in fitting if (each.shape == (3, 3)) != lens]
        if fitting:
            found[name] = fitting[0]
    missing = [name.replace("_", " ") for name in _NEEDED if name not in found]
    if len(missing) == len(_NEEDED):
        raise InputError(
            f"{file}: holds no geometry of a rig",
            hint="give a file of `lightmatrix calibrate`, or of OpenCV with camera and projector "
            "matrices, R and T",
        )
    if missing:
        hint = "name the matrices cam_K, proj_K, R and T, and the distortions cam_kc and proj_kc"
        raise InputError(f"{file}: names no {' and no '.join(missing)}", hint=hint)
    rms = found.pop("rms", None)
    if rms is not None and rms.size == 1:
        found["rms"] = {"stereo": float(rms.ravel()[0])}
    for device, given in (("camera", camera_shape), ("projector", projector_shape)):
        # OpenCV states a size as width and height.
        size = found.pop(f"{device}_size", None)
        stated = found.get(f"{device}_shape", None if size is None else size.ravel()[::-1])
        if stated is None and given is None:
            hint = f"give {device}_shape, or write {device}_size: width, height into the file"
            raise InputError(f"{file}: does not state the image size of the {device}", hint=hint)
        sides: Any = [] if stated is None else np.ravel(stated)
        found[f"{device}_shape"] = given or tuple(map(int, sides))
    return found


@dataclass(frozen=True, eq=False)
class RigGeometry:
    """The geometry of a projector-camera rig.

    Points of the world are (X, Y, Z) in the unit `units`. Points of an image are (col, row) in
    pixels, with pixel centres at whole numbers, as in OpenCV. A projector is a camera whose light
    runs backwards, so it has a projection matrix too. Coefficients of distortion stand in OpenCV's
    order: k1, k2, p1, p2, k3.

    Parameters
    ----------
    camera_matrix : (3, 4) array-like
        Projection of the camera, K [R | t]: (X, Y, Z, 1) to w (col, row, 1) without distortion. It
        is scaled so that w is the distance along the camera's axis, and positive in front of it.
    projector_matrix : (3, 4) array-like
        The same of the projector.
    camera_shape, projector_shape : (rows, cols)
        Size of their images in pixels.
    camera_distortion, projector_distortion : (5,) float64
        Distortion of their lenses; all zeros by default.
    units : str, optional
        Unit of length, such as "mm"; None if unknown.
    rms : mapping
        Root mean square of the residuals of a calibration, in pixels, by name.
    projector_mirrored : bool
        Whether the camera sees the projector's image mirrored, as behind a screen or in a mirror.
        `projector_matrix` then belongs to columns that are counted from the right.

    Raises
    ------
    InputError
        On matrices of another shape, infinite numbers, image sizes below 1, a device without a
        centre, and a camera and a projector with the same centre, which cannot measure depth.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> camera = [[100, 0, 32, 0], [0, 100, 32, 0], [0, 0, 1, 0]]
    >>> projector = [[100, 0, 32, -50], [0, 100, 32, 0], [0, 0, 1, 0]]
    >>> rig = lm.RigGeometry(camera, projector, (64, 64), (64, 64))
    >>> rig.triangulate([[42, 32]], [[32, 32]]).round(6).tolist()
    [[0.5, 0.0, 5.0]]
    """

    camera_matrix: NDArray[np.float64]
    projector_matrix: NDArray[np.float64]
    camera_shape: Shape
    projector_shape: Shape
    camera_distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(5))
    projector_distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(5))
    units: str | None = None
    rms: Mapping[str, float] = field(default_factory=dict)
    projector_mirrored: bool = False

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for device in ("camera", "projector"):
            matrix = normalised(getattr(self, f"{device}_matrix"), device)
            lens = distortion(getattr(self, f"{device}_distortion"), device)
            shape = getattr(self, f"{device}_shape")
            check_sides(f"an image of the {device}", shape)
            object.__setattr__(self, f"{device}_matrix", matrix)
            object.__setattr__(self, f"{device}_distortion", lens)
            object.__setattr__(self, f"{device}_shape", tuple(map(int, shape)))
        # Less than 1e-9 of the distance to the origin is rounding.
        centres = np.stack([centre_of(self.camera_matrix), centre_of(self.projector_matrix)])
        if np.linalg.norm(centres[1] - centres[0]) <= 1e-9 * np.abs(centres).max():
            raise InputError(
                "camera and projector have the same centre, so depth cannot be measured",
                hint="check that the two projection matrices differ and share one world frame",
            )

    @classmethod
    def from_intrinsics(
        cls,
        camera_intrinsics: ArrayLike,
        projector_intrinsics: ArrayLike,
        rotation: ArrayLike,
        translation: ArrayLike,
        camera_shape: Shape,
        projector_shape: Shape,
        *,
        camera_distortion: ArrayLike = (0, 0, 0, 0, 0),
        projector_distortion: ArrayLike = (0, 0, 0, 0, 0),
        units: str | None = None,
        rms: Mapping[str, float] | None = None,
    ) -> Self:
        """The geometry in the camera's frame: x to the right, y down, z forwards.

        Parameters
        ----------
        camera_intrinsics, projector_intrinsics : (3, 3) array-like
            K of camera and projector.
        rotation, translation : (3, 3) and (3,) array-like
            They lead from the camera's frame to the projector's: x_projector = R x_camera + t.
        camera_shape, projector_shape, camera_distortion, projector_distortion, units, rms
            As in the class; coefficients of distortion that are left out are 0.

        Returns
        -------
        RigGeometry
            Errors are those of the class.
        """
        turn = numbers(rotation, (3, 3), "rotation")
        moved = numbers(np.ravel(np.asarray(translation)), (3,), "translation")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
            hint = "give R with R R' = 1 and det R = 1"
            raise InputError("the rotation is no rotation matrix", hint=hint)
        camera = intrinsics_of(camera_intrinsics, camera_shape, "camera")
        projector = intrinsics_of(projector_intrinsics, projector_shape, "projector")
        return cls(
            camera @ np.eye(3, 4), projector @ np.column_stack([turn, moved]), camera_shape,
            projector_shape, np.asarray(camera_distortion), np.asarray(projector_distortion), units,
            dict(rms or {}),
        )  # fmt: skip

    @property
    def camera_intrinsics(self) -> NDArray[np.float64]:
        """K of the camera, (3, 3)."""
        return decomposed(self.camera_matrix)[0]

    @property
    def projector_intrinsics(self) -> NDArray[np.float64]:
        """K of the projector, (3, 3)."""
        return decomposed(self.projector_matrix)[0]

    @property
    def rotation(self) -> NDArray[np.float64]:
        """R (3, 3) from the camera's frame to the projector's: x_projector = R x_camera + t."""
        return decomposed(self.projector_matrix)[1] @ decomposed(self.camera_matrix)[1].T

    @property
    def translation(self) -> NDArray[np.float64]:
        """The translation t (3,) from the camera's frame to the projector's, in `units`."""
        at_camera = decomposed(self.camera_matrix)[2]
        return decomposed(self.projector_matrix)[2] - self.rotation @ at_camera

    @property
    def camera_centre(self) -> NDArray[np.float64]:
        """The camera's centre (3,) in the world."""
        return centre_of(self.camera_matrix)

    @property
    def projector_centre(self) -> NDArray[np.float64]:
        """The projector's centre (3,) in the world."""
        return centre_of(self.projector_matrix)

    @property
    def baseline(self) -> float:
        """Distance from the camera to the projector, in `units`."""
        return float(np.linalg.norm(self.projector_centre - self.camera_centre))

    def fundamental_matrix(self) -> NDArray[np.float64]:
        """F (3, 3), of Frobenius norm 1, for undistorted pixels.

        F (col, row, 1) of a camera pixel is its epipolar line (a, b, c) on the projector: the
        pixels with a col + b row + c = 0.
        """
        through = self.projector_matrix[:, :3] @ np.linalg.inv(self.camera_matrix[:, :3])
        epipole = self.projector_matrix @ np.append(self.camera_centre, 1)
        x, y, z = epipole / np.linalg.norm(epipole)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix = cross @ through
        return np.asarray(matrix / np.linalg.norm(matrix))

    def undistort_camera(self, points: ArrayLike) -> NDArray[np.float64]:
        """Where an ideal lens shows camera pixels (n, 2) as (col, row); NaN where it cannot."""
        return through_lens(undistort, points, self.camera_intrinsics, self.camera_distortion)

    def undistort_projector(self, points: ArrayLike) -> NDArray[np.float64]:
        """Where an ideal lens shows projector pixels (n, 2) as (col, row); NaN where it cannot."""
        seen = self._unmirrored(points_of(points, 2))
        return through_lens(undistort, seen, self.projector_intrinsics, self.projector_distortion)

    def _unmirrored(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Projector pixels (n, 2) counted from the side of `projector_matrix`, or back."""
        if not self.projector_mirrored:
            return points
        return np.column_stack([self.projector_shape[1] - 1 - points[:, 0], points[:, 1]])

    def project_camera(self, points: ArrayLike) -> NDArray[np.float64]:
        """Where the camera sees points (n, 3) of the world: (n, 2) as (col, row), distorted."""
        ideal = projected(self.camera_matrix, points)
        return through_lens(distort, ideal, self.camera_intrinsics, self.camera_distortion)

    def project_projector(self, points: ArrayLike) -> NDArray[np.float64]:
        """The projector pixels (n, 2) as (col, row), distorted, that light points (n, 3)."""
        ideal = projected(self.projector_matrix, points)
        lit = through_lens(distort, ideal, self.projector_intrinsics, self.projector_distortion)
        return self._unmirrored(lit)

    def camera_rays(self, points: ArrayLike) -> NDArray[np.float64]:
        """Where camera pixels (n, 2) as (col, row) look: (n, 3), of depth 1 along the axis."""
        ideal = self.undistort_camera(points)
        towards = np.linalg.inv(self.camera_matrix[:, :3])
        return np.asarray(ideal @ towards[:, :2].T + towards[:, 2])

    def triangulate(
        self, camera_points: ArrayLike, projector_points: ArrayLike
    ) -> NDArray[np.float64]:
        """The points of the world that camera pixels see and projector pixels light.

        A point lies on the ray of its camera pixel, where its image on the projector comes nearest
        to the projector pixel: the foot of the perpendicular on the epipolar line.

        Parameters
        ----------
        camera_points, projector_points : (n, 2) array-like
            Pixels as (col, row), fractions allowed, as the devices show them.

        Returns
        -------
        (n, 3) float64
            Points of the world in `units`; NaN where a pixel is NaN or the rays are parallel.

        Raises
        ------
        InputError
            If the points are not two arrays (n, 2) of equal length.
        """
        seen, lit = points_of(camera_points, 2), self.undistort_projector(projector_points)
        if len(seen) != len(lit):
            raise InputError(
                f"{len(seen)} camera pixels and {len(lit)} projector pixels",
                hint="give one projector pixel for each camera pixel",
            )
        # The image of a ray on the projector is a + s b for the depth s.
        centre, rays, matrix = self.camera_centre, self.camera_rays(seen), self.projector_matrix
        a = matrix @ np.append(centre, 1)
        b = rays @ matrix[:, :3].T
        line = np.cross(a, b)
        with np.errstate(all="ignore"):
            away = (lit * line[:, :2]).sum(axis=1) + line[:, 2]
            foot = lit - (away / (line[:, :2] ** 2).sum(axis=1))[:, None] * line[:, :2]
            # (a + s b) is a multiple of (foot, 1): two equations for s, both exact.
            left = b[:, :2] - foot * b[:, 2:]
            right = foot * a[2] - a[:2]
            depth = (left * right).sum(axis=1) / (left**2).sum(axis=1)
            points = centre + depth[:, None] * rays
        return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)

    def depth(self, points: ArrayLike) -> NDArray[np.float64]:
        """Distance (n,) of points (n, 3) from the camera along its axis, in `units`."""
        axis = self.camera_matrix[2]
        return np.asarray(points_of(points, 3) @ axis[:3] + axis[3])

    def scaled(self, camera: int | Shape = 1, projector: int | Shape = 1) -> RigGeometry:
        """The geometry for images that are binned by blocks of (rows, cols) pixels.

        Parameters
        ----------
        camera, projector : int or (int, int)
            Rows and columns of a block, as in `Capture.bin`; pixels that fill no block are cut off.

        Returns
        -------
        RigGeometry

        Raises
        ------
        InputError
            If a block is smaller than 1 pixel or larger than the image.
        """
        changed: dict[str, Any] = {}
        for device, factor in (("camera", camera), ("projector", projector)):
            shape = getattr(self, f"{device}_shape")
            block = (factor, factor) if isinstance(factor, int) else factor
            small = (shape[0] // max(block[0], 1), shape[1] // max(block[1], 1))
            if min(block) < 1 or min(small) < 1:
                raise InputError(
                    f"{device} blocks of {block[0]} x {block[1]} pixels of {shape[0]} x {shape[1]}",
                    hint="use blocks of at least 1 pixel that fit into the image",
                )
            changed[f"{device}_shape"] = small
            # Counted from the right, the columns that are cut off come first.
            cut = shape[1] - small[1] * block[1] if self.projector_mirrored else 0
            corner = (0, cut if device == "projector" else 0)
            matrix = binned_matrix(getattr(self, f"{device}_matrix"), block, corner)
            changed[f"{device}_matrix"] = matrix
        return replace(self, **changed)

    def cropped(self, corner: Shape, shape: Shape) -> RigGeometry:
        """The geometry for photographs of which a rectangle from corner (row, col) is cut out."""
        Region(corner, shape, self.camera_shape)  # Refuses a crop beyond the photographs.
        cut = binned_matrix(self.camera_matrix, (1, 1), corner)
        return replace(self, camera_matrix=cut, camera_shape=shape)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the geometry as JSON, which `load` reads.

        Raises
        ------
        OutputError
            If the file exists and `overwrite` is not set, or cannot be written.
        """
        content = {"format": GEOMETRY_FORMAT, "version": VERSION, **self.as_dict()}
        with atomic_file(path, GEOMETRY, overwrite=overwrite) as part:
            part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        camera_shape: Shape | None = None,
        projector_shape: Shape | None = None,
    ) -> Self:
        """Read a geometry that `save`, or a calibration with OpenCV, wrote.

        Parameters
        ----------
        path : str or Path
            A JSON file of `save`, or an XML, YAML or JSON file of OpenCV's FileStorage.
        camera_shape, projector_shape : (rows, cols), optional
            Image sizes, for files of OpenCV that do not state them.

        Returns
        -------
        RigGeometry

        Raises
        ------
        InputError
            If the file is missing, holds no geometry, or states no image size and none is given.
        MissingExtraError
            If a file of OpenCV is read and OpenCV is not installed.
        """
        file = as_path(path)
        content = read_geometry(file, camera_shape, projector_shape)
        try:
            return cls.from_intrinsics(**content) if "rotation" in content else cls(**content)
        except InputError as error:
            raise InputError(f"{file}: {error.message}", hint=error.hint) from error

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, JSON-ready."""
        return {name: jsonable(getattr(self, name)) for name in self.__dataclass_fields__}
