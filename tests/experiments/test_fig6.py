"""The real-scene figures, on one bundled scene and few methods."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from skimage.metrics import structural_similarity

from lightmatrix.evaluation.metrics import response_rmse
from lightmatrix.experiments import fig6, fig7
from lightmatrix.experiments.fig6 import Case
from lightmatrix.experiments.harness import Measured
from lightmatrix.experiments.measured_scene import bernoulli_capture, measured_scene
from lightmatrix.experiments.methods import METHODS, Reach
from lightmatrix.outputs.running import RunningResults
from lightmatrix.patterns.blocks import sampled_pixels

SCENE = "gripper"


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, Any]]:
    names = ["admm", "saturation-admm", "saturation-admm-multi-scale", "coherent"]
    names += ["admm-iterated", "saturation-admm-iterated"]
    return {name: fig6.measure(Case(SCENE, name, 64, 64)).rows[0] for name in names}


def test_clip_aware_beats_clip_blind_and_coherence_beats_both(
    rows: dict[str, dict[str, Any]],
) -> None:
    assert rows["saturation-admm"]["rmse"] < 0.9 * rows["admm"]["rmse"]
    assert rows["saturation-admm-multi-scale"]["rmse"] < rows["saturation-admm"]["rmse"]
    assert rows["coherent"]["rmse"] < 0.5 * rows["saturation-admm"]["rmse"]


@pytest.mark.parametrize("name", ["admm", "saturation-admm"])
def test_the_iterated_solver_reaches_the_minimum_of_its_objective(
    rows: dict[str, dict[str, Any]], name: str
) -> None:
    """To 0.02 % for ADMM; 0.5 % for Saturation ADMM, whose stand-in is the convex form."""
    iterated = rows[f"{name}-iterated"]
    assert iterated["rmse"] is None
    assert iterated["rmse_few"] == pytest.approx(rows[name]["rmse_few"], rel=0.007)
    assert iterated["rows"] == 32


def test_every_other_block_and_two_pixels_of_each_are_judged() -> None:
    blocks, few = fig6.judged_rows(SCENE, 64)
    assert len(blocks) == len(np.unique(blocks)) == 1024
    image = np.zeros(64 * 64, bool)
    image[blocks] = True
    grid = image.reshape(8, 8, 8, 8).swapaxes(1, 2)
    assert grid[::2, ::2].all()
    assert grid.sum() == 1024
    assert len(np.unique(few)) == 32
    assert np.isin(few, blocks).all()
    truth = measured_scene(SCENE, 64).truth.matrix
    middles = sampled_pixels((64, 64), 16, 4)
    for number, block in enumerate(blocks.reshape(-1, 64)):
        strongest = block[truth[block][:, [middles[number]]].toarray().argmax()]
        assert strongest in few


def test_the_rmse_is_response_rmse() -> None:
    """Judged on all rows it is `response_rmse`."""
    measured = fig6.measure(Case(SCENE, "coherent", 16, 64)).rows[0]
    scene = measured_scene(SCENE, 64)
    capture = bernoulli_capture(SCENE, 64, 16)
    estimate = METHODS[[m.name for m in METHODS].index("coherent")].estimate(
        capture, 1 / scene.exposure
    )
    blocks, _ = fig6.judged_rows(SCENE, 64)
    level = 1 / scene.exposure
    expected = response_rmse(estimate, scene.known, clip_level=level, rows=blocks)
    assert measured["rmse"] == pytest.approx(expected, rel=1e-5)


def test_rows_as_a_camera_of_blocks() -> None:
    capture = bernoulli_capture(SCENE, 64, 16)
    blocks, few = fig6.judged_rows(SCENE, 64)
    part = fig6.of_rows(capture, blocks)
    assert part.camera_shape == (128, 8)
    np.testing.assert_array_equal(part.samples().values, capture.samples().values[blocks])
    np.testing.assert_array_equal(
        fig6.of_rows(capture, few).samples().clipped, capture.samples().clipped[few]
    )


def forbidden(case: Case) -> Measured:
    raise AssertionError(f"{case.name} was kept")


def test_files_and_continuing(tmp_path: Path) -> None:
    chosen = [Case(SCENE, "admm", 16, 64), Case(SCENE, "admm-iterated", 16, 64)]
    experiment = replace(fig6.FIG6, cases=lambda quick: chosen)
    out, kept = tmp_path / "out", RunningResults.open(tmp_path / "out", ".cases")
    out.mkdir()
    seen: list[int] = []
    first = experiment.run(out, kept=kept, progress=lambda done, total: seen.append(done))
    assert seen == [1, 2]
    going_on = replace(experiment, measure=forbidden)
    assert going_on.run(out, kept=kept) == first
    # What was kept and is damaged is measured again.
    damaged = kept.file(f"{chosen[0].name}.npz")
    damaged.write_bytes(damaged.read_bytes()[:50])
    with pytest.raises(AssertionError, match="kept"):
        going_on.run(out, kept=kept)
    assert json.loads((out / "fig6.json").read_text())["parameters"]["lambda"] == 0.16
    with open(out / "fig6.csv") as file:
        assert len(list(csv.DictReader(file))) == 2
    for name in ("fig6.png", "fig6.svg"):
        assert (out / name).stat().st_size > 1000


def test_the_full_run_measures_every_method_everywhere() -> None:
    chosen = list(fig6.cases(quick=False))
    assert len(chosen) == len(set(chosen))
    for method in METHODS:
        counts = {case.observations for case in chosen if case.method == method.name}
        wanted = {k for k in fig6.OBSERVATIONS if method.reach is not Reach.CAMERA or k <= 256}
        assert counts == wanted


def test_relit_images_are_judged_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fig7, "SCENES", {SCENE: "gripper"})
    monkeypatch.setattr(fig7, "METHODS", ("saturation-admm", "coherent"))
    out, kept = tmp_path / "out", RunningResults.open(tmp_path / "out", ".cases")
    out.mkdir()
    result = fig7.FIG7.run(out, quick=True, kept=kept)
    plain, coherent, mixed = result["rows"]
    assert coherent["psnr"] > plain["psnr"] + 3
    assert coherent["ssim"] > plain["ssim"]
    # The highlights are in the shorter frames.
    assert mixed["psnr"] > coherent["psnr"] + 3
    assert len(kept.names) == 3
    assert fig7.FIG7.run(out, quick=True, kept=kept)["rows"] == result["rows"]
    assert (out / "fig7.png").stat().st_size > 1000


@pytest.mark.parametrize("noise", [0.01, 0.1, 0.5])
def test_the_structural_similarity_is_that_of_scikit_image(noise: float) -> None:
    random = np.random.default_rng(0)
    expected = ndimage.gaussian_filter(random.random((40, 30)), 2)
    expected[5:9, 6:20] += 0.5
    image = np.maximum(expected + noise * random.standard_normal(expected.shape), 0)
    displayed = [np.clip(part / np.quantile(expected, 0.99), 0, 1) for part in (image, expected)]
    # The mean of the whole map, margins too, which scikit-image leaves out.
    _, similarity = structural_similarity(  # type: ignore[no-untyped-call]
        *displayed, win_size=7, data_range=1, use_sample_covariance=False, full=True
    )
    assert fig7.quality(image, expected)["ssim"] == pytest.approx(similarity.mean(), rel=1e-9)


def test_image_quality_from_its_definition() -> None:
    random = np.random.default_rng(0)
    expected = random.random((40, 30))
    same = fig7.quality(expected, expected)
    assert same["ssim"] == pytest.approx(1)
    assert same["relative_error"] == 0
    wrong = fig7.quality(expected + 0.1, expected)
    peak = np.quantile(expected, 0.99)
    assert wrong["psnr"] == pytest.approx(20 * np.log10(peak / 0.1))
    assert wrong["ssim"] < 1
    noise = fig7.quality(random.random((40, 30)), expected)
    assert noise["ssim"] < 0.3
    bright = expected.copy()
    bright[3, 4] = 50.0
    highlight = fig7.quality(bright, expected)
    assert highlight["psnr"] < 10
    assert highlight["psnr_shown"] > 30


def test_the_logo_is_binary_at_any_size() -> None:
    for size in (16, 64, 100):
        image = fig7.logo(size)
        assert image.shape == (size, size)
        assert set(np.unique(image)) == {0, 1}
        assert 0.15 < image.mean() < 0.5
