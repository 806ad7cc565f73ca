"""The experiment on imperfect rigs: footprints, camera geometry and estimated errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.evaluation.metrics import relative_error
from lightmatrix.experiments import rigs
from lightmatrix.experiments.colour_rigs import COLOUR_RIGS
from lightmatrix.experiments.rigs import Case, measure, rig_capture, rig_truth
from lightmatrix.experiments.run import EXPERIMENTS
from lightmatrix.simulation.other_cameras import mapped, seen
from lightmatrix.simulation.truth import Truth

pytestmark = pytest.mark.usefixtures("small_scenes")
# Errors are those of 64 x 64, in a quarter of the time: .027 and .025 for l_objects blurred, .0102
# and .0123 for gripper turned.
SIDE = 32


def error_of(case: Case, estimator: CoherentEstimator | None = None) -> float:
    truth = rig_truth(case.scene, case.rig, case.side)
    transport = (estimator or CoherentEstimator()).estimate(rig_capture(case, truth))
    return relative_error(transport, truth.transport())


def test_blur_costs_no_patterns() -> None:
    """Measured: .027; by single pixels only several times as much."""
    case = Case("l_objects", "blur 1", 32, side=SIDE)
    assert error_of(case) < 0.035
    assert error_of(case, CoherentEstimator(sizes=(0.0,))) > 2.5 * 0.035


def test_the_orientation_of_the_camera_does_not_matter() -> None:
    straight = error_of(Case("gripper", "sharp", 32, side=SIDE))
    assert error_of(Case("gripper", "quarter turn", 32, side=SIDE)) < 1.1 * straight


def test_a_view_can_be_saved(tmp_path: Path) -> None:
    """Its camera is another one, whose geometry nobody knows."""
    turned = rig_truth("gripper", "cut-out", SIDE)
    turned.save(tmp_path / "T.npz")
    assert lm.truth(tmp_path / "T.npz").camera_shape == (SIDE // 2, SIDE // 2)


def test_a_gamma_of_the_camera_costs_nothing_once_it_is_found() -> None:
    straight = error_of(Case("l_objects", "sharp", 32, side=SIDE))
    case = Case("l_objects", "gamma 2.2, found", 32, side=SIDE)
    truth = rig_truth(case.scene, case.rig, SIDE)
    capture = rig_capture(case, truth)
    assert relative_error(lm.estimate(capture, check=False), truth.transport()) < 1.2 * straight
    as_linear = lm.estimate(capture, response="linear", check=False)
    assert relative_error(as_linear, truth.transport()) > 5 * straight


def test_gammas_of_camera_and_projector_are_found_in_grey_patterns() -> None:
    case = Case("l_objects", "both of gamma 2.2, found", 32, side=SIDE)
    capture = rig_capture(case, rig_truth(case.scene, case.rig, SIDE))
    assert capture.projector_unknown
    found = lm.find_projector_response(capture, camera=True)
    assert found.gamma == pytest.approx(2.2, rel=0.03)
    assert found.projector is not None
    assert found.projector.gamma == pytest.approx(2.2, rel=0.03)


def test_responses_that_are_not_determined_are_a_row_without_errors(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refused(_: lm.Capture) -> lm.LightTransport:
        raise lm.InputError("the photographs do not determine the camera's response")

    case = Case("l_objects", "gamma 2.2, found", 32, side=SIDE)
    found = measure(case)
    monkeypatch.setattr(rigs, "estimate", refused)
    undetermined = measure(case)
    assert undetermined.rows[0].keys() == found.rows[0].keys()
    assert np.isnan(undetermined.rows[0]["relative_error"])
    rigs._draw(tmp_path, [(case, found), (case, undetermined)])
    assert (tmp_path / "rigs.png").stat().st_size > 5000
    with pytest.raises(lm.InputError, match="do not determine"):
        measure(replace(case, rig="sharp"))


def test_colour_rigs_share_their_geometry_and_differ_in_colour() -> None:
    truths = [rig_truth("metal", rig, SIDE) for rig in COLOUR_RIGS]
    assert {truth.camera_shape for truth in truths} == {(SIDE, SIDE, 3)}
    same, _, surfaces, global_light = truths
    np.testing.assert_array_equal(surfaces.matrix.indices, same.matrix.indices)
    # A tinted surface scales a row; what tints global light again leaves direct light alone.
    row = slice(*surfaces.matrix.indptr[[600, 601]])
    shares = surfaces.matrix.data[row] / same.matrix.data[row]
    assert np.ptp(shares) < 1e-5
    np.testing.assert_allclose(global_light.direct_data, surfaces.direct_data)
    assert global_light.matrix.sum() < surfaces.matrix.sum()
    for (rig, (_, some)), truth in zip(COLOUR_RIGS.items(), truths, strict=True):
        patterns = rig_capture(Case("metal", rig, 8, side=SIDE), truth).patterns
        assert isinstance(patterns, lm.ColourPatterns)
        assert patterns.grey.sum() == (4 if some else 0)


def test_rows_in_colour_have_the_errors_of_all_primaries() -> None:
    measured = measure(Case("l_objects", "colour", 32, side=SIDE))
    assert measured.rows[0]["relative_error"] < 0.025
    assert measured.arrays["errors"].shape == measured.arrays["stated"].shape
    assert measured.arrays["errors"].size > 2 * SIDE * SIDE


def test_rows_have_an_estimated_error_and_a_footprint() -> None:
    measured = {rig: measure(Case("l_objects", rig, 32, side=SIDE)) for rig in ("sharp", "blur 2")}
    sizes = {rig: one.rows[0]["footprint"] for rig, one in measured.items()}
    assert sizes["sharp"] < 4
    # 4 pi sigma^2, and some more where several blurred footprints meet.
    assert 35 < sizes["blur 2"] < 70
    true, estimated = (
        np.concatenate([one.arrays[name] for one in measured.values()])
        for name in ("errors", "stated")
    )
    assert spearmanr(true, estimated)[0] > 0.6


def test_an_impossible_estimate_is_called_doubtful() -> None:
    """Camera pixels in random order have no useful neighbours."""
    truth = rig_truth("l_objects", "blur 2", SIDE)
    order = np.random.default_rng(0).permutation(SIDE * SIDE).reshape(SIDE, SIDE)
    shuffled = seen(truth, order)
    estimate = lm.estimate(rig_capture(Case("l_objects", "blur 2", 16, side=SIDE), shuffled))
    assert relative_error(estimate, shuffled.transport()) > 0.3
    judged = lm.verdict(estimate)
    assert judged.level == "doubtful"
    assert "More patterns" in judged.sentence


def test_views_show_the_same_rows() -> None:
    truth = rig_truth("metal", "sharp", SIDE)
    turned = seen(truth, mapped((SIDE, SIDE), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])))
    assert turned.camera_shape == (SIDE, SIDE)
    white = np.ones(truth.projector_shape)
    straight = truth.transport().relight(white)
    np.testing.assert_allclose(turned.transport().relight(white), np.rot90(straight), rtol=1e-6)
    beyond = seen(truth, np.array([[-1, 5]]))
    assert not beyond.transport().relight(white)[0, 0]
    np.testing.assert_allclose(
        np.asarray(beyond.direct.sum(axis=1)).ravel()[1],
        np.asarray(truth.direct.sum(axis=1)).ravel()[5],
    )


def test_a_view_of_a_colour_camera_is_refused() -> None:
    truth = rig_truth("metal", "sharp", SIDE)
    colour = Truth(truth.matrix, truth.direct_data, (SIDE, SIDE // 2, 2), truth.projector_shape)
    with pytest.raises(lm.InputError, match="colour"):
        seen(colour, np.zeros((2, 2), int))


def test_every_rig_can_be_photographed() -> None:
    for rig in (*rigs.VIEWS, *rigs.PHOTOGRAPHED, "camera 2x coarser", "camera 2x finer"):
        truth = rig_truth("l_objects", rig, SIDE)
        assert truth.matrix.sum() > 0
        if rig in rigs.PHOTOGRAPHED:
            capture = rig_capture(Case("l_objects", rig, 8, side=SIDE), truth)
            assert capture.samples(0, 4).values.shape == (4, 8)


def test_the_experiment_is_measured_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(quick: bool) -> Iterator[Case]:
        return (replace(case, side=SIDE) for case in rigs.cases(quick))

    monkeypatch.setitem(EXPERIMENTS, "rigs", replace(rigs.RIGS_EXPERIMENT, cases=few))
    assert main(["experiment", "rigs", "--quick", "-o", str(tmp_path / "rigs")]) == 0
    names = {path.name for path in (tmp_path / "rigs").iterdir()}
    assert {"rigs.json", "rigs.csv", "rigs.png", "confidence.png"} <= names
