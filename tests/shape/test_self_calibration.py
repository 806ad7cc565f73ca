"""Self-calibration against the exact geometry of rendered scenes, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.geometry.matches import fit_fundamental, sampson


def errors(rig: lm.RigGeometry, known: lm.RigGeometry) -> tuple[float, float]:
    """Angles between the rotations, and between the translations, in degrees."""
    turn = Rotation.from_matrix(rig.rotation @ known.rotation.T).magnitude()
    a, b = rig.translation, known.translation
    return np.degrees(turn), np.degrees(
        np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
    )


@pytest.mark.parametrize("name", ["corner", "l_objects"])
def test_rendered_scenes_give_the_rig(name: str) -> None:
    known = lm.truth(name)
    exact = known.geometry
    assert exact is not None
    transport = known.transport()
    for projector, most in ((None, 0.3), (exact.projector_intrinsics, 0.1)):
        rig = lm.self_calibrate(
            transport,
            exact.camera_intrinsics,
            projector_intrinsics=projector,
            baseline=exact.baseline,
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


def test_flat_scenes_are_refused() -> None:
    col, row = np.meshgrid(np.arange(60.0), np.arange(50.0))
    place = np.stack([0.9 * row + 0.1 * col + 3, col - 0.05 * row + 2], axis=2)
    place += np.random.default_rng(0).normal(0, 0.05, place.shape)
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


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = lm.truth("corner")
    assert known.geometry is not None
    known.save(tmp_path / "T.npz")
    words = ["calibrate", str(tmp_path / "T.npz"), "-o", str(tmp_path / "rig.json")]
    assert main(words) == 2
    assert "neither a board nor the camera's focal length" in capsys.readouterr().err
    assert main([*words, "--focal", "128", "--baseline", "360mm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rms_epipolar"] < 0.5
    rig = lm.RigGeometry.load(tmp_path / "rig.json")
    assert (round(rig.baseline, 6), rig.units) == (360, "mm")
    for more, message in (
        (["--focal", "0"], "a focal length of 0"),
        (["--focal", "9", str(tmp_path)], "takes one scene"),
        (["--focal", "9", "--board", "9x7", "--square", "1"], "does not go with"),
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
