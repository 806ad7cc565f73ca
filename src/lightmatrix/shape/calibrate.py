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

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from lightmatrix import estimators
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.errors import InputError, OutputError, warn
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import geometry_kind
from lightmatrix.files.writing import check_output
from lightmatrix.geometry.matches import fit_fundamental, fit_homography, moved, sampson
from lightmatrix.geometry.rig_geometry import DIAMOND_ROWS, Array, RigGeometry
from lightmatrix.paths import as_path
from lightmatrix.patterns.codes import find_codes
from lightmatrix.patterns.stripes import stripes_of
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_list, check_number
from lightmatrix.reprs import ShortRepr
from lightmatrix.shape.adjustment import Fit, fit_board, largest_turn, rms_of
from lightmatrix.shape.decode import decode
from lightmatrix.shape.spots import on_diamonds
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open_matches

Size = tuple[int, int]
# A pose has places where corners are seen (cameras, n, 2), those that light them (cameras,
# projectors, n, 2), and says which share of this light is mirrored (cameras, projectors).
Corners = tuple[Array, Array, Array]
Pose = Capture | str | Path | Sequence[Sequence[Capture | str | Path]]
BoardKind = Literal["chessboard", "charuco", "circles", "asymmetric-circles"]
# A homography takes four corners; twice as many show whether they fit.
_FEWEST = 8


# The corners of a board in the camera's image, and the projector pixels that light them.


def find_corners(white: Array, board: Size, kind: BoardKind = "chessboard") -> Array | None:
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


def _all_of_grid(cv2: Any, image: NDArray[np.uint8], board: Size, kind: BoardKind) -> Array | None:
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


def _charuco_corners(cv2: Any, image: NDArray[np.uint8], board: Size, _: BoardKind) -> Array | None:
    """The corners of a ChArUco board that are seen, of whatever markers it has."""
    places = np.full((board[0] * board[1], 2), np.nan)
    # Older versions of OpenCV began boards of an even number of rows with a white square.
    for bits, legacy in product((4, 5, 6, 7), (False, True)):
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


def _side_of(corners: NDArray[np.floating], board: Size) -> float:
    """Median side of the board's squares in the image, in pixels."""
    across, down = board
    grid = corners.reshape(down, across, 2)
    return float(np.nanmedian(np.linalg.norm(np.diff(grid, axis=1), axis=2)))


def light_corners(corners: Array, matches: Correspondence, board: Size) -> tuple[Array, float]:
    """The projector pixels (n, 2) that light corners (n, 2), by a homography around each.

    They are NaN where too few pixels around a corner see them. The share of the corners around
    which the projector's image is mirrored comes last; 0.5, which decides nothing, of none.
    """
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
    return projector, float(np.mean(mirrored)) if mirrored else 0.5


def pose_images(capture: Capture, stagger: float = 0.0) -> tuple[Array, list[Correspondence]]:
    """The image (rows, cols) under white light, and the correspondence of each projector.

    Stripes are decoded; of other patterns, and of several projectors at once, T is estimated. Their
    places are those of projectors whose odd rows are moved by `stagger`.
    """
    if capture.projectors or stripes_of(capture.patterns) is None:
        found = estimators.estimate.estimate(capture).split()
        whites = [one.relight(np.ones(one.projector_shape, np.float32)) for one in found]
        image = np.asarray(np.sum(whites, axis=0), np.float64)
        matches = [correspondence(one) for one in found]
    else:
        white = find_codes(capture.patterns).white
        # Without a white frame, the brightest level of each pixel is nearest to it.
        frames = range(capture.count) if white is None else (white,)
        image = capture.frames.read(frames[0]).astype(np.float64)
        for k in frames[1:]:
            image = np.maximum(image, capture.frames.read(k))
        matches = [decode(capture)]
    matches = [on_diamonds(one, stagger) for one in matches]
    return image if image.ndim == 2 else image.mean(axis=2), matches


# The rig's geometry from the corners of a board in several poses.


def board_points(board: Size, square: float, kind: BoardKind = "chessboard") -> Array:
    """The inner corners (n, 3) of a board of (corners across, down), on the plane z = 0."""
    across, down = board
    row, col = np.mgrid[:down, :across]
    if kind == "asymmetric-circles":
        col = 2 * col + row % 2
    return np.column_stack([col.ravel(), row.ravel(), np.zeros(across * down)]) * float(square)


@dataclass(frozen=True, eq=False, repr=False)
class BoardPose(ShortRepr):
    """One pose of the board, by the name of its folder."""

    name: str
    # Its corners (cameras, n, 2) in the images, and the projector pixels that light them, (cameras,
    # projectors, n, 2), as (col, row); NaN where they are not seen or not lit.
    camera: Array
    projector: Array
    # (cameras, projectors, n): those that count; others are not lit, or off by more than 5 times
    # the median.
    used: NDArray[np.bool_]
    # Root mean square of how far those are from where the geometry puts them, in pixels: the
    # corners in the images, and what lights the places that were taken for them.
    rms_camera: float
    rms_projector: float


@dataclass(frozen=True, eq=False, repr=False)
class RigCalibration(ShortRepr):
    """A calibrated rig, and how well it explains the board."""

    # Each camera has a geometry with each projector, all in the frame of the first camera; their
    # `rms` holds "stereo" (both images), "camera" and "projector".
    geometries: tuple[tuple[RigGeometry, ...], ...]
    # The poses that were used, and why others were not.
    poses: tuple[BoardPose, ...]
    left_out: dict[str, str]
    # The largest angle between two poses of the board, in degrees.
    turn: float
    # The standard errors of how each device but the first camera is turned, in degrees, and of
    # where it stands, in the unit of the board, by its name, such as "projector 1".
    standard_errors: dict[str, tuple[float, float]]
    # What was written, in the order of the geometries.
    files: tuple[Path, ...]

    @property
    def geometry(self) -> RigGeometry:
        """That of the first camera and the first projector."""
        return self.geometries[0][0]

    @property
    def corners(self) -> int:
        """Corners that count, in all poses."""
        return sum(int(pose.used.sum()) for pose in self.poses)

    def as_dict(self) -> dict[str, Any]:
        """The residuals, JSON-ready."""
        poses = [
            {
                "pose": pose.name,
                "corners": int(pose.used.sum()),
                "rms_camera": round(pose.rms_camera, 4),
                "rms_projector": round(pose.rms_projector, 4),
            }
            for pose in self.poses
        ]
        rms = {f"rms_{name}": round(value, 4) for name, value in self.geometry.rms.items()}
        return {
            **rms,
            "corners": self.corners,
            "of_corners": sum(pose.used.size for pose in self.poses),
            "poses": poses,
            "standard_errors": self.standard_errors,
            "largest_turn": round(self.turn, 1),
            "baseline": round(self.geometry.baseline, 4),
            "units": self.geometry.units,
            "left_out": dict(self.left_out),
        }


def calibrate_rig(
    poses: Sequence[Pose],
    board: tuple[int, int] = (9, 7),
    square: float = 1.0,
    *,
    kind: BoardKind = "chessboard",
    units: str | None = None,
    stagger: float = 0.0,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RigCalibration:
    """Calibrate projectors and cameras, all together, with a printed board.

    Show the board in at least three poses, better ten: tilted to all sides by 20 to 40 degrees,
    each filling much of the image that both camera and projector cover. Photograph each pose under
    a Gray code (see `make_patterns`) or other stripes, which are decoded, or under random patterns,
    whose T is estimated.

    Parameters
    ----------
    poses : sequence of Capture, str, Path or sequence
        Each pose of the board: a capture or its folder. Several cameras have folders camera-1,
        camera-2, ... in that of the pose, as `capture` writes them. Several projectors show random
        patterns at once; or stripes in turn, with such folders in projector-1, projector-2, ... In
        Python, a sequence of what was shown in turn, each of it the captures of all cameras.
    board : (int, int)
        Inner corners along the rows and the columns of the board: squares less one. Or circles.
    square : float
        Side of a square, or distance of neighbouring circles, in `units`; of asymmetric circles,
        the distance of neighbouring rows.
    kind : {"chessboard", "charuco", "circles", "asymmetric-circles"}
        What is printed. The markers of a ChArUco board may be of any dictionary of 4 x 4 to 7 x 7
        bits; only a part of such a board need be seen. Of any board, 8 corners in two rows and two
        columns must be lit.
    units : str, optional
        Unit of length, such as "mm".
    stagger : float
        Of projectors with diamond pixels: 0.5 if odd rows (1, 3, ...) stand to the right of even
        ones, -0.5 if to the left; see `RigGeometry`.
    output : str or Path, optional
        The geometry to write, as `RigGeometry.save` does: .json, or of another program. One for
        each of several projectors, NAME-1.json, NAME-2.json, ...; of several cameras with each
        projector, NAME-1-1.json, NAME-1-2.json, ..., the camera first.
    overwrite : bool
        Whether existing geometries may be replaced.
    progress : callable, optional
        Called with (done, total) poses.

    Returns
    -------
    RigCalibration
        Intrinsics, distortion (two coefficients) and poses of all devices, with the residuals of
        each pose. Warnings name the poses that were left out, or do not fit the others.

    Raises
    ------
    InputError
        If fewer than three poses show a board that both devices see, if the poses are parallel, or
        if they have different image sizes.
    MissingExtraError, OutputError
        Without OpenCV, the extra `shape`; if a file exists or cannot be written.

    References
    ----------
    Zhang 2000, A flexible new technique for camera calibration; Moreno & Taubin 2012, Simple,
    accurate, and robust projector-camera calibration.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> measured = lm.calibrate_rig(["pose_0", "pose_1", "pose_2"])  # doctest: +SKIP
    """
    check_number("a square", square, above=True, hint="give its side, such as 24")
    if min(board) < 3:
        hint = "use at least 3 x 3"
        raise InputError(f"a board of {board[0]} x {board[1]} inner corners", hint=hint)
    if kind not in get_args(BoardKind):
        hint = f"use one of {', '.join(get_args(BoardKind))}"
        raise InputError(f"a board of the kind {kind!r}", hint=hint)
    check_list(poses, hint="give a capture for each pose of the board")
    opened = {
        str(pose) if isinstance(pose, str | Path) else f"pose {number}": _captures_of(pose)
        for number, pose in enumerate(poses)
    }
    _check_count(len(opened), {})
    cameras, projectors = _shapes_of(opened)
    files = [] if output is None else _files(output, len(cameras), len(projectors))
    for file in files:
        _check_file(file, stagger, overwrite)
    load_opencv("calibrating a rig", "shape")
    corners, left_out = _all_corners(opened, board, kind, progress, stagger)
    mirrored = np.mean([flipped for *_, flipped in corners.values()], axis=(0, 1)) > 0.5
    if mirrored.any():
        warn(
            "the camera sees the projector's image mirrored (rear projection, a mirror, flipped "
            "patterns): the geometry takes it into account"
        )

    names = [f"camera {k + 1}" for k in range(len(cameras))]
    names += [f"projector {k + 1}" for k in range(len(projectors))]

    def fitted(without: str | None = None) -> Fit:
        use = [pose for name, pose in corners.items() if name != without]
        seen = np.stack([places for places, *_ in use], axis=1)
        lit = np.stack([places for _, places, _ in use], axis=2)
        for name, places in zip(names, (*seen[:, None], *lit.swapaxes(0, 1)), strict=True):
            usable = [_suffice(each, board) for each in places.swapaxes(0, 1)]
            _check_count(sum(usable), left_out, f" of {name}")
        for number in np.flatnonzero(mirrored):
            lit[:, number, ..., 0] = projectors[number][1] - 1 - lit[:, number, ..., 0]
        return fit_board(seen, lit, board_points(board, square, kind), cameras[0])

    fit = fitted()
    badly = _misfits(fit, corners, fitted)
    if badly:
        left_out |= badly
        corners = {name: pose for name, pose in corners.items() if name not in badly}
        _check_count(len(corners), left_out)
        fit = fitted()
    causes = (
        "are all poses in the order of their patterns? Is the board flat and of this many inner "
        "corners, and did it lie still? Did the camera focus anew?"
    )
    rms = fit.rms()
    off = f"{rms['camera']:.2f} camera pixels and {rms['projector']:.2f} projector pixels (RMS)"
    # Good calibrations reach 0.1 to 0.5 pixels.
    if not max(rms.values()) <= 3:
        raise InputError(f"no geometry explains the corners: they are off by {off}", hint=causes)
    if max(rms.values()) > 1:
        warn(f"the corners are off by {off}; good calibrations reach 0.5\n  {causes}")
    if fit.behind:
        hint = "is an image mirrored or turned, or are patterns and photographs of two series?"
        raise InputError("the geometry that fits puts the board behind a device", hint=hint)
    seen_errors, lit_errors, used = fit.seen_errors, fit.lit_errors, fit.used
    # A corner of a camera counts if the match with some projector does, (cameras, poses, n).
    counted = np.asarray(used.any(axis=1))

    def geometry(camera: int, projector: int) -> RigGeometry:
        # A projector that this camera does not see is known from the others.
        those = camera if used[camera, projector].any() else slice(None)
        own = {
            "camera": rms_of(seen_errors[camera][counted[camera]]),
            "projector": rms_of(lit_errors[those, projector][used[those, projector]]),
        }
        own["stereo"] = float(np.sqrt((own["camera"] ** 2 + own["projector"] ** 2) / 2))
        found = fit.geometry(camera, projector, (cameras[camera], projectors[projector]))
        found = replace(found, units=units, rms=own, projector_stagger=stagger)
        return replace(found, projector_mirrored=bool(mirrored[projector]))

    geometries = tuple(
        tuple(geometry(c, p) for p in range(len(projectors))) for c in range(len(cameras))
    )
    used_poses = []
    for k, (name, (seen, lit, _)) in enumerate(corners.items()):
        counts = used[:, :, k]
        errors = rms_of(seen_errors[:, k][counted[:, k]]), rms_of(lit_errors[:, :, k][counts])
        used_poses.append(BoardPose(name, seen, lit, counts, *errors))
    for name, reason in left_out.items():
        warn(f"{name} is left out: {reason}")
    for file, found in zip(files, chain(*geometries), strict=False):
        found.save(file, overwrite=overwrite)
    stated = dict(zip(names[1:], map(tuple, fit.deviations.tolist()[1:]), strict=True))
    turn = largest_turn(fit.poses)
    return RigCalibration(geometries, tuple(used_poses), left_out, turn, stated, tuple(files))


def _misfits(
    fit: Fit, corners: Mapping[str, Corners], fitted: Callable[[str], Fit]
) -> dict[str, str]:
    """Which poses do not fit the others, and why; `fitted` leaves one of them out."""
    badly = {}
    for number, (name, (_, places, _)) in enumerate(corners.items()):
        use, lit = fit.used[:, :, number].sum(), np.isfinite(places).all(axis=-1).sum()
        if use < 0.5 * lit:
            badly[name] = f"only {use} of {lit} corners fit the other poses; did the board move?"
    far = max(fit.rms().values())
    if not far > 0.5 or badly or len(corners) <= 3:
        return badly
    # A pose in which something moved can bend the others to itself: without it, they fit.
    rest = {}
    for name in corners:
        # The other poses may be too few, or parallel.
        with suppress(InputError):
            rest[name] = max(fitted(name).rms().values())
    name = min(rest, key=lambda each: rest[each], default="")
    if not name or not rest[name] < 0.5 * far:
        return {}
    reason = f"the others fit to {rest[name]:.2f} pixels without it, and to {far:.2f} with it"
    return {name: f"{reason}; did the board move?"}


def _captures_of(pose: Pose) -> list[list[Capture]]:
    """The captures of a pose: what was shown in turn, and of each those of all cameras."""
    if isinstance(pose, Capture):
        return [[pose]]
    if not isinstance(pose, str | Path):
        hint = "give a capture, or the captures of all cameras under each projector"
        check_list(pose, hint=hint)
        for part in pose:
            check_list(part, hint=hint)
        return [[open_capture(one) for one in part] for part in pose]

    def within(folder: Path, device: str) -> list[Path]:
        found = folder.glob(f"{device}-[0-9]*")
        return sorted(found, key=lambda path: (len(path.name), path.name)) or [folder]

    parts = within(as_path(pose), "projector")
    return [[open_capture(one) for one in within(part, "camera")] for part in parts]


def _shapes_of(opened: dict[str, list[list[Capture]]]) -> tuple[list[Size], list[Size]]:
    """The image sizes of all cameras, and of all projectors; they must be those of each pose."""
    usual: tuple[list[Size], list[Size]] | None = None
    for name, parts in opened.items():
        seen = [
            [(rows, cols) for rows, cols, *_ in (one.camera_shape for one in part)]
            for part in parts
        ]
        lit = [[*(one.projectors or (one.projector_shape,))] for part in parts for one in part[:1]]
        own = seen[0], list(chain(*lit))
        usual = usual or own
        if own != usual or any(each != seen[0] for each in seen):
            hint = "photograph all poses with the same cameras and projectors"
            raise InputError(f"{name}: has images of other sizes than the poses before", hint=hint)
    assert usual is not None
    return usual


def _files(output: str | Path, cameras: int, projectors: int) -> list[Path]:
    """The files of the geometries of all pairs, those of the first camera first."""
    path = as_path(output)
    pairs = product(range(1, cameras + 1), range(1, projectors + 1))
    names = [f"-{c}-{p}" if cameras > 1 else f"-{p}" if projectors > 1 else "" for c, p in pairs]
    return [path.with_stem(path.stem + name) for name in names]


def _all_corners(
    opened: dict[str, list[list[Capture]]],
    board: Size,
    kind: BoardKind,
    progress: Progress | None,
    stagger: float = 0.0,
) -> tuple[dict[str, Corners], dict[str, str]]:
    """The corners of usable poses by name, and why other poses are not usable."""
    found: dict[str, Corners] = {}
    left_out: dict[str, str] = {}
    for number, (name, parts) in enumerate(opened.items()):
        try:
            views = [[pose_images(one, stagger) for one in part] for part in parts]
        except InputError as error:
            # Frames out of order, or no light of the projector.
            left_out[name] = error.message
            continue
        seen: list[Array] = []
        lit: list[Array] = []
        mirrored: list[list[float]] = []
        for shown in zip(*views, strict=True):
            white = np.sum([image for image, _ in shown], axis=0)
            places = find_corners(white, board, kind)
            if places is None:
                places = np.full((board[0] * board[1], 2), np.nan)
                pairs = [(places, 0.5)] * sum(len(each) for _, each in shown)
            else:
                pairs = [light_corners(places, one, board) for _, each in shown for one in each]
            own = np.array([projector for projector, _ in pairs])
            # A board may be counted from its other end, but not by each camera from another one.
            ways = [np.linalg.norm(lit[0] - way, axis=-1) for way in (own, own[:, ::-1]) if lit]
            if lit and (ways[1] < 2).sum() > (ways[0] < 2).sum():
                places, own = places[::-1], own[:, ::-1]
            seen.append(places)
            lit.append(own)
            mirrored.append([share for _, share in pairs])
        known = np.isfinite(lit[0]).all(axis=-1)
        count = int(np.isfinite(seen[0]).all(axis=1).sum())
        if not count:
            left_out[name] = f"no board of {board[0]} x {board[1]} inner corners is found"
        elif not any(_suffice(each, board) for each in lit[0]):
            left_out[name] = (
                f"the camera sees {count} of {len(seen[0])} corners, and the projector lights "
                f"{known.sum(axis=1).max()} of them: {_FEWEST} in two rows and two columns are "
                "needed"
            )
        else:
            found[name] = np.array(seen), np.array(lit), np.array(mirrored)
        if progress is not None:
            progress(number + 1, len(opened))
    _check_count(len(found), left_out)
    return found, left_out


def _suffice(lit: Array, board: Size) -> bool:
    """Whether enough corners (..., n, 2) of a board are lit, in two rows and columns at least."""
    finite = np.isfinite(lit).all(axis=-1).reshape(-1, board[1], board[0])
    known = np.asarray(finite.any(axis=0))
    several = min(known.any(axis=1).sum(), known.any(axis=0).sum()) >= 2
    return bool(known.sum() >= _FEWEST and several)


def _check_count(usable: int, left_out: dict[str, str], device: str = "") -> None:
    # Each pose gives two equations for the four numbers of K (Zhang 2000); a third pose leaves some
    # for the distortion and for the residuals to mean anything.
    if usable >= 3:
        return
    reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
    raise InputError(
        f"{usable} usable pose{'s' * (usable != 1)}{device}{reasons}",
        hint="photograph 3 poses at least, better 5 to 10, each tilted differently and "
        "lit by the projector; a board's size is its inner corners, squares less one",
    )


# The rig's geometry from any scene that is not flat.


def _check_file(file: str | Path, stagger: float, overwrite: bool) -> None:
    """Refuse a file that cannot be written, before any work."""
    check_output(file, geometry_kind(file), overwrite=overwrite)
    if stagger and Path(file).suffix.lower() != ".json":
        raise OutputError(f"{file}: cannot state diamond pixels", hint="save it as .json")


def self_calibrate(
    matches: Correspondence | LightTransport | str | Path,
    camera_intrinsics: ArrayLike | None,
    *,
    principal: tuple[float, float] | None = None,
    projector_intrinsics: ArrayLike | None = None,
    camera_distortion: ArrayLike = (0, 0, 0, 0, 0),
    baseline: float = 1.0,
    units: str | None = None,
    stagger: float = 0.0,
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
        K of the projector. None: square or diamond pixels, and the focal length and the row of the
        axis that fit best, with its column in the middle. The row stays in the middle unless the
        matches contradict it, as under projectors that shift their image upwards.
    camera_distortion : (5,) array-like
        Coefficients of the camera's lens.
    baseline : float
        Distance from the camera to the projector, in `units`. The matches do not tell it: all
        lengths are proportional to it.
    units, stagger, output, overwrite
        As in `calibrate_rig`.

    Returns
    -------
    RigGeometry
        In the camera's frame; its `rms` holds "epipolar", the distances of matches that fit from
        their epipolar lines, in pixels, and "projector_focal_length", its standard error if the
        projector's axis passes the middle column to 5 % of the width.

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
        _check_file(output, stagger, overwrite)
    opened = open_matches(matches)
    found = correspondence(opened) if isinstance(opened, LightTransport) else opened
    found = on_diamonds(found, stagger)
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
        high = DIAMOND_ROWS if stagger else 1.0
        pose, deviation = _pose(matrix, seen, own, lens, known, projector_shape, high, free)
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
        rig = replace(rig, rms=rms, units=units, projector_stagger=stagger)
        return replace(rig, projector_mirrored=mirrored), behind

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


def _centred(focal: float, shape: tuple[int, int], high: float = 1.0) -> Array:
    """K with an axis through the middle of an image of (rows, cols).

    Columns of its pixels are `high` times as far apart as rows.
    """
    rows, cols = shape
    return np.array([[focal, 0, (cols - 1) / 2], [0, high * focal, (rows - 1) / 2], [0, 0, 1]])


def _pose(
    fundamental: Array, seen: Array, lit: Array, camera: Array, projector: Array | None,
    projector_shape: Size, high: float, free: float,
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
        candidates = [_centred(f, projector_shape, high) for f in focals]
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
            rotation = scipy.spatial.transform.Rotation.from_rotvec(numbers[:3]).as_matrix() @ turn
            return own, rotation, moved_shift / np.linalg.norm(moved_shift)

        def distances(numbers: Array, parts: Any = parts) -> Array:
            own, rotation, (x, y, z) = parts(numbers)
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            matrix = np.linalg.inv(own).T @ cross @ rotation @ np.linalg.inv(camera)
            return sampson(matrix, seen, lit)

        first = np.zeros(6 if projector is not None else 7 if row is None else 8)
        spread = max(float(np.median(np.abs(distances(first)))), 1e-3)
        found = scipy.optimize.least_squares(distances, first, loss="soft_l1", f_scale=spread)
        rms = float(np.sqrt((distances(found.x) ** 2).mean()))
        # Errors of neighbours are alike: all matches tell as much as a hundred that are not.
        inverse = np.linalg.pinv(found.jac.T @ found.jac / len(seen) * 100)
        pose = parts(found.x)
        error = 0.0
        if len(first) > 6:
            # The matches hardly tell the column of the axis, which is taken to pass the middle of
            # the image to 5 % of its width.
            aside = start.copy()
            aside[0, 2] += 0.05 * projector_shape[1]
            off = distances(found.x, partial(parts, start=aside)) - distances(found.x)
            of_axis = np.linalg.lstsq(found.jac, off, rcond=None)[0][6]
            error = float(np.hypot(rms * np.sqrt(inverse[6, 6]), of_axis)) * pose[0][0, 0]
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
