"""Total variation against its definition, another solver, and what single-pixel detectors see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.restoration import denoise_tv_chambolle

import lightmatrix as lm
from lightmatrix.solvers.total_variation import _filtered, adjoint, differences


def blocks(shape: tuple[int, int]) -> np.ndarray:
    """A picture of flat surfaces, (1, N)."""
    row, col = np.indices(shape)
    picture = 0.2 + 0.5 * (row > shape[0] // 3) * (col > shape[1] // 2) + 0.3 * (row > col)
    return picture.reshape(1, -1)


def problem(
    patterns: lm.PatternSet, values: np.ndarray, clip: float = 1e9, regularization: float = 1e-3
) -> lm.Problem:
    samples = lm.Samples(np.minimum(values, clip), values > clip, np.full(patterns.count, clip))
    return lm.Problem(patterns, samples, regularization, background=False)


@given(rows=st.integers(1, 9), cols=st.integers(1, 9), seed=st.integers(0, 99))
def test_the_adjoint_and_the_filter_fit_the_differences(rows: int, cols: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    x, g = random.random((2, rows, cols)), random.random((2, 2, rows, cols))
    assert (differences(x) * g).sum() == pytest.approx((x * adjoint(g)).sum())
    y = _filtered(x)
    np.testing.assert_allclose(2 * y + adjoint(differences(y)), x, atol=1e-12)


def test_single_pixels_are_denoised_as_by_scikit_image() -> None:
    picture = blocks((16, 12)).reshape(16, 12)
    noisy = picture + 0.1 * np.random.default_rng(0).standard_normal(picture.shape)
    known = denoise_tv_chambolle(noisy, weight=0.1, eps=1e-12, max_num_iter=20000)  # type: ignore[no-untyped-call]
    one = problem(lm.make_patterns("onepixel", (16, 12)), noisy.reshape(1, -1), regularization=0.1)
    found = lm.solve(one, lm.TotalVariation(tolerance=1e-5, max_iterations=9000))
    assert found.converged.all()
    np.testing.assert_allclose(found.coefficients.toarray().reshape(16, 12), known, atol=1e-3)
    variation = np.linalg.norm(differences(known[None]), axis=1).sum()
    least = 0.1 * variation + ((known - noisy) ** 2).sum() / 2
    assert found.objective[0] == pytest.approx(least, rel=1e-4)


def test_no_step_in_any_direction_is_better() -> None:
    random = np.random.default_rng(1)
    patterns = lm.BernoulliPatterns((8, 8), 24)
    values = patterns.forward(blocks((8, 8))) + 0.02 * random.standard_normal((1, 24))
    one = problem(patterns, values, regularization=0.05)
    found = lm.solve(one, lm.TotalVariation(tolerance=1e-7))
    best = found.coefficients.toarray()

    def value(x: np.ndarray) -> float:
        variation = np.linalg.norm(differences(x.reshape(1, 8, 8)), axis=1).sum()
        return float(0.05 * variation + ((patterns.forward(x) - values) ** 2).sum() / 2)

    assert found.objective[0] == pytest.approx(value(best), rel=1e-6)
    # Other regularizations end elsewhere.
    for factor in (0.8, 1.25):
        other = lm.solve(replace(one, regularization=0.05 * factor), lm.TotalVariation())
        assert value(other.coefficients.toarray()) > value(best)
    levels = np.quantile(best, np.linspace(0.05, 0.95, 19))
    for surface in (best > levels[:, None]).astype(float)[:, None]:
        for size in (-1e-3, -1e-5, 1e-5, 1e-3):
            assert value(np.maximum(best + size * surface, 0)) >= value(best) - 1e-7
    for _ in range(200):
        step = random.standard_normal((1, 64)) * 10.0 ** random.uniform(-4, 0)
        assert value(np.maximum(best + step, 0)) >= value(best) - 1e-7


def test_pictures_from_a_quarter_of_the_patterns_and_a_white_one_that_clips() -> None:
    patterns, true = lm.make_patterns("hadamard", (32, 32), count=256), blocks((32, 32))
    values = patterns.forward(true)
    clip = 0.9 * values.max()
    errors = {}
    whole = problem(patterns, values, 1e9, 0.1)
    clipped = problem(patterns, values, clip, 0.1)
    unmarked = replace(clipped.samples, clipped=np.zeros_like(clipped.samples.clipped))
    for name, one in (
        ("whole", whole),
        ("bounded", clipped),
        ("clip-blind", replace(clipped, samples=unmarked)),
    ):
        found = lm.solve(one, lm.TotalVariation()).coefficients.toarray()
        errors[name] = np.linalg.norm(found - true) / np.linalg.norm(true)
    assert errors["whole"] < 0.06
    assert errors["bounded"] < 1.2 * errors["whole"]
    assert errors["clip-blind"] > 1.5 * errors["whole"]


def test_the_estimate_of_a_single_pixel_detector() -> None:
    patterns, true = lm.make_patterns("hadamard", (32, 32), count=256), blocks((32, 32))
    true = true / true.sum()
    noise = 0.001 * np.random.default_rng(0).standard_normal((1, 256))
    frames = np.rint(4095 * (0.9 * patterns.forward(true) + noise)).clip(0, 4095)
    capture = lm.Capture.from_arrays(
        patterns, frames.astype(np.uint16).reshape(256, 1, 1), lm.Sensor(bits=12)
    )
    errors = []
    for solver in ("total-variation", "active-set"):
        found = lm.estimate(capture, solver=solver, check=False).sparse.toarray() / 0.9
        errors.append(np.linalg.norm(found - true) / np.linalg.norm(true))
    assert errors[0] < 0.12
    assert errors[1] > 3 * errors[0]
    with pytest.raises(lm.InputError, match="cannot be estimated in blocks"):
        lm.estimate(capture, solver="total-variation", multi_scale=True)
    with pytest.raises(lm.InputError, match="cannot use the fidelity rejection"):
        lm.estimate(capture, solver="total-variation", fidelity="rejection")
