"""Metrics from their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from experiments.harness import benchmark_exposure
from lightmatrix.errors import InputError
from lightmatrix.judgement.metrics import (
    diffuse_rows,
    relative_error,
    relighting_error,
    response_rmse,
    squared_errors,
    unclipped_rows,
    unseen_patterns,
)
from lightmatrix.patterns.blocks import sampled_pixels
from lightmatrix.transport.matrix import LightTransport


@pytest.fixture
def pair() -> tuple[LightTransport, LightTransport]:
    """An estimate with a background, and a truth."""
    random = np.random.default_rng(0)
    dense = random.random((2, 30, 16 * 16)) * (random.random((2, 30, 256)) < 0.1)
    truth = LightTransport.from_matrix(csr_array(dense[0]), (5, 6), (16, 16))
    background = random.random((30, 1)).astype(np.float32)
    matrix = csr_array(dense[1], dtype=np.float32)
    return LightTransport(matrix, background, (5, 6), (16, 16)), truth


def test_errors_follow_their_definitions(pair: tuple[LightTransport, LightTransport]) -> None:
    estimate, truth = pair
    everything = np.arange(30)
    a, b = (
        estimate.to_matrix(dense_background=True)[everything].toarray(),
        truth.to_matrix(dense_background=True)[everything].toarray(),
    )
    assert relative_error(estimate, truth) == pytest.approx(
        np.linalg.norm(a - b) / np.linalg.norm(b), rel=1e-5
    )
    rows = np.array([3, 17, 4])
    assert relative_error(estimate, truth, rows) == pytest.approx(
        np.linalg.norm((a - b)[rows]) / np.linalg.norm(b[rows]), rel=1e-5
    )
    columns = sampled_pixels((16, 16))
    rmse = np.sqrt(np.mean((a - b)[:, columns] ** 2))
    assert response_rmse(estimate, truth, clip_level=2.0) == pytest.approx(rmse / 2, rel=1e-5)
    patterns = np.stack(list(unseen_patterns((16, 16)).values()))
    flat = patterns.reshape(5, -1)
    expected = np.mean(
        np.linalg.norm(flat @ (a - b).T, axis=1) / np.linalg.norm(flat @ b.T, axis=1)
    )
    assert relighting_error([estimate], [truth], patterns) == pytest.approx(expected, rel=1e-4)
    assert relative_error(truth, truth) == 0


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(st.integers(1, 5), st.integers(1, 5)),
    st.tuples(st.integers(1, 5), st.integers(1, 5)),
    st.integers(0, 99),
)
def test_squared_errors_need_no_dense_matrix(
    grid: tuple[int, int], other_grid: tuple[int, int], seed: int
) -> None:
    random = np.random.default_rng(seed)

    def transport(grid: tuple[int, int]) -> LightTransport:
        sparse = random.random((12, 35)) * (random.random((12, 35)) < 0.2)
        background = random.random((12, grid[0] * grid[1])).astype(np.float32)
        matrix = csr_array(sparse, dtype=np.float32)
        return LightTransport(matrix, background, (3, 4), (5, 7), grid)

    estimate, truth = transport(grid), transport(other_grid)
    rows = np.arange(12)
    a, b = (
        estimate.to_matrix(dense_background=True)[rows].toarray(),
        truth.to_matrix(dense_background=True)[rows].toarray(),
    )
    wrong, total = squared_errors(estimate, truth)
    np.testing.assert_allclose(wrong, np.square(a - b).sum(axis=1), rtol=1e-4)
    np.testing.assert_allclose(total, np.square(b).sum(axis=1), rtol=1e-4)


def test_benchmark_exposure_clips_a_fifth_of_the_single_responses() -> None:
    random = np.random.default_rng(1)
    truth = LightTransport.from_matrix(csr_array(random.random((1000, 4))), (10, 100), (2, 2))
    exposure = benchmark_exposure(truth)
    maximum = truth.sparse.toarray().max(axis=1)
    assert np.mean(maximum * exposure > 1) == pytest.approx(0.2, abs=0.01)
    np.testing.assert_array_equal(unclipped_rows(truth, exposure), maximum * exposure <= 0.98)


def test_diffuse_rows_have_no_dominant_window() -> None:
    rows = np.zeros((4, 8, 8))
    rows[0, 3:6, 3:6] = 1
    rows[1] = 1
    rows[2, 0, 0] = 1
    rows[2, 7, 7] = 1.01
    matrix = csr_array(rows.reshape(4, -1))
    np.testing.assert_array_equal(diffuse_rows(matrix, (8, 8)), [False, True, False, False])


def test_different_rigs_are_not_compared(pair: tuple[LightTransport, LightTransport]) -> None:
    estimate, truth = pair
    other = LightTransport.from_matrix(truth.sparse, (6, 5), (16, 16))
    with pytest.raises(InputError, match="the same binning"):
        relative_error(estimate, other)
