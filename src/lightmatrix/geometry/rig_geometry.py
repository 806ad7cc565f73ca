"""`RigGeometry`: where camera and projector stand, and what each pixel sees or lights."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import FolderKind, geometry_kind
from lightmatrix.files.reading import errors_naming
from lightmatrix.files.writing import atomic_file, atomic_folder
from lightmatrix.geometry.rig_files import read_rig, write_rig
from lightmatrix.paths import as_path
from lightmatrix.ranges import check_number, check_sides
from lightmatrix.regions import Region
from lightmatrix.reprs import ShortRepr, jsonable

Size = tuple[int, int]
Array = NDArray[np.float64]

# Checks of the numbers that a geometry is made of.


def points_of(points: ArrayLike, size: int) -> Array:
    """Points as (n, size) float64."""
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != size:
        names = "(col, row)" if size == 2 else "(X, Y, Z)"
        hint = f"give an array (n, {size}) of {names}"
        raise InputError(f"points of shape {array.shape}", hint=hint)
    return array


def numbers(values: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
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


def intrinsics_of(values: ArrayLike, shape: Size, device: str) -> Array:
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


def distortion(values: ArrayLike, device: str) -> Array:
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


def distort(points: Array, lens: Array) -> Array:
    """Where points (n, 2) as (x, y) on the plane of distance 1 are seen through the lens (5,)."""
    if not lens.any():
        return points
    return _seen(points, lens)[0]


def undistort(points: Array, lens: Array) -> Array:
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
    bend: Callable[[Array, Array], Array], points: ArrayLike, intrinsics: Array, lens: Array
) -> Array:
    """Pixels (n, 2) after a lens function that works on the plane of distance 1."""
    pixels = points_of(points, 2)
    if not lens.any():
        return pixels
    inverse = np.linalg.inv(intrinsics)
    plane = bend(pixels @ inverse[:2, :2].T + inverse[:2, 2], lens)
    return np.asarray(plane @ intrinsics[:2, :2].T + intrinsics[:2, 2])


def _seen(points: Array, lens: Array) -> tuple[Array, tuple[Array, ...]]:
    """Distorted points and the derivatives dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3 = lens
    x, y = points.T
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    # Derivative of `radial` by the square of the radius.
    slope = k1 + square * (2 * k2 + square * 3 * k3)
    right = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    mixed = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return np.column_stack([right, down]), (xx, mixed, yy)


# Projection matrices: their scale, and the lens, rotation and place that they consist of.


def normalised(matrix: ArrayLike, device: str) -> Array:
    """A projection matrix (3, 4) scaled so that its third row gives the distance along the axis."""
    whole = numbers(matrix, (3, 4), f"{device}'s projection matrix")
    values = np.linalg.svd(whole[:, :3], compute_uv=False)
    # A device at an infinite distance has no depth.
    if not values[-1] > 1e-12 * values[0]:
        hint = "give the matrix of a perspective camera, K [R | t]"
        where = f"the {device}'s projection matrix has no centre: its left 3 x 3 part is singular"
        raise InputError(where, hint=hint)
    # The determinant of K R is positive, so its sign tells front from back.
    return whole * (np.sign(np.linalg.det(whole[:, :3])) / np.linalg.norm(whole[2, :3]))


def decomposed(matrix: Array) -> tuple[Array, Array, Array]:
    """K (3, 3), R (3, 3) and t (3,) of a normalised projection matrix K [R | t]."""
    intrinsics, rotation = scipy.linalg.rq(matrix[:, :3])
    signs = np.where(np.diag(intrinsics) < 0, -1.0, 1.0)
    intrinsics, rotation = intrinsics * signs, rotation * signs[:, None]
    translation = np.linalg.solve(intrinsics, matrix[:, 3])
    return intrinsics / intrinsics[2, 2], rotation, translation * intrinsics[2, 2]


def centre_of(matrix: Array) -> Array:
    """The centre (3,) of a device: the point that it projects nowhere."""
    return np.asarray(np.linalg.solve(matrix[:, :3], -matrix[:, 3]))


def binned_matrix(matrix: Array, block: Sequence[float], corner: Sequence[float] = (0, 0)) -> Array:
    """The matrix (3, ...) for pixels cut from a corner (row, col), then binned by a block.

    The centre of the first block of b pixels lies at (b - 1) / 2, so that pixel centres stay at
    whole numbers. A block of 1 / n divides each pixel into n.
    """
    (down, across), (row, col) = block, corner
    x, y = ((1 - across) / 2 - col) / across, ((1 - down) / 2 - row) / down
    change = np.array([[1 / across, 0, x], [0, 1 / down, y], [0, 0, 1]])
    return change @ matrix


def projected(matrix: Array, points: ArrayLike) -> Array:
    """Undistorted pixels (n, 2) as (col, row) of points (n, 3); NaN behind the device."""
    image = points_of(points, 3) @ matrix[:, :3].T + matrix[:, 3]
    with np.errstate(all="ignore"):
        return np.where(image[:, 2:] > 0, image[:, :2] / image[:, 2:], np.nan)


# Columns of diamond pixels are twice as far apart as their rows.
DIAMOND_ROWS = 2.0


def staggered(points: Array, stagger: float, height: float = 1.0) -> Array:
    """Pixels (..., 2) as (col, row) moved to where they lie: odd rows by `stagger` columns.

    A fraction of a row stands for a mean of light over `height` rows, an unknown one for all rows.
    """
    if not stagger:
        return points
    ends = points[..., 1, None] + np.array([0.5, -0.5]) * height
    # The integral of a function that is 1 over odd rows and 0 over even ones.
    area = np.floor((ends + 0.5) / 2) + np.clip((ends + 0.5) % 2 - 1, 0, 1)
    odd = np.nan_to_num((area[..., 0] - area[..., 1]) / height, nan=0.5)
    return points + np.stack([stagger * odd, np.zeros_like(odd)], axis=-1)


def checked_fields(content: Any, file: str) -> dict[str, Any]:
    """The fields of a geometry in an object of JSON, in which others are ignored."""
    names = set(RigGeometry.__dataclass_fields__)
    given = content if isinstance(content, dict) else {}
    fields = {name: value for name, value in given.items() if name in names}
    later = {"projector_mirrored", "projector_stagger"}
    missing = sorted(names - {"units", "rms"} - later - set(fields))
    units, rms = fields.get("units"), fields.get("rms", {})
    named = isinstance(rms, dict) and all(type(value) in (int, float) for value in rms.values())
    if missing or not isinstance(units, str | None) or not named:
        wrong = f"lacks {', '.join(missing)}" if missing else "its units or rms are damaged"
        raise InputError(f"{file}: {wrong}", hint="write it again with `lightmatrix calibrate`")
    return fields


@dataclass(frozen=True, eq=False, repr=False)
class RigGeometry(ShortRepr):
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
    projector_stagger : float
        Of diamond pixels, as of TI's LightCrafter 4500: by how many columns odd rows (1, 3, ...)
        stand to the right of even ones, 0.5 or -0.5. A place is then where a column of even rows
        would lie, see `projector_places`; rows are half as far apart as columns.

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

    camera_matrix: Array
    projector_matrix: Array
    camera_shape: Size
    projector_shape: Size
    camera_distortion: Array = field(default_factory=lambda: np.zeros(5))
    projector_distortion: Array = field(default_factory=lambda: np.zeros(5))
    units: str | None = None
    rms: Mapping[str, float] = field(default_factory=dict)
    projector_mirrored: bool = False
    projector_stagger: float = 0.0

    def __post_init__(self) -> None:
        for device in ("camera", "projector"):
            matrix = normalised(getattr(self, f"{device}_matrix"), device)
            lens = distortion(getattr(self, f"{device}_distortion"), device)
            shape = getattr(self, f"{device}_shape")
            check_sides(f"an image of the {device}", shape)
            # The corners of the image meet the plane of distance 1 here.
            ends = [(col, row, 1) for row in (0, shape[0] - 1) for col in (0, shape[1] - 1)]
            plane = (np.array(ends) @ np.linalg.inv(decomposed(matrix)[0]).T)[:, :2]
            away = np.linalg.norm(distort(plane, lens) - plane, axis=1)
            if (away > 3 * np.linalg.norm(plane, axis=1)).any():
                raise InputError(
                    f"the {device}'s distortion moves a corner of its image to several times its "
                    "distance from the axis",
                    hint="give k1, k2, p1, p2, k3 for the plane of distance 1, as OpenCV has them",
                )
            object.__setattr__(self, f"{device}_matrix", matrix)
            object.__setattr__(self, f"{device}_distortion", lens)
            object.__setattr__(self, f"{device}_shape", tuple(map(int, shape)))
        hint = "give 0.5 or -0.5 for diamond pixels"
        check_number("a stagger", self.projector_stagger, least=-0.5, most=0.5, hint=hint)
        # Less than 1e-9 of the distance to the origin is rounding.
        centres = np.stack([centre_of(self.camera_matrix), centre_of(self.projector_matrix)])
        if np.linalg.norm(centres[1] - centres[0]) <= 1e-9 * np.abs(centres).max():
            hint = "check that the two projection matrices differ and share one world frame"
            reason = "camera and projector have the same centre, so depth cannot be measured"
            raise InputError(reason, hint=hint)

    @classmethod
    def from_intrinsics(
        cls, camera_intrinsics: ArrayLike, projector_intrinsics: ArrayLike, rotation: ArrayLike,
        translation: ArrayLike, camera_shape: Size, projector_shape: Size, *,
        camera_distortion: ArrayLike = (0, 0, 0, 0, 0),
        projector_distortion: ArrayLike = (0, 0, 0, 0, 0),
        units: str | None = None, rms: Mapping[str, float] | None = None,
    ) -> Self:  # fmt: skip
        """The geometry in the camera's frame: x to the right, y down, z forwards.

        Parameters
        ----------
        camera_intrinsics, projector_intrinsics : (3, 3) array-like
            K of camera and projector.
        rotation, translation : (3, 3) and (3,) array-like
            They lead from the camera's frame to the projector's: x_projector = R x_camera + t.
        camera_shape, projector_shape, camera_distortion, projector_distortion, units, rms
            As in the class, and so are the errors; coefficients that are left out are 0.
        """
        turn = numbers(rotation, (3, 3), "rotation")
        moved = numbers(np.ravel(np.asarray(translation)), (3,), "translation")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
            hint = "give R with R R' = 1 and det R = 1"
            raise InputError("the rotation is no rotation matrix", hint=hint)
        camera = intrinsics_of(camera_intrinsics, camera_shape, "camera")
        projector = intrinsics_of(projector_intrinsics, projector_shape, "projector")
        matrices = camera @ np.eye(3, 4), projector @ np.column_stack([turn, moved])
        lenses = np.asarray(camera_distortion), np.asarray(projector_distortion)
        return cls(*matrices, camera_shape, projector_shape, *lenses, units, dict(rms or {}))

    @property
    def camera_intrinsics(self) -> Array:
        """K of the camera, (3, 3)."""
        return decomposed(self.camera_matrix)[0]

    @property
    def projector_intrinsics(self) -> Array:
        """K of the projector, (3, 3)."""
        return decomposed(self.projector_matrix)[0]

    @property
    def rotation(self) -> Array:
        """R (3, 3) from the camera's frame to the projector's: x_projector = R x_camera + t."""
        return decomposed(self.projector_matrix)[1] @ decomposed(self.camera_matrix)[1].T

    @property
    def translation(self) -> Array:
        """The translation t (3,) from the camera's frame to the projector's, in `units`."""
        at_camera = decomposed(self.camera_matrix)[2]
        return decomposed(self.projector_matrix)[2] - self.rotation @ at_camera

    @property
    def camera_centre(self) -> Array:
        """The camera's centre (3,) in the world."""
        return centre_of(self.camera_matrix)

    @property
    def projector_centre(self) -> Array:
        """The projector's centre (3,) in the world."""
        return centre_of(self.projector_matrix)

    @property
    def baseline(self) -> float:
        """Distance from the camera to the projector, in `units`."""
        return float(np.linalg.norm(self.projector_centre - self.camera_centre))

    def fundamental_matrix(self) -> Array:
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

    def undistort_camera(self, points: ArrayLike) -> Array:
        """Where an ideal lens shows camera pixels (n, 2) as (col, row); NaN where it cannot."""
        return through_lens(undistort, points, self.camera_intrinsics, self.camera_distortion)

    def undistort_projector(self, points: ArrayLike) -> Array:
        """Where an ideal lens shows projector pixels (n, 2) as (col, row); NaN where it cannot."""
        seen = self._unmirrored(points_of(points, 2))
        return through_lens(undistort, seen, self.projector_intrinsics, self.projector_distortion)

    def projector_places(self, pixels: ArrayLike) -> Array:
        """Where projector pixels (n, 2) as (col, row) lie: the same, but for diamond pixels."""
        return staggered(points_of(pixels, 2), self.projector_stagger)

    def _unmirrored(self, points: Array) -> Array:
        """Projector pixels (n, 2) counted from the side of `projector_matrix`, or back."""
        if not self.projector_mirrored:
            return points
        return np.column_stack([self.projector_shape[1] - 1 - points[:, 0], points[:, 1]])

    def project_camera(self, points: ArrayLike) -> Array:
        """Where the camera sees points (n, 3) of the world: (n, 2) as (col, row), distorted."""
        ideal = projected(self.camera_matrix, points)
        return through_lens(distort, ideal, self.camera_intrinsics, self.camera_distortion)

    def project_projector(self, points: ArrayLike) -> Array:
        """The projector places (n, 2) as (col, row), distorted, that light points (n, 3)."""
        ideal = projected(self.projector_matrix, points)
        lit = through_lens(distort, ideal, self.projector_intrinsics, self.projector_distortion)
        return self._unmirrored(lit)

    def camera_rays(self, points: ArrayLike) -> Array:
        """Where camera pixels (n, 2) as (col, row) look: (n, 3), of depth 1 along the axis."""
        ideal = self.undistort_camera(points)
        towards = np.linalg.inv(self.camera_matrix[:, :3])
        return np.asarray(ideal @ towards[:, :2].T + towards[:, 2])

    def triangulate(self, camera_points: ArrayLike, projector_points: ArrayLike) -> Array:
        """The points of the world that camera pixels see and projector pixels light.

        A point lies on the ray of its camera pixel, where its image on the projector comes nearest
        to the projector pixel: the foot of the perpendicular on the epipolar line.

        `camera_points` and `projector_points` are pixels (n, 2) as (col, row), fractions allowed,
        as the devices show them, of diamond pixels `projector_places`; anything else is an
        InputError. Returns points (n, 3) of the world in `units`; NaN where a pixel is NaN or the
        rays are parallel.
        """
        seen, lit = points_of(camera_points, 2), self.undistort_projector(projector_points)
        if len(seen) != len(lit):
            hint = "give one projector pixel for each camera pixel"
            raise InputError(
                f"{len(seen)} camera pixels and {len(lit)} projector pixels", hint=hint
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

    def depth(self, points: ArrayLike) -> Array:
        """Distance (n,) of points (n, 3) from the camera along its axis, in `units`."""
        axis = self.camera_matrix[2]
        return np.asarray(points_of(points, 3) @ axis[:3] + axis[3])

    def scaled(self, camera: int | Size = 1, projector: int | Size = 1) -> "RigGeometry":
        """The geometry for images that are binned by blocks of (rows, cols) pixels.

        `camera` and `projector` are rows and columns of a block, as in `Capture.bin`; pixels that
        fill no block are cut off. An InputError refuses blocks that do not fit into the image.
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
            cut = 0.0
            if device == "projector":
                # The mean of the first row of blocks; blocks of even height are all alike.
                cut = self.projector_stagger * (block[0] // 2) / block[0]
                apart = self.projector_stagger * (block[0] % 2) / (block[0] * block[1])
                changed["projector_stagger"] = apart
                if self.projector_mirrored:
                    cut = shape[1] - small[1] * block[1] - cut
            matrix = binned_matrix(getattr(self, f"{device}_matrix"), block, (0, cut))
            changed[f"{device}_matrix"] = matrix
        return replace(self, **changed)

    def cropped(self, corner: Size, shape: Size) -> "RigGeometry":
        """The geometry for photographs of which a rectangle from corner (row, col) is cut out."""
        Region(corner, shape, self.camera_shape)  # Refuses a crop beyond the photographs.
        cut = binned_matrix(self.camera_matrix, (1, 1), corner)
        return replace(self, camera_matrix=cut, camera_shape=shape)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the geometry: .json, which keeps all of it, or a file of another program.

        A file ending in .yml, .yaml or .xml is OpenCV's, with the names M1, D1, M2, D2, R and T of
        its stereo sample; .colmap is a folder with COLMAP's cameras.txt and images.txt. An
        OutputError refuses a file that exists, unless `overwrite` is set, that cannot be written,
        or that cannot state a mirrored projector, diamond pixels or, of COLMAP's, skewed ones.
        """
        kind = geometry_kind(path)
        atomic: Any = atomic_folder if isinstance(kind, FolderKind) else atomic_file
        with atomic(path, kind, overwrite=overwrite) as part:
            write_rig(part, self)

    @staticmethod
    def load(
        path: str | Path, *, camera_shape: Size | None = None, projector_shape: Size | None = None
    ) -> "RigGeometry":
        """Read a geometry that `save`, or the calibration of another program, wrote.

        Parameters
        ----------
        path : str or Path
            A JSON file of `save`; an XML, YAML or JSON file of OpenCV, SLStudio, SLMaster and
            others, with matrices by the usual names; MATLAB's stereoParameters as JSON or .mat; or
            a folder with two files, as of OpenCV's stereo sample, or the camera_info of ROS.
        camera_shape, projector_shape : (rows, cols), optional
            Image sizes, for files that do not state them, or state others.

        Raises
        ------
        InputError
            If the file is missing, holds no geometry, or states no image size and none is given.
        """
        return load_rig(path, (camera_shape, projector_shape))

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, JSON-ready."""
        return {name: jsonable(getattr(self, name)) for name in self.__dataclass_fields__}


def load_rig(
    path: str | Path,
    given: tuple[Size | None, Size | None] = (None, None),
    usual: tuple[Size | None, Size | None] = (None, None),
) -> RigGeometry:
    """The geometry of a file, with sizes of camera and projector that are given, or else stated.

    Those that are `usual` count if a file states none.
    """
    file = as_path(path)
    content = read_rig(file)
    for device, one, other in zip(("camera", "projector"), given, usual, strict=True):
        if (shape := one or content.get(f"{device}_shape") or other) is not None:
            content[f"{device}_shape"] = shape
        elif "rotation" in content:
            hint = f"give {device}_shape, or write {device}_size: width, height into the file"
            raise InputError(f"{file}: does not state the image size of the {device}", hint=hint)
    with errors_naming(file):
        if "rotation" in content:
            return RigGeometry.from_intrinsics(**content)
        return RigGeometry(**checked_fields(content, str(file)))
