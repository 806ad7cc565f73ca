"""`lm.self_calibrate`: the geometry of a rig from any scene that is not flat, without a board.

The matches of camera and projector pixels give the fundamental matrix F, with seven numbers. If the
camera's K is known, six of them are the projector's focal length, its rotation and the direction in
which it stands; how far away it stands, and so the size of the scene, cannot be known.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import GEOMETRY
from lightmatrix.files.writing import check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.ranges import check_number
from lightmatrix.shape.board import fit_homography, moved
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open_matches

# The fundamental matrix from many matches, some of them wrong: projective epipolar geometry.
#
# `uses/epipolar.py` has the affine one, which suffices for long lenses and gives no shape.


# Random sets of eight matches that are tried, and the matches that judge them. With a quarter of
# the matches wrong, 300 sets miss a right one with a probability below 1e-13.
_TRIALS, _SET, _JUDGES = 300, 8, 2000
# A match supports a geometry within this Sampson distance, in pixels of both images: places of
# projector pixels are known to about a tenth of a pixel.
_SUPPORT = 0.5
_ROUNDS = 20
# The least standard deviation of distances, so that exact matches divide nothing by 0.
_LEAST_SPREAD = 0.005


def fit_fundamental(
    camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """F (3, 3) with projector' F camera = 0 from matches (n, 2) each, n >= 8, and which fit it."""
    random = np.random.default_rng(0)
    judges = random.permutation(len(camera))[:_JUDGES]
    before, after = _normalisation(camera), _normalisation(projector)
    design = _design(_moved(before, camera), _moved(after, projector))
    sets = random.integers(len(judges), size=(_TRIALS, _SET))
    found = np.linalg.svd(design[judges[sets]])[2][:, -1].reshape(-1, 3, 3)
    candidates = after.T @ _singular(found) @ before
    support = [
        (np.abs(sampson(each, camera[judges], projector[judges])) < _SUPPORT).sum()
        for each in candidates
    ]
    matrix = candidates[int(np.argmax(support))]
    for _ in range(_ROUNDS):
        distance = sampson(matrix, camera, projector)
        spread = max(1.48 * float(np.median(np.abs(distance))), _LEAST_SPREAD)
        weight = 1 / (1 + (distance / (2 * spread)) ** 2) ** 2
        moment = (design * weight[:, None]).T @ design
        solution = np.linalg.eigh(moment)[1][:, 0].reshape(3, 3)
        matrix = after.T @ _singular(solution[None])[0] @ before
    distance = np.abs(sampson(matrix, camera, projector))
    spread = max(1.48 * float(np.median(distance)), _LEAST_SPREAD)
    return matrix / np.linalg.norm(matrix), distance < max(3 * spread, 0.1)


def sampson(
    matrix: NDArray[np.float64], camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Signed Sampson distances (n,) of matches (n, 2): how far both must move, in pixels."""
    at_projector = camera @ matrix[:, :2].T + matrix[:, 2]
    at_camera = projector @ matrix[:2] + matrix[2]
    value = (projector * at_projector[:, :2]).sum(axis=1) + at_projector[:, 2]
    slope = (at_projector[:, :2] ** 2).sum(axis=1) + (at_camera[:, :2] ** 2).sum(axis=1)
    return np.asarray(value / np.sqrt(np.maximum(slope, 1e-30)))


def _design(camera: NDArray[np.float64], projector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The coefficients (n, 9) of F in projector' F camera."""
    one = np.ones((len(camera), 1))
    left, right = np.hstack([projector, one]), np.hstack([camera, one])
    return (left[:, :, None] * right[:, None, :]).reshape(-1, 9)


def _singular(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest matrices (n, 3, 3) of rank 2."""
    left, values, right = np.linalg.svd(matrices)
    values[:, 2] = 0
    return np.asarray((left * values[:, None, :]) @ right)


def _normalisation(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The map (3, 3) that gives points (n, 2) the mean 0 and the spread 1 (Hartley 1997)."""
    middle, spread = points.mean(axis=0), max(float(points.std()), 1e-12)
    return np.array(
        [[1 / spread, 0, -middle[0] / spread], [0, 1 / spread, -middle[1] / spread], [0, 0, 1]]
    )


def _moved(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points * matrix[0, 0] + matrix[:2, 2]


# Matches below this confidence come from several places at once; chosen by hand.
_LEAST_CONFIDENCE = 0.3
# Matches that are needed, and the most that are fitted: more cost time and change nothing.
_FEWEST, _MOST = 50, 20_000
# A scene is flat if a homography explains all but this share of the matches to within this many
# pixels, or this multiple of their distance from the epipolar lines: parallax is what shows shape.
_PARALLAX_SHARE, _PARALLAX, _PARALLAX_NOISE = 0.05, 0.5, 3.0
# Focal lengths of the projector that are tried, as multiples of its larger side: angles of view
# from 8 to 90 degrees.
_FOCAL_LENGTHS = np.geomspace(0.5, 7, 60)


def self_calibrate(
    matches: Correspondence | LightTransport | str | Path,
    camera_intrinsics: ArrayLike | None,
    *,
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
        focal length divided by the size of a pixel. The axis then passes the middle of the image.
    projector_intrinsics : (3, 3) array-like, optional
        K of the projector. None: square pixels, its axis through the middle of its image, and the
        focal length that fits best. Projectors on tables shift their image upwards, and then need
        it.
    camera_distortion : (5,) array-like
        Coefficients of the camera's lens.
    baseline : float
        Distance from the camera to the projector, in `units`. The matches do not tell it: all
        lengths are proportional to it.
    units : str, optional
        Unit of length.
    output : str or Path, optional
        A .json file of the geometry to write.
    overwrite : bool
        Whether an existing geometry may be replaced.

    Returns
    -------
    RigGeometry
        In the camera's frame; its `rms` holds "epipolar", the distances of matches that fit from
        their epipolar lines, in pixels.

    Raises
    ------
    InputError
        Without the camera's intrinsics, on too few matches, and on a flat scene.
    OutputError
        If the file exists or cannot be written.

    References
    ----------
    Hartley & Zisserman 2004, Multiple View Geometry, chapters 9 to 11.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("corner")
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
        check_output(output, GEOMETRY, overwrite=overwrite)
    opened = open_matches(matches)
    found = correspondence(opened) if isinstance(opened, LightTransport) else opened
    projector_shape = found.projector_shape
    if projector_shape is None:
        raise InputError(
            "the correspondence does not say the projector's size", hint="set projector_shape"
        )
    seen, lit = _points(found)
    start = np.eye(3) if projector_intrinsics is None else np.asarray(projector_intrinsics, float)
    # Lends its checks and its lens to the points; where the projector stands is not known yet.
    rows, cols = found.valid.shape
    if np.ndim(camera_intrinsics) == 0:
        focal = float(np.asarray(camera_intrinsics))
        check_number("a focal length", focal, above=True, hint="give it in pixels, such as 1200")
        camera_intrinsics = _centred(focal, (rows, cols))
    camera = RigGeometry.from_intrinsics(
        camera_intrinsics,
        start,
        np.eye(3),
        (1, 0, 0),
        (rows, cols),
        projector_shape,
        camera_distortion=camera_distortion,
    )
    seen = camera.undistort_camera(seen)
    finite = np.isfinite(seen).all(axis=1)
    seen, lit = seen[finite], lit[finite]
    fundamental, fits = fit_fundamental(seen, lit)
    _refuse_plane(seen, lit, fundamental)
    seen, lit = seen[fits], lit[fits]
    known = None if projector_intrinsics is None else start
    intrinsics, turn, shift = _pose(
        fundamental, seen, lit, camera.camera_intrinsics, known, projector_shape
    )
    rig = RigGeometry.from_intrinsics(
        camera.camera_intrinsics,
        intrinsics,
        turn,
        shift * baseline,
        (rows, cols),
        projector_shape,
        camera_distortion=camera_distortion,
        units=units,
    )
    distance = sampson(rig.fundamental_matrix(), seen, lit)
    rig = replace(rig, rms={"epipolar": float(np.sqrt((distance**2).mean()))})
    if output is not None:
        rig.save(output, overwrite=overwrite)
    return rig


def _centred(focal: float, shape: tuple[int, int]) -> NDArray[np.float64]:
    """K of square pixels and an axis through the middle of an image of (rows, cols)."""
    rows, cols = shape
    return np.array([[focal, 0, (cols - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]])


def _points(matches: Correspondence) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Confident matches as (col, row), (n, 2) each."""
    good = np.isfinite(matches.place).all(axis=2) & (matches.confidence >= _LEAST_CONFIDENCE)
    if good.sum() < _FEWEST:
        raise InputError(
            f"{good.sum()} camera pixels see one place of the projector",
            hint=f"at least {_FEWEST} are needed, better thousands, with stripes or patterns along "
            "both axes",
        )
    at = np.argwhere(good)
    chosen = np.random.default_rng(0).permutation(len(at))[:_MOST]
    at = at[chosen]
    place = matches.place[at[:, 0], at[:, 1]].astype(np.float64)
    return at[:, ::-1].astype(np.float64), place[:, ::-1]


def _refuse_plane(
    seen: NDArray[np.float64], lit: NDArray[np.float64], fundamental: NDArray[np.float64]
) -> None:
    """Refuse matches that one homography explains."""
    plane = fit_homography(seen, lit, np.ones(len(seen)))
    parallax = np.linalg.norm(moved(plane, seen) - lit, axis=1)
    noise = float(np.median(np.abs(sampson(fundamental, seen, lit))))
    share = float((parallax > max(_PARALLAX, _PARALLAX_NOISE * noise)).mean())
    if share < _PARALLAX_SHARE:
        raise InputError(
            f"the scene is flat: only {100 * share:.1f} % of the matches show parallax",
            hint="put objects of different depth into the scene, or calibrate with a board",
        )


def _pose(
    fundamental: NDArray[np.float64],
    seen: NDArray[np.float64],
    lit: NDArray[np.float64],
    camera: NDArray[np.float64],
    projector: NDArray[np.float64] | None,
    projector_shape: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """K of the projector, R and t of length 1, that bring the matches nearest to their lines."""
    candidates = (
        [_centred(share * max(projector_shape), projector_shape) for share in _FOCAL_LENGTHS]
        if projector is None
        else [projector]
    )
    # The two singular values of an essential matrix are equal.
    values = [np.linalg.svd(each.T @ fundamental @ camera, compute_uv=False) for each in candidates]
    start = candidates[int(np.argmin([(a - b) / a for a, b, _ in values]))]
    turn, shift = _decomposed(start.T @ fundamental @ camera, camera, start, seen, lit)

    def parts(
        numbers: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        own = (
            start if projector is not None else _centred(float(np.exp(numbers[6])), projector_shape)
        )
        moved_shift = shift + numbers[3:6]
        return (
            own,
            Rotation.from_rotvec(numbers[:3]).as_matrix() @ turn,
            moved_shift / np.linalg.norm(moved_shift),
        )

    def distances(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        own, rotation, direction = parts(numbers)
        x, y, z = direction
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix = np.linalg.inv(own).T @ cross @ rotation @ np.linalg.inv(camera)
        return sampson(matrix, seen, lit)

    first = np.zeros(6) if projector is not None else np.append(np.zeros(6), np.log(start[0, 0]))
    spread = max(float(np.median(np.abs(distances(first)))), 1e-3)
    best = least_squares(distances, first, loss="soft_l1", f_scale=spread)
    return parts(best.x)


def _decomposed(
    essential: NDArray[np.float64],
    camera: NDArray[np.float64],
    projector: NDArray[np.float64],
    seen: NDArray[np.float64],
    lit: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """R and t of an essential matrix, of the four solutions the one with most points in front."""
    left, _, right = np.linalg.svd(essential)
    left, right = left * np.linalg.det(left), right * np.linalg.det(right)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    size = (1, 1)
    best: tuple[int, NDArray[np.float64], NDArray[np.float64]] | None = None
    for turn in (left @ quarter @ right, left @ quarter.T @ right):
        for shift in (left[:, 2], -left[:, 2]):
            rig = RigGeometry.from_intrinsics(camera, projector, turn, shift, size, size)
            points = rig.triangulate(seen, lit)
            ahead = points @ turn.T + shift
            count = int(((points[:, 2] > 0) & (ahead[:, 2] > 0)).sum())
            if best is None or count > best[0]:
                best = (count, turn, shift)
    assert best is not None
    return best[1], best[2]
