"""The claims of the experiments, on small scenes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import spearmanr

import lightmatrix as lm
from experiments import few_patterns, fig6, rigs, shape
from experiments.measured_scene import THREE_EXPOSURES, MeasuredScene
from experiments.other_cameras import seen
from experiments.rigs import rig_capture, rig_truth
from experiments.uses import compensation_rows, separation_rows
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.judgement.judgement import verdicts
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.shape.shape import Shape
from lightmatrix.simulation import library

pytestmark = pytest.mark.usefixtures("small_scenes")
SMALL = few_patterns.Case("gripper", "coherent", 64, 0, size=(32, 32))
SIDE = 32


def test_coherent_is_nearly_as_good_as_knowing_where_the_light_is() -> None:
    coherent, row_by_row, known = (
        few_patterns.measure(replace(SMALL, method=method)).rows[0]["relative_error"]
        for method in ("coherent", "row by row", "known support")
    )
    assert coherent < 0.2 * row_by_row
    assert coherent < 1.25 * known


def test_mixed_exposures_recover_clipped_responses() -> None:
    one = few_patterns.measure(SMALL).rows[0]["all_rows"]
    three = few_patterns.measure(replace(SMALL, exposures=THREE_EXPOSURES)).rows[0]["all_rows"]
    assert three < 0.3 * one


def test_a_camera_that_does_not_clip_has_the_same_noise() -> None:
    scene = MeasuredScene(library.truth("gripper"))
    patterns = lm.BernoulliPatterns((64, 64), 8)
    clipping, clean = (scene.capture(patterns, 0, clipping=clips) for clips in (True, False))
    assert clean.reference_level == pytest.approx(clipping.reference_level)
    a, b = clipping.samples(), clean.samples()
    assert a.clipped.any()
    assert not b.clipped.any()
    unit = clipping.reference_level
    assert np.abs(a.values - b.values)[~a.clipped].max() < 2 / 255 * unit
    assert (b.values[a.clipped] > 0.98 * unit).all()


@pytest.mark.slow
def test_clip_aware_beats_clip_blind_and_coherence_beats_both() -> None:
    names = ["admm", "saturation-admm", "saturation-admm-multi-scale", "coherent"]
    names += ["admm-iterated", "saturation-admm-iterated"]
    rows = {name: fig6.measure(fig6.Case("gripper", name, 64, 64)).rows[0] for name in names}
    assert rows["saturation-admm"]["rmse"] < 0.9 * rows["admm"]["rmse"]
    assert rows["saturation-admm-multi-scale"]["rmse"] < rows["saturation-admm"]["rmse"]
    assert rows["coherent"]["rmse"] < 0.5 * rows["saturation-admm"]["rmse"]
    # To 0.02 % for ADMM; 0.5 % for Saturation ADMM, whose stand-in is the convex form.
    for name in ("admm", "saturation-admm"):
        iterated = rows[f"{name}-iterated"]
        assert iterated["rmse_few"] == pytest.approx(rows[name]["rmse_few"], rel=0.007)


def rig_error(scene: str, rig: str, estimator: CoherentEstimator | None = None) -> float:
    truth = rig_truth(scene, rig, SIDE)
    capture = rig_capture(rigs.Case(scene, rig, 32, side=SIDE), truth)
    return relative_error((estimator or CoherentEstimator()).estimate(capture), truth.transport())


def test_blur_costs_no_patterns() -> None:
    """Measured: 0.027; by single pixels only several times as much."""
    assert rig_error("l_objects", "blur 1") < 0.035
    assert rig_error("l_objects", "blur 1", CoherentEstimator(sizes=(0.0,))) > 2.5 * 0.035


def test_the_orientation_of_the_camera_does_not_matter() -> None:
    assert rig_error("gripper", "quarter turn") < 1.1 * rig_error("gripper", "sharp")


@pytest.mark.slow
def test_gammas_of_camera_and_projector_are_found() -> None:
    case = rigs.Case("l_objects", "gamma 2.2, found", 32, side=SIDE)
    truth = rig_truth(case.scene, case.rig, SIDE)
    capture = rig_capture(case, truth)
    straight = rig_error("l_objects", "sharp")
    assert relative_error(lm.estimate(capture, check=False), truth.transport()) < 1.2 * straight
    as_linear = lm.estimate(capture, response="linear", check=False)
    assert relative_error(as_linear, truth.transport()) > 5 * straight
    case = replace(case, rig="both of gamma 2.2, found")
    found = lm.find_response(rig_capture(case, rig_truth(case.scene, case.rig, SIDE)))
    assert found.projector is not None
    assert (found.gamma, found.projector.gamma) == pytest.approx((2.2, 2.2), rel=0.03)


@pytest.mark.slow
def test_rows_have_an_estimated_error_and_a_footprint() -> None:
    measured = {
        rig: rigs.measure(rigs.Case("l_objects", rig, 32, side=SIDE))
        for rig in ("sharp", "blur 2", "colour")
    }
    sizes = {rig: one.rows[0]["footprint"] for rig, one in measured.items()}
    assert sizes["sharp"] < 4
    # 4 pi sigma^2, and some more where several blurred footprints meet.
    assert 35 < sizes["blur 2"] < 70
    assert measured["colour"].rows[0]["relative_error"] < 0.025
    true, estimated = (
        np.concatenate([one.arrays[name] for one in measured.values()])
        for name in ("errors", "stated")
    )
    assert spearmanr(true, estimated)[0] > 0.6


@pytest.mark.slow
def test_an_impossible_estimate_is_called_doubtful() -> None:
    """Camera pixels in random order have no useful neighbours."""
    truth = rig_truth("l_objects", "blur 2", SIDE)
    order = np.random.default_rng(0).permutation(SIDE * SIDE).reshape(SIDE, SIDE)
    shuffled = seen(truth, order)
    case = rigs.Case("l_objects", "blur 2", 16, side=SIDE)
    estimate = lm.estimate(rig_capture(case, shuffled))
    assert relative_error(estimate, shuffled.transport()) > 0.3
    judged = verdicts(estimate).transport
    assert judged.level == "doubtful"
    assert "More patterns" in judged.sentence


@pytest.mark.slow
def test_every_rig_can_be_photographed() -> None:
    for rig in rigs.RIGS:
        truth = rig_truth("l_objects", rig, SIDE)
        capture = rig_capture(rigs.Case("l_objects", rig, 8, side=SIDE), truth)
        assert capture.samples(0, 4).values.shape == (4, 8)


def test_undetermined_responses_are_a_row_without_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: lm.Capture) -> lm.LightTransport:
        raise lm.InputError("the photographs do not determine the camera's response")

    monkeypatch.setattr(rigs, "estimate", refused)
    case = rigs.Case("l_objects", "gamma 2.2, found", 32, side=SIDE)
    assert np.isnan(rigs.measure(case).rows[0]["relative_error"])
    with pytest.raises(lm.InputError, match="do not determine"):
        rigs.measure(replace(case, rig="sharp"))


@pytest.mark.slow
def test_t_is_more_often_right_than_codes_where_surfaces_light_each_other() -> None:
    rows = shape.measure(shape.Case("corner", 64, 0, patterns=16)).rows
    found = {row["method"]: row for row in rows}
    assert found["T"]["photographs"] == 16
    # 64 x 64 needs 2 x 6 bits, each with its inverse.
    assert found["Gray, inverse"]["photographs"] == 24
    codes = [row for method, row in found.items() if not method.startswith("T")]
    assert len(codes) == 3
    assert found["T"]["right"] > max(98.5, *(row["right"] for row in codes))
    assert found["T"]["wrong"] < min(1.5, *(row["wrong"] for row in codes))


def test_the_judge_of_shapes_knows_right_from_wrong() -> None:
    truth = lm.truth("l_objects")
    assert truth.depth is not None
    assert truth.geometry is not None
    reference = shape.Reference.of(truth)
    exact = lm.triangulate(truth.transport(), truth.geometry)

    def judged(depth: np.ndarray) -> dict[str, Any]:
        test = np.where(np.isfinite(depth), 0, 1).astype(np.uint8)
        shown = depth.astype(np.float32)
        return reference.judged(
            Shape(shown, exact.points, exact.normals, exact.albedo, exact.uncertainty,
                  exact.probability, test,
                  exact.place, exact.from_line, truth.geometry)  # type: ignore[arg-type]
        )  # fmt: skip

    perfect = judged(truth.depth)
    # A few pixels see surfaces that none of the points within them meets.
    assert perfect["right"] > 99.5
    assert perfect["wrong"] < 0.5
    far = truth.depth.copy()
    far[:32] *= 1.2
    assert judged(far)["wrong"] == pytest.approx(50, abs=3)
    far[:32] = np.nan
    assert judged(far)["wrong"] < 0.5


@pytest.mark.slow
def test_compensation_and_separation_beat_their_peers() -> None:
    truth = lm.truth("l_objects")
    exposure = lm.plan(truth, frames=32).exposure
    capture = lm.simulate(truth, lm.BernoulliPatterns((64, 64), 32), exposure=exposure)
    estimate = lm.estimate(capture)
    rows = compensation_rows(estimate, truth, "l_objects")
    psnr = {row["method"]: row["value"] for row in rows if row["metric"] == "PSNR"}
    assert psnr["pixel gains"] + 4 < psnr["estimate"] < psnr["true T"] + 0.3
    assert psnr["estimate"] > psnr["true T"] - 1.5
    rows = separation_rows(estimate, truth, "l_objects", seed=0)
    values = {(row["use"], row["method"], row["metric"]): row["value"] for row in rows}
    for use in ("separate", "separate, blur 1"):
        for metric in ("direct error", "global error"):
            ours, nayar, window = (
                values[use, method, metric]
                for method in ("T, separated", "Nayar, best square", "T, window 5 x 5")
            )
            assert 0 < ours < nayar < window
        assert values[use, "T, separated", "called direct"] <= 0.05
        assert values[use, "T, separated", "direct lost"] <= 0.003
        assert values[use, "T, separated", "epipolar direction off"] < 1.5
