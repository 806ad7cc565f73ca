"""Projectors whose pixels are diamonds: odd rows stand half a column beside even ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from benchmarks.calibration import nearest_pixels
from lightmatrix.cli import main
from lightmatrix.files.images import read_image

from ..helpers.board import BOARD, POSES, SQUARE, board_capture, board_rig

SHAPE = (288, 192)


def diamond_rig(stagger: float = 0.5) -> lm.RigGeometry:
    """The rig of the board with rows that are half as far apart."""
    rig = board_rig()
    matrix = np.diag([1, 2, 1]) @ rig.projector_matrix
    return replace(rig, projector_matrix=matrix, projector_shape=SHAPE, projector_stagger=stagger)


def sheet_depth(rig: lm.RigGeometry) -> np.ndarray:
    """The depth of a sheet in the first pose at each camera pixel."""
    angles, middle = POSES[0]
    normal = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()[:, 2]
    rays = rig.camera_rays(np.indices(rig.camera_shape).reshape(2, -1).T[:, ::-1])
    depth = normal @ np.array(middle) / (rays @ normal)
    return np.asarray(depth.reshape(rig.camera_shape))


@pytest.mark.parametrize("stagger", [0.5, -0.5])
def test_pixels_and_their_places_are_each_others_inverse(stagger: float) -> None:
    rig = diamond_rig(stagger)
    pixels = np.indices(SHAPE).reshape(2, -1).T[:, ::-1].astype(float)
    places = rig.projector_places(pixels)
    np.testing.assert_array_equal(places[1], [1, 0])
    np.testing.assert_array_equal(places[SHAPE[1]], [stagger, 1])
    np.testing.assert_array_equal(nearest_pixels(rig, places), pixels)
    anywhere = np.random.default_rng(0).uniform(0, 100, (2000, 2))
    around = np.abs(rig.projector_places(nearest_pixels(rig, anywhere)) - anywhere)
    # No other pixel's diamond holds the place.
    assert (around[:, 0] + around[:, 1] / 2 <= 0.5 + 1e-9).all()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("block", [(1, 1), (2, 1), (3, 2)])
def test_blocks_lie_in_the_middle_of_their_pixels(block: tuple[int, int], mirrored: bool) -> None:
    rig = replace(diamond_rig(), projector_mirrored=mirrored, projector_shape=(288, 191))
    small = rig.scaled(projector=block)
    rows, cols = np.array(small.projector_shape) - 1
    for row, col in ((0, 0), (1, 0), (rows, cols), (7, 12)):
        own = np.indices(block).reshape(2, -1).T + np.array([row, col]) * block
        middle = rig.undistort_projector(rig.projector_places(own[:, ::-1]).mean(axis=0)[None])
        found = small.undistort_projector(small.projector_places([[col, row]]))
        for point in np.array([[[0, 0, 900]], [[50, 9, 800]]]):
            one, other = rig.project_projector(point), small.project_projector(point)
            apart = rig.undistort_projector(one) - middle
            there = (small.undistort_projector(other) - found) * np.array(block)[::-1]
            np.testing.assert_allclose(apart, there, atol=1e-6)


def test_depth_of_diamonds_is_right_and_wrong_without_them(tmp_path: Path) -> None:
    rig = diamond_rig()
    black = lm.ImagePatterns(np.zeros((1, *SHAPE), np.float32))
    sheet = board_capture(rig, POSES[0], black, squares=False).truth.transport()
    depth = sheet_depth(rig)

    def off(source: lm.LightTransport | lm.Correspondence, geometry: lm.RigGeometry) -> float:
        shape = lm.triangulate(source, geometry)
        assert shape.kept.mean() > 0.8
        return float(np.sqrt(np.nanmean((shape.depth - depth) ** 2)))

    square = replace(rig, projector_stagger=0.0)
    assert off(sheet, rig) < 0.6
    assert off(sheet, square) > 2
    assert off(lm.correspondence(sheet), rig) < 1
    assert off(lm.correspondence(sheet), square) > 2
    rig.save(tmp_path / "rig.json")
    assert lm.RigGeometry.load(tmp_path / "rig.json").projector_stagger == 0.5
    with pytest.raises(lm.OutputError, match="diamond pixels"):
        rig.save(tmp_path / "rig.yml")
    with pytest.raises(lm.InputError, match="a stagger of 5"):
        replace(rig, projector_stagger=5)
    # How probably a depth is right is a view, too.
    lm.show(sheet, "probability", geometry=rig, output=tmp_path / "sure.npy")
    sure = np.load(tmp_path / "sure.npy")
    assert np.median(sure) > 0.9
    # Points of the map lie on the sheet.
    angles, middle = POSES[0]
    normal = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()[:, 2]
    away = []
    for name, geometry in (("right", rig), ("wrong", square)):
        lm.map_projector(sheet, output=tmp_path / name, geometry=geometry)
        points = read_image(tmp_path / name / "xyzMap.exr")
        distance = (points[points.any(axis=2)] - middle) @ normal
        away.append(float(np.median(np.abs(distance))))
    assert away[0] < 0.5
    assert away[1] > 1


def test_a_board_and_a_scene_calibrate_diamonds(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rig = diamond_rig()
    code = lm.make_patterns("graycode", SHAPE, inverse=False)
    poses = [board_capture(rig, pose, code) for pose in POSES]
    found = lm.calibrate_rig(poses, BOARD, SQUARE, stagger=0.5).geometry
    assert found.projector_stagger == 0.5
    assert found.rms["projector"] < 0.1
    there, here = found.projector_intrinsics, rig.projector_intrinsics
    assert there[1, 1] / there[0, 0] == pytest.approx(here[1, 1] / here[0, 0], rel=2e-3)
    waves = 900 + 60 * np.sin(np.arange(240) / 15) + 50 * np.cos(np.arange(180) / 11)[:, None]
    rays = rig.camera_rays(np.indices(rig.camera_shape).reshape(2, -1).T[:, ::-1])
    lit = nearest_pixels(rig, rig.project_projector(waves.reshape(-1, 1) * rays))
    place = lit[:, ::-1].reshape(180, 240, 2)
    place[~((place >= 0) & (place < SHAPE)).all(axis=2)] = np.nan
    pixel = np.nan_to_num(place, nan=-1).astype(np.int32)
    ones = np.ones((180, 240), np.float32)
    matches = lm.Correspondence(pixel, place.astype(np.float32), ones, projector_shape=SHAPE)
    given = rig.camera_intrinsics
    bent = rig.camera_distortion
    own = lm.self_calibrate(matches, given, stagger=0.5, camera_distortion=bent)
    assert own.projector_intrinsics[1, 1] == pytest.approx(2 * own.projector_intrinsics[0, 0])
    assert own.projector_intrinsics[0, 0] == pytest.approx(here[0, 0], rel=0.05)
    # Refused before any work: there are no such matches.
    written: dict[str, Any] = {"stagger": 0.5, "output": tmp_path / "rig.yml"}
    with pytest.raises(lm.OutputError, match=r"rig\.yml: cannot state diamond pixels"):
        lm.calibrate_rig(poses, BOARD, SQUARE, **written)
    with pytest.raises(lm.OutputError, match=r"rig\.yml: cannot state diamond pixels"):
        lm.self_calibrate("nothing.npz", given, **written)
    wrong = main(["calibrate", "x", "--board", "9x7", "--square", "24mm", "--principal", "3,4"])
    assert wrong == 2
    assert "--principal for a board" in capsys.readouterr().err
