"""Calibration of a rig: a real board's corners, a simulated board, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from lightmatrix import estimators
from lightmatrix.cli import main
from lightmatrix.geometry.matches import fit_fundamental, fit_homography, moved, sampson
from lightmatrix.shape import calibrate
from lightmatrix.shape.adjustment import Fit, fit_board
from lightmatrix.shape.calibrate import (
    BoardKind,
    RigCalibration,
    board_points,
    find_corners,
    light_corners,
    pose_images,
)
from lightmatrix.simulation.simulate import SimulatedCapture

from ..helpers.board import (
    BOARD,
    POSES,
    SQUARE,
    board_capture,
    board_rig,
    two_by_two,
    two_projector_capture,
)

cv2: Any = pytest.importorskip("cv2")
DATA = Path(__file__).parents[1] / "data" / "graycode-board"
CAMERA, PROJECTOR, SIDE = (1024, 1280), (768, 1024), 75.0


@pytest.fixture(scope="module", autouse=True)
def _each_pose_is_decoded_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate, "pose_images", cache(pose_images))
        yield


@pytest.fixture(scope="module")
def real_matches() -> lm.Correspondence:
    return lm.decode(lm.Capture.from_folders(DATA / "graycode_pattern", DATA / "capture_0"))


def real_corners() -> tuple[np.ndarray, np.ndarray]:
    """The corners of five poses in the camera's image, and what lights them, (5, 63, 2)."""
    table = np.loadtxt(DATA / "corners.csv", delimiter=",", skiprows=1)
    poses = np.array([table[table[:, 0] == pose] for pose in range(5)])
    return poses[..., 1:3], poses[..., 3:]


def fitted(seen: np.ndarray, lit: np.ndarray) -> tuple[Fit, lm.RigGeometry]:
    fit = fit_board(seen[None], lit[None, None], board_points((9, 7), SIDE), CAMERA)
    return fit, fit.geometry(0, 0, (CAMERA, PROJECTOR))


def squares(points: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Sides of the squares between corners that count, for 9 x 7 corners."""
    grid, good = points.reshape(7, 9, 3), used.reshape(7, 9)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)[good[:, 1:] & good[:, :-1]]
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)[good[1:] & good[:-1]]
    return np.concatenate([across, down])


def test_a_real_board_is_explained_to_a_quarter_of_a_pixel() -> None:
    fit, _ = fitted(*real_corners())
    used = fit.used[0, 0]
    assert used.sum() >= 290
    for errors in (fit.seen_errors[0], fit.lit_errors[0, 0]):
        assert np.sqrt((errors[used] ** 2).sum(axis=1).mean()) < 0.2
    # The board is bent at one corner, which the second and third pose show at opposite ends.
    assert not used[1, -9]
    assert not used[2, 8]


@pytest.mark.parametrize("left_out", [0, 4])
def test_a_pose_left_out_measures_the_squares(left_out: int) -> None:
    seen, lit = real_corners()
    others = np.arange(5) != left_out
    points = fitted(seen[others], lit[others])[1].triangulate(seen[left_out], lit[left_out])
    sides = squares(points, np.ones(63, bool))
    assert abs(sides.mean() - SIDE) < 0.15
    assert sides.std() < 0.15


def test_corners_of_real_photographs_have_their_projector_pixels(
    real_matches: lm.Correspondence,
) -> None:
    """Also where the image is mirrored, which the homographies around the corners tell."""
    # The photographs are a window of those whose corners are stored.
    known, projector = (places[0] for places in real_corners())
    seen = known - np.array([248.0, 592.0])
    inside = ((seen > 20) & (seen < np.array([384, 280]) - 20)).all(axis=1)
    grid = inside.reshape(7, 9)
    board = int(grid.any(axis=0).sum()), int(grid.any(axis=1).sum())
    assert inside.sum() == board[0] * board[1] >= 6
    lit, mirrored = light_corners(seen[inside], real_matches, board)
    assert np.abs(lit - projector[inside]).max() < 0.06
    assert mirrored == 0
    cols = real_matches.projector_shape[1] - 1  # type: ignore[index]
    place = (real_matches.place * [1, -1] + [0, cols]).astype(np.float32)
    turned = light_corners(seen[inside], replace(real_matches, place=place), board)
    assert turned[1] == 1
    unlit = replace(real_matches, place=np.full_like(place, np.nan))
    assert light_corners(seen[inside], unlit, board)[1] == 0.5


def test_a_camera_need_not_see_every_projector(monkeypatch: pytest.MonkeyPatch) -> None:
    rigs, board = two_by_two(), board_points((9, 7), 25.0)
    corners = {}
    for k in range(6):
        turn = Rotation.from_euler("xy", 30 * np.cos([k, k + 1.5]), degrees=True)
        middle = np.array([5.0 * k - 20, 0, 900 + 10 * (k % 3)])
        points = turn.apply(board - board.mean(axis=0)) + middle
        seen = np.array([rig.project_camera(points) for rig, _ in rigs])
        lit = np.array([[rig.project_projector(points) for rig in pair] for pair in rigs])
        lit[1, 1] = np.nan
        corners[f"pose {k}"] = seen, lit, np.array([[0, 0], [0, 0.5]])
    shapes = [(180, 240)] * 2, [(144, 192)] * 2
    monkeypatch.setattr(calibrate, "_captures_of", lambda pose: pose)
    monkeypatch.setattr(calibrate, "_shapes_of", lambda opened: shapes)
    monkeypatch.setattr(calibrate, "_all_corners", lambda *_: (corners, {}))
    measured = lm.calibrate_rig([[]] * 6, (9, 7), 25.0)
    assert all(
        value < 0.01 for pair in measured.geometries for r in pair for value in r.rms.values()
    )
    assert errors(measured.geometries[1][1], rigs[1][1])[0] < 0.01


def board_views(
    seed: int, poses: int, noise: float
) -> tuple[np.ndarray, np.ndarray, lm.RigGeometry]:
    """A board in poses before a rig whose projector has its axis anywhere, even off its image.

    Returns its corners in the camera's image, (poses, 63, 2), and the projector pixels.
    """
    random = np.random.default_rng(seed)
    focal, throw = random.uniform(1000, 2200), random.uniform(0.8, 2.2) * 1280
    axis = (640 + random.uniform(-100, 100), random.uniform(-0.3, 1.3) * 800)
    side = random.uniform(0, 2 * np.pi)
    centre = np.array([np.cos(side), np.sin(side), 0.1]) * random.uniform(150, 450)
    if seed == 0:
        # Straight above the camera; such a rig was once taken for one of another focal length.
        throw, axis, centre = 1920.0, (639.5, 1000.0), np.array([0, -220.0, -15])
    projector = np.array([[throw, 0, axis[0]], [0, throw, axis[1]], [0, 0, 1]])
    # The middle of the projector's image meets the board.
    ahead = np.linalg.solve(projector, [640, 400, 1.0])
    board = np.array([0, 0, 1400.0]) - centre
    pairs = [ahead / np.linalg.norm(ahead), [1, 0, 0]], [board / np.linalg.norm(board), [1, 0, 0]]
    turn = Rotation.align_vectors(*pairs, weights=[1, 1e-3])[0].as_matrix()
    rig = lm.RigGeometry.from_intrinsics(
        np.array([[focal, 0, 645], [0, focal, 505], [0, 0, 1]]), projector, turn, -turn @ centre,
        (1024, 1280), (800, 1280),
        camera_distortion=[random.uniform(-0.2, 0.1)],
        projector_distortion=[random.uniform(-0.05, 0.05)],
    )  # fmt: skip
    corners = board_points((9, 7), 40.0)
    corners -= corners.mean(axis=0)
    places = np.empty((2, poses, 63, 2))
    for k in range(poses):
        tilt = Rotation.from_euler("xyz", random.uniform(-30, 30, 3), degrees=True).as_matrix()
        middle = np.array([*random.uniform(-80, 80, 2), 1400 + random.uniform(-150, 150)])
        seen = rig.project_camera(corners @ tilt.T + middle) + random.normal(0, noise, (63, 2))
        # The projector lights the place that the camera takes for the corner.
        rays = rig.camera_rays(seen)
        met = rays * (tilt[:, 2] @ middle / (rays @ tilt[:, 2]))[:, None]
        places[:, k] = seen, rig.project_projector(met) + random.normal(0, noise, (63, 2))
    return *places, rig


def worst_depth(found: lm.RigGeometry, known: lm.RigGeometry) -> float:
    points = np.array([*product([-150.0, 150], [-100.0, 100], [1250.0, 1550])])
    again = found.triangulate(known.project_camera(points), known.project_projector(points))
    return float(np.abs(again / points - 1)[:, 2].max())


@pytest.mark.parametrize("noise", [0, 0.1])
@pytest.mark.parametrize("seed", range(12))
def test_projectors_with_their_axis_anywhere_are_found(seed: int, noise: float) -> None:
    seen, lit, rig = board_views(seed, 5, noise)
    fit = fit_board(seen[None], lit[None, None], board_points((9, 7), 40.0), (1024, 1280))
    found = fit.geometry(0, 0, (rig.camera_shape, rig.projector_shape))
    assert worst_depth(found, rig) < (0.008 if noise else 1e-5)
    away = np.abs(found.projector_intrinsics - rig.projector_intrinsics).max()
    assert away < (25 if noise else 0.01)
    assert max(fit.rms().values()) < 1.6 * noise + 1e-3


@pytest.mark.parametrize("seed", [4, 11])
def test_a_pose_in_which_the_board_moved_is_left_out(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, lit, rig = board_views(seed, 6, 0.1)
    lit[1] += 25, 10
    calibrated = partial(calibrated_from, monkeypatch, seen, lit, (9, 7), 40.0)
    with pytest.warns(lm.LightMatrixWarning, match="pose_1 is left out: .*did the board move"):
        measured = calibrated((rig.camera_shape, rig.projector_shape))
    assert worst_depth(measured.geometry, rig) < 0.008


# Seen askew: where pixels of a drawing of 30 pixels a square appear in a photograph.
TILT = np.array([[1.05, 0.12, 30], [-0.09, 0.96, 60], [1.5e-4, 3e-4, 1]])


def drawing(kind: BoardKind, board: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A photograph (rows, cols) of a board, and where its corners or circles are, (n, 2)."""
    points = 30 * board_points(board, 1, kind)[:, :2] + 60
    image = np.full((420, 460), 255, np.uint8)
    if "circles" in kind:
        for point in points:
            cv2.circle(image, np.rint(point * 16).astype(int).tolist(), 160, 0, -1, cv2.LINE_AA, 4)
    elif kind == "chessboard":
        row, col = np.mgrid[: board[1] + 1, : board[0] + 1]
        tiles = np.kron((row + col) % 2, np.ones((30, 30)))
        image[30 : 30 + len(tiles), 30 : 30 + tiles.shape[1]] = 255 * tiles
        points = points - 0.5
    else:
        markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        size = board[0] + 1, board[1] + 1
        known = cv2.aruco.CharucoBoard(size, 1.0, 0.8, markers)
        tiles = known.generateImage((30 * size[0], 30 * size[1]))
        image[30 : 30 + len(tiles), 30 : 30 + tiles.shape[1]] = tiles
        points = points - 0.5
    # Three times as large, so that markers are resolved.
    enlarge = np.array([[3.0, 0, 1], [0, 3, 1], [0, 0, 1]])
    shown = cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST)
    seen = cv2.warpPerspective(shown, TILT, (1300, 1150), borderValue=255)
    return seen / 255.0, moved(TILT, moved(enlarge, points))


@pytest.mark.parametrize(
    ("kind", "board"),
    [
        ("chessboard", (7, 5)),
        ("charuco", (7, 5)),
        ("circles", (7, 5)),
        ("asymmetric-circles", (4, 7)),
    ],
)
def test_boards_of_all_kinds_are_found(kind: BoardKind, board: tuple[int, int]) -> None:
    white, expected = drawing(kind, board)
    found = find_corners(white, board, kind)
    assert found is not None
    # A board that looks the same from two sides may be counted from the other end.
    away = min(np.abs(each - expected).max() for each in (found, found[::-1]))
    # The middle of a circle's image is not the image of its middle.
    assert away < (1.5 if "circles" in kind else 0.3)
    assert find_corners(np.full((200, 200), 0.5), board, kind) is None


def test_a_part_of_a_charuco_board_suffices_and_so_does_a_part_that_is_lit() -> None:
    board = (7, 5)
    white, expected = drawing("charuco", board)
    white[:, :420] = 0.5
    found = find_corners(white, board, "charuco")
    assert found is not None
    seen = np.isfinite(found).all(axis=1)
    assert 12 <= seen.sum() <= 25
    np.testing.assert_allclose(found[seen], expected[seen], atol=0.3)
    # The projector's pixels are the camera's, shifted.
    row, col = np.mgrid[: white.shape[0], : white.shape[1]].astype(np.float32)
    place = np.stack([row - 40, col - 100], axis=-1)
    place[:300] = np.nan
    pixel = np.nan_to_num(place, nan=-1).astype(np.int32)
    matches = lm.Correspondence(pixel, place, np.ones(white.shape, np.float32))
    places, _ = light_corners(found, matches, board)
    lit = np.isfinite(places).all(axis=1)
    assert (lit <= seen).all()
    assert 0 < lit.sum() < seen.sum()
    np.testing.assert_allclose(places[lit], found[lit] - [100, 40], atol=1e-2)


@pytest.mark.parametrize("count", [6, 12])
def test_poses_need_few_lit_corners_in_two_rows(
    count: int, captures: list[SimulatedCapture], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = light_corners

    def in_part(corners: np.ndarray, matches: lm.Correspondence, board: tuple[int, int]) -> Any:
        places, mirrored = whole(corners, matches, board)
        places[count:] = np.nan
        return places, mirrored

    poses = [*captures, replace(captures[0])]
    with monkeypatch.context() as patch:
        patch.setattr(calibrate, "light_corners", in_part)
        if count == 6:
            with pytest.raises(lm.InputError, match="projector lights 6 of them: 8 in two rows"):
                lm.calibrate_rig(poses, BOARD, SQUARE)
        else:
            opened: Any = {str(k): [[pose]] for k, pose in enumerate(poses)}
            found, _ = calibrate._all_corners(opened, BOARD, "chessboard", None)
            assert [np.isfinite(lit).sum() for _, lit, _ in found.values()] == [24] * 5
    with pytest.raises(lm.InputError, match="a board of the kind 'squares'"):
        lm.calibrate_rig(poses, BOARD, SQUARE, kind="squares")  # type: ignore[arg-type]


def test_homographies_survive_wrong_matches() -> None:
    random = np.random.default_rng(0)
    matrix = np.array([[1.2, 0.1, 300], [-0.2, 0.9, 200], [1e-4, 2e-4, 1]])
    source = random.uniform(0, 100, (400, 2))
    target = moved(matrix, source) + random.normal(0, 0.05, (400, 2))
    target[:100] += random.uniform(2, 30, (100, 2))
    found = fit_homography(source, target, np.ones(400))
    corner = np.array([[50.0, 50.0]])
    assert np.abs(moved(found, corner) - moved(matrix, corner)).max() < 0.03


@pytest.fixture(scope="module")
def captures() -> list[SimulatedCapture]:
    rig = board_rig()
    code = lm.make_patterns("graycode", rig.projector_shape, inverse=False)
    return [board_capture(rig, pose, code) for pose in POSES]


@pytest.fixture(scope="module")
def usual(
    captures: list[SimulatedCapture], tmp_path_factory: pytest.TempPathFactory
) -> tuple[RigCalibration, Path]:
    """The calibration from all poses, and its file."""
    file = tmp_path_factory.mktemp("board") / "rig.json"
    return lm.calibrate_rig(captures, BOARD, SQUARE, units="mm", output=file), file


def test_a_simulated_board_gives_the_rig(usual: tuple[RigCalibration, Path]) -> None:
    known = board_rig()
    measured, file = usual
    rig = measured.geometry
    assert measured.corners >= 135
    assert rig.rms["stereo"] < 0.2
    assert not measured.left_out
    assert 55 < measured.turn < 75
    # What counts is what is measured; a shift of the principal point and a turn cancel in it.
    corners = np.array([[50.0, 50], [120, 90], [190, 140], [60, 130]])
    points = known.camera_rays(corners) * 900
    found = rig.triangulate(known.project_camera(points), known.project_projector(points))
    sides, expected = np.diff(found, axis=0), np.diff(points, axis=0)
    ratio = np.linalg.norm(sides, axis=1) / np.linalg.norm(expected, axis=1)
    assert np.abs(ratio - 1).max() < 0.01
    assert np.abs(rig.depth(found) / 900 - 1).max() < 0.02
    assert rig.baseline == pytest.approx(known.baseline, rel=0.02)
    again = lm.RigGeometry.load(file)
    np.testing.assert_allclose(again.camera_matrix, rig.camera_matrix)
    assert again.units == "mm"


def test_poses_that_cannot_be_used_are_named(captures: list[SimulatedCapture]) -> None:
    blank = board_capture(board_rig(), POSES[0], captures[0].patterns, squares=False)
    with pytest.raises(lm.InputError, match="2 usable poses; pose 2: no board of 7 x 5"):
        lm.calibrate_rig([*captures[2:], blank], BOARD, SQUARE)
    with pytest.warns(lm.LightMatrixWarning, match="pose 0 is left out: no board"):
        measured = lm.calibrate_rig([blank, *captures[1:]], BOARD, SQUARE)
    assert len(measured.poses) == 3
    assert measured.as_dict()["left_out"] == {"pose 0": "no board of 7 x 5 inner corners is found"}


def test_poses_must_be_several_and_tilted(captures: list[SimulatedCapture]) -> None:
    small = captures[1].bin(camera=2)
    for poses, board, square, message in (
        (captures[:2], BOARD, SQUARE, "2 usable poses"),
        ([captures[0]] * 3, BOARD, SQUARE, "nearly parallel"),
        ([captures[0], small, captures[2]], BOARD, SQUARE, "images of other sizes"),
        (captures, (2, 5), SQUARE, "at least 3 x 3"),
        (captures, BOARD, 0, "a square of 0"),
    ):
        with pytest.raises(lm.InputError, match=message):
            lm.calibrate_rig(poses, board, square)


def test_flipped_patterns_calibrate_as_mirrored(
    captures: list[SimulatedCapture], usual: tuple[RigCalibration, Path]
) -> None:
    patterns = captures[0].patterns
    mirrored = lm.ImagePatterns(patterns.images()[:, :, ::-1])
    poses = [replace(each, patterns=mirrored) for each in captures]
    with pytest.warns(lm.LightMatrixWarning, match="image mirrored"):
        measured = lm.calibrate_rig(poses, BOARD, SQUARE, units="mm")
    rig, plain = measured.geometry, usual[0].geometry
    assert rig.projector_mirrored
    assert rig.rms["stereo"] == pytest.approx(plain.rms["stereo"], abs=0.02)
    assert rig.baseline == pytest.approx(plain.baseline, rel=0.01)
    seen = np.array([[60.0, 50], [120, 90], [180, 130]])
    points = plain.camera_rays(seen) * 900
    lit = rig.project_projector(points)
    there = plain.project_projector(points)
    np.testing.assert_allclose(lit[:, 0], 191 - there[:, 0], atol=0.3)
    np.testing.assert_allclose(rig.triangulate(seen, lit), points, rtol=0.01, atol=1)
    # Binned, the columns that fill no block are cut off at the right.
    small = rig.scaled(projector=5)
    np.testing.assert_allclose(small.project_projector(points), (lit - 2) / 5, atol=1e-6)


def calibrated_from(
    patch: pytest.MonkeyPatch, seen: np.ndarray, lit: np.ndarray, board: tuple[int, int],
    side: float, sizes: tuple[tuple[int, int], tuple[int, int]], mirrored: float = 0,
) -> RigCalibration:  # fmt: skip
    """`calibrate_rig` of corners that are given, (poses, n, 2)."""
    names = [f"pose_{k}" for k in range(len(seen))]
    pairs = zip(seen[:, None], lit[:, None, None], strict=True)
    share = np.full((1, 1), mirrored)
    found = {name: (*pair, share) for name, pair in zip(names, pairs, strict=True)}
    patch.setattr(calibrate, "_captures_of", lambda _: [])
    patch.setattr(calibrate, "_shapes_of", lambda _: tuple([size] for size in sizes))
    patch.setattr(calibrate, "_all_corners", lambda *_: (found, {}))
    return lm.calibrate_rig(names, board, side)


def test_the_real_board_calibrates_flipped_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, lit = real_corners()
    # Where the board stands, from the geometry of what is not flipped.
    points = fitted(seen, lit)[1].triangulate(seen[0], lit[0])
    lit[..., 0] = PROJECTOR[1] - 1 - lit[..., 0]
    with pytest.warns(lm.LightMatrixWarning, match="image mirrored"):
        measured = calibrated_from(
            monkeypatch, seen, lit, (9, 7), SIDE, (CAMERA, PROJECTOR), mirrored=1
        )
    assert measured.geometry.projector_mirrored
    assert measured.geometry.rms["stereo"] < 0.2
    assert measured.geometry.baseline == pytest.approx(674, abs=3)
    # The board lies before the projector, not behind it.
    np.testing.assert_allclose(measured.geometry.project_projector(points), lit[0], atol=0.5)


def test_a_board_behind_the_projector_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """An image that is mirrored or turned fits well, from the other side."""
    seen, lit = real_corners()
    flipped = lit * [-1, 1] + [PROJECTOR[1] - 1, 0]
    for wrong in (flipped, lit[..., ::-1]):
        given = monkeypatch, seen, wrong, (9, 7), SIDE, (CAMERA, PROJECTOR)
        with pytest.raises(lm.InputError, match="puts the board behind a device"):
            calibrated_from(*given)


def test_poses_that_are_exchanged_are_left_out_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, lit = real_corners()
    with pytest.warns(lm.LightMatrixWarning, match="pose_[34] is left out"):
        measured = calibrated_from(
            monkeypatch, seen, lit[[0, 1, 2, 4, 3]], (9, 7), SIDE, (CAMERA, PROJECTOR)
        )
    assert sorted(measured.left_out) == ["pose_3", "pose_4"]


@pytest.mark.parametrize("exchanged", [False, True])
def test_the_rms_has_absolute_limits(exchanged: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    (seen, lit), random = real_corners(), np.random.default_rng(0)
    wrong = lit[::-1] if exchanged else lit + random.normal(0, 1.2, lit.shape)
    given = monkeypatch, seen, wrong, (9, 7), SIDE, (CAMERA, PROJECTOR)
    if exchanged:
        with pytest.raises(lm.InputError, match="no geometry explains the corners"):
            calibrated_from(*given)
        return
    with pytest.warns(lm.LightMatrixWarning, match="good calibrations reach 0.5"):
        measured = calibrated_from(*given)
    assert 1 < measured.geometry.rms["projector"] < 2.5


def test_a_board_that_the_projector_does_not_light(captures: list[SimulatedCapture]) -> None:
    white, (matches,) = pose_images(captures[0])
    places = find_corners(white, BOARD)
    assert places is not None
    dark = matches.place.copy()
    dark[:, 120:] = np.nan
    half = lm.Correspondence(matches.pixel, dark, matches.confidence)
    lit = np.asarray(np.isfinite(light_corners(places, half, BOARD)[0]).all(axis=1))
    assert 0 < lit.sum() < 35
    # A window that is half dark may still be lit enough.
    assert lit[places[:, 0] < 120].all()
    assert not lit[places[:, 0] > 124].any()


def test_the_command(
    captures: list[SimulatedCapture], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(tmp_path / f"pose_{k}") for k in range(3)]
    for capture, folder in zip(captures[:3], folders, strict=True):
        capture.save(folder)
    words = ["--board", "7x5", "--square", "25mm", "-o", str(tmp_path / "rig.json")]
    assert main(["calibrate", *folders, *words, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["files"] == [str(tmp_path / "rig.json")]
    assert answer["corners"] > 95
    assert answer["rms_stereo"] < 0.2
    assert [pose["pose"] for pose in answer["poses"]] == folders
    assert lm.RigGeometry.load(tmp_path / "rig.json").units == "mm"
    assert main(["calibrate", *folders, *words]) == 2
    assert "exists already" in capsys.readouterr().err
    for poses, said in {
        (tmp_path,): "no folder patterns",
        (folders[0],) * 3: "1 usable pose",
    }.items():
        assert main(["calibrate", *map(str, poses), *words, "--overwrite"]) == 2
        assert said in capsys.readouterr().err
    assert main(["calibrate", *folders, *words[:2]]) == 2
    assert "takes both --board and --square" in capsys.readouterr().err
    words[3] = "24,5 mm"
    assert main(["calibrate", *folders, *words, "--overwrite"]) == 0
    assert "25 mm" not in capsys.readouterr().out
    rig = lm.RigGeometry.load(tmp_path / "rig.json")
    assert rig.baseline == pytest.approx(24.5 / 25 * answer["baseline"], rel=1e-4)
    for wrong, said in {"wide": "--square wide", "1,200mm": "write 1.2mm or 1200mm"}.items():
        words[3] = wrong
        assert main(["calibrate", *folders, *words, "--overwrite"]) == 2
        assert said in capsys.readouterr().err


def test_a_pose_under_random_patterns_has_the_same_corners(
    usual: tuple[RigCalibration, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = partial(lm.estimate, check=False, correct="none")
    monkeypatch.setattr(estimators.estimate, "estimate", plain)
    # A part of the camera, which the whole board is in, and a projector of half as many pixels.
    rig, corner = board_rig().scaled(projector=2), (24, 48)
    random = lm.BernoulliPatterns(rig.projector_shape, 24)
    capture = board_capture(rig, POSES[3], random).crop(corner, (124, 133))
    white, (matches,) = pose_images(capture)
    places = find_corners(white, BOARD)
    assert places is not None
    lit, other = light_corners(places, matches, BOARD)[0], usual[0].poses[3]
    assert np.isfinite(lit).all()
    assert np.abs(places + corner[::-1] - other.camera[0]).max() < 0.1
    away = np.linalg.norm(2 * lit + 0.5 - other.projector[0, 0], axis=1)
    assert np.sqrt((away**2).mean()) < 0.25


def test_two_projectors_and_two_cameras_from_one_set_of_boards(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    known = two_by_two()
    captures = [[[two_projector_capture(rigs, pose) for rigs in known]] for pose in POSES[:3]]
    # Estimates from random patterns take half a minute a pose; they are exact here.
    monkeypatch.setattr(estimators.estimate, "estimate", lambda capture: capture.truth.transport())
    with pytest.raises(lm.InputError, match="pose 2: has images of other sizes"):
        lm.calibrate_rig([*captures[:2], [captures[2][0][:1]]], BOARD, SQUARE)
    measured = lm.calibrate_rig(captures, BOARD, SQUARE, output=tmp_path / "rig.json")
    stated = measured.standard_errors
    assert set(stated) == {"camera 2", "projector 1", "projector 2"}
    pairs = list(product((0, 1), (0, 1)))
    files = [tmp_path / f"rig-{camera + 1}-{projector + 1}.json" for camera, projector in pairs]
    assert measured.files == tuple(files)
    found = [lm.RigGeometry.load(file) for file in files]
    for (camera, projector), rig in zip(pairs, found, strict=True):
        assert max(rig.rms.values()) < 0.2
        own = errors(rig, known[camera][projector])[0]
        assert own < 2.5 * max(turn for turn, _ in stated.values()) < 0.6
    # How the projectors are turned to each other is known better than to the camera.
    turn, exact = (b.rotation @ a.rotation.T for a, b in (found[:2], known[0]))
    assert np.degrees(Rotation.from_matrix(turn @ exact.T).magnitude()) < 0.05


def test_a_projector_is_compared_with_what_the_camera_took_for_a_corner() -> None:
    """Poses are as good as the matches of camera and projector, not as the corners."""
    random, board = np.random.default_rng(3), board_points((9, 7), 25.0)
    turned, lit = [], []
    rigs = two_by_two()
    for k in range(8):
        angles = 30 * np.cos([k, k + 1.5, 0])
        turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        normal, middle = turn[:, 2], np.array([5.0 * k - 20, 0, 900 + 10 * (k % 3)])
        corners = (board - board.mean(axis=0)) @ turn.T + middle
        seen = rigs[0][0].project_camera(corners) + random.normal(0, 0.15, (63, 2))
        rays = rigs[0][0].camera_rays(seen)
        met = rays * (normal @ middle / (rays @ normal))[:, None]
        lit.append(
            [rig.project_projector(met) + random.normal(0, 0.01, (63, 2)) for rig in rigs[0]]
        )
        turned.append(seen)
    places = np.array(lit).swapaxes(0, 1)[None]
    fit = fit_board(np.array([turned]), places, board, (180, 240))
    assert np.sqrt(np.square(fit.lit_errors).mean()) == pytest.approx(0.01, rel=0.1)
    assert np.sqrt(np.square(fit.seen_errors).mean()) == pytest.approx(0.15, rel=0.1)
    for projector, rig in enumerate(rigs[0]):
        found = fit.geometry(0, projector, ((180, 240), (144, 192)))
        assert errors(found, rig)[0] < 2.5 * fit.deviations[1 + projector, 0] < 0.2


def test_folders_of_cameras_and_of_projectors_in_turn(
    captures: list[SimulatedCapture], tmp_path: Path
) -> None:
    for camera, projector in product((1, 2), (1, 2)):
        captures[0].save(tmp_path / "pose" / f"projector-{projector}" / f"camera-{camera}")
    parts = calibrate._captures_of(tmp_path / "pose")
    assert [len(part) for part in parts] == [2, 2]
    shapes = calibrate._shapes_of({"pose": parts})
    assert shapes == ([(180, 240)] * 2, [(144, 192)] * 2)


# Self-calibration, against the exact geometry of rendered scenes.


def errors(rig: lm.RigGeometry, known: lm.RigGeometry) -> tuple[float, float]:
    """Angles between the rotations, and between the translations, in degrees."""
    turn = Rotation.from_matrix(rig.rotation @ known.rotation.T).magnitude()
    a, b = rig.translation, known.translation
    return np.degrees(turn), np.degrees(
        np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
    )


def test_a_rendered_scene_gives_the_rig() -> None:
    known = lm.truth("l_objects")
    exact, transport = known.geometry, known.transport()
    assert exact is not None
    ways = ((transport, None, 0.3), (lm.correspondence(transport), exact.projector_intrinsics, 0.1))
    for source, projector, most in ways:
        rig = lm.self_calibrate(
            source, exact.camera_intrinsics, projector_intrinsics=projector, baseline=exact.baseline
        )
        turn, direction = errors(rig, exact)
        assert turn < 0.1
        assert direction < most
        assert rig.baseline == pytest.approx(exact.baseline)
        assert rig.projector_intrinsics[0, 0] == pytest.approx(128, rel=0.005)
        assert rig.rms["epipolar"] < 0.1


def test_a_known_rig_is_found_whatever_its_lens_and_a_third_of_wrong_matches() -> None:
    exact = lm.RigGeometry.from_intrinsics(
        np.array([[300.0, 0, 60], [0, 300, 45], [0, 0, 1]]),
        np.array([[280.0, 0, 49.5], [0, 280, 39.5], [0, 0, 1]]),
        Rotation.from_euler("yx", [25, -8], degrees=True).as_matrix(),
        [-1.1, 0.3, 0.35],
        (90, 120),
        (80, 100),
        camera_distortion=[-0.3],
    )
    random = np.random.default_rng(1)
    col, row = np.meshgrid(np.arange(120), np.arange(90))
    depth = 2.5 + 0.5 * np.sin(col / 9) + 0.4 * np.cos(row / 7)
    rays = exact.camera_rays(np.column_stack([col.ravel(), row.ravel()]))
    place = exact.project_projector(depth.reshape(-1, 1) * rays)
    place += random.normal(0, 0.05, place.shape)
    wrong = random.random(len(place)) < 0.3
    place[wrong] = random.uniform(0, 80, (int(wrong.sum()), 2))
    grid = np.asarray(place[:, ::-1].reshape(90, 120, 2), np.float32)
    matches = lm.Correspondence(
        np.rint(grid).astype(np.int32), grid, np.ones((90, 120), np.float32)
    )
    with pytest.raises(lm.InputError, match="projector's size"):
        lm.self_calibrate(matches, exact.camera_intrinsics)
    rig = lm.self_calibrate(
        replace(matches, projector_shape=(80, 100)),
        exact.camera_intrinsics,
        camera_distortion=exact.camera_distortion,
    )
    turn, direction = errors(rig, exact)
    assert turn < 0.1
    assert direction < 0.3


def true_depth(known: lm.Truth) -> np.ndarray:
    assert known.depth is not None
    return known.depth


@pytest.mark.parametrize("name", ["metal", "gripper", "corner"])
def test_an_axis_beside_the_middle_is_refused_unless_it_is_stated(name: str) -> None:
    known = lm.truth(name)
    assert known.geometry is not None
    matches = lm.correspondence(known.transport())
    camera = known.geometry.camera_intrinsics
    with pytest.raises(lm.InputError, match="behind the camera or the projector") as refused:
        lm.self_calibrate(matches, camera[0, 0])
    assert "(principal)" in (refused.value.hint or "")
    axis = float(camera[0, 2]), float(camera[1, 2])
    rig = lm.self_calibrate(matches, camera[0, 0], principal=axis, baseline=known.geometry.baseline)
    shape = lm.triangulate(matches, rig)
    assert np.nanmedian(np.abs(shape.depth / true_depth(known) - 1)) < 0.02
    # The stated error covers the true one; most of it is that of an axis taken for the middle.
    assert abs(rig.projector_intrinsics[0, 0] - 128) < 3 * rig.rms["projector_focal_length"]
    assert rig.rms["projector_focal_length"] < 13


def test_a_mirrored_projector_gives_the_same_depth() -> None:
    known = lm.truth("corner")
    assert known.geometry is not None
    plain = lm.correspondence(known.transport())
    place = (plain.place * [1, -1] + [0, 63]).astype(np.float32)
    pixel = np.where(plain.pixel >= 0, plain.pixel * [1, -1] + [0, 63], -1).astype(np.int32)
    matches = replace(plain, place=place, pixel=pixel)
    with pytest.warns(lm.LightMatrixWarning, match="image mirrored"):
        rig = lm.self_calibrate(
            matches, known.geometry.camera_intrinsics, baseline=known.geometry.baseline
        )
    assert rig.projector_mirrored
    for source in (matches, replace(matches, place=place.copy())):
        shape = lm.triangulate(source, rig)
        assert shape.kept.mean() > 0.99
        assert np.nanmedian(np.abs(shape.depth / true_depth(known) - 1)) < 0.003
    # Columns alone are enough; their rows are where they cross the lines.
    place[..., 0] = np.nan
    alone = lm.triangulate(replace(matches, place=place), rig)
    assert np.nanmedian(np.abs(alone.depth / true_depth(known) - 1)) < 0.01


def waves(col: float, row: float) -> tuple[lm.Correspondence, lm.RigGeometry]:
    """Matches of a scene of waves, whose projector's axis passes (col, row), and the rig."""
    exact = lm.RigGeometry.from_intrinsics(
        np.array([[300.0, 0, 60], [0, 300, 45], [0, 0, 1]]),
        np.array([[280.0, 0, col], [0, 280, row], [0, 0, 1]]),
        Rotation.from_euler("yx", [15, -8], degrees=True).as_matrix(),
        [-1.1, 0.3, 0.35],
        (90, 120),
        (80, 100),
    )
    across, down = np.meshgrid(np.arange(120), np.arange(90))
    depth = 2.5 + 0.5 * np.sin(across / 9) + 0.4 * np.cos(down / 7)
    rays = exact.camera_rays(np.column_stack([across.ravel(), down.ravel()]))
    place = exact.project_projector(depth.reshape(-1, 1) * rays)
    place += np.random.default_rng(1).normal(0, 0.05, place.shape)
    grid = np.asarray(place[:, ::-1].reshape(90, 120, 2), np.float32)
    ones = np.ones((90, 120), np.float32)
    pixel = np.rint(grid).astype(np.int32)
    return lm.Correspondence(pixel, grid, ones, projector_shape=(80, 100)), exact


def test_a_shifted_projector_image_is_found_without_a_board() -> None:
    matches, exact = waves(49.5, 79)
    rig = lm.self_calibrate(matches, exact.camera_intrinsics)
    assert rig.projector_intrinsics[1, 2] == pytest.approx(79, abs=0.5)
    assert rig.projector_intrinsics[0, 0] == pytest.approx(280, rel=0.005)


def test_the_stated_error_covers_an_axis_beside_the_middle_column() -> None:
    matches, exact = waves(59.5, 39.5)
    rig = lm.self_calibrate(matches, exact.camera_intrinsics)
    away = abs(rig.projector_intrinsics[0, 0] - 280)
    assert 2 < away < 3 * rig.rms["projector_focal_length"] < 8


def test_an_axis_or_focal_length_that_contradicts_the_matches_is_said() -> None:
    matches, exact = waves(49.5, 39.5)
    wrong = np.array([[250.0, 0, 49.5], [0, 250, 39.5], [0, 0, 1]])
    with pytest.warns(lm.LightMatrixWarning, match=r"0\.33 pixels .* and 0\.04 if the axes"):
        lm.self_calibrate(matches, exact.camera_intrinsics, projector_intrinsics=wrong)


@pytest.mark.parametrize("noise", [0.05, 0.25, 0.5])
def test_flat_scenes_are_refused(noise: float) -> None:
    col, row = np.meshgrid(np.arange(60.0), np.arange(50.0))
    place = np.stack([0.9 * row + 0.1 * col + 3, col - 0.05 * row + 2], axis=2)
    place += np.random.default_rng(0).normal(0, noise, place.shape)
    matches = lm.Correspondence(
        np.rint(place).astype(np.int32),
        place.astype(np.float32),
        np.ones((50, 60), np.float32),
        projector_shape=(60, 70),
    )
    intrinsics = np.array([[100.0, 0, 30], [0, 100, 25], [0, 0, 1]])
    with pytest.raises(lm.InputError, match="the scene is flat"):
        lm.self_calibrate(matches, intrinsics)
    with pytest.raises(lm.InputError, match="without the camera's intrinsics"):
        lm.self_calibrate(matches, None)
    with pytest.raises(lm.InputError, match="0 camera pixels"):
        lm.self_calibrate(replace(matches, confidence=matches.confidence * 0), intrinsics)
    with pytest.raises(lm.InputError, match="a baseline of 0"):
        lm.self_calibrate(matches, intrinsics, baseline=0)


def test_the_command_without_a_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = lm.truth("l_objects")
    assert known.geometry is not None
    known.save(tmp_path / "T.npz")
    words = ["calibrate", str(tmp_path / "T.npz"), "-o", str(tmp_path / "rig.json")]
    assert main(words) == 2
    assert "neither a board nor the camera's focal length" in capsys.readouterr().err
    assert main([*words, "--focal", "128"]) == 2
    assert "principal" in capsys.readouterr().err
    focal = ["--focal", "128", "--principal", "5.9,47.5"]
    assert main([*words, *focal, "--baseline", "360mm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rms_epipolar"] < 0.5
    rig = lm.RigGeometry.load(tmp_path / "rig.json")
    assert (round(rig.baseline, 6), rig.units) == (360, "mm")
    assert main([*words, *focal, "--overwrite"]) == 0
    assert "if its axis passes the middle column" in capsys.readouterr().out
    for more, message in (
        (["--focal", "0"], "a focal length of 0"),
        (["--focal", "9", "--principal", "5"], "--principal 5"),
        (["--focal", "9", str(tmp_path)], "takes one scene"),
        (["--focal", "9", "--board", "9x7", "--square", "1"], "--focal for a board"),
    ):
        assert main([*words, "--overwrite", *more]) == 2
        assert message in capsys.readouterr().err


def test_exact_matches_give_the_exact_fundamental_matrix() -> None:
    exact = lm.truth("corner").geometry
    assert exact is not None
    points = np.random.default_rng(0).uniform(-1, 1, (60, 3))
    seen, lit = exact.project_camera(points), exact.project_projector(points)
    found = fit_fundamental(seen, lit)
    expected = exact.fundamental_matrix()
    sign = np.sign((found * expected).sum())
    np.testing.assert_allclose(sign * found, expected, atol=1e-6)
    # Moved by one pixel at right angles to its line, a match is off by less: both images can give.
    line = np.append(seen[0], 1) @ expected.T
    aside = lit[:1] + line[:2] / np.linalg.norm(line[:2])
    assert 0.5 < abs(sampson(expected, seen[:1], aside)[0]) < 1
