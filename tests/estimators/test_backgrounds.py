"""Backgrounds: halos fall off with distance, shares sum to one, cells are means of patterns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.row_solver import WALL, Backgrounds
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.transport.operator import cell_means


def backgrounds(shape: tuple[int, int], grid: tuple[int, int], count: int = 5) -> Backgrounds:
    return Backgrounds(grid, BernoulliPatterns(shape, count), BernoulliPatterns(shape, 3, seed=9))


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(st.integers(1, 20), st.integers(1, 20)),
    st.tuples(st.integers(1, 6), st.integers(1, 6)),
    st.integers(0, 2**16),
)
def test_halos_are_the_kernel_summed_over_cells(
    shape: tuple[int, int], grid: tuple[int, int], seed: int
) -> None:
    grid = min(grid[0], shape[0]), min(grid[1], shape[1])
    random = np.random.default_rng(seed)
    pixels = shape[0] * shape[1]
    rows = np.where(random.random((4, pixels)) < 0.3, random.random((4, pixels)), 0)
    rows[3] = 0
    shares = backgrounds(shape, grid).spread(csr_array(rows.astype(np.float32)))
    place = np.indices(shape).reshape(2, -1).astype(float)
    distance = ((place[:, :, None] - place[:, None, :]) ** 2).sum(axis=0)
    inside = cell_means(shape, grid).toarray() > 0
    light = rows @ (distance + (WALL * max(shape)) ** 2) ** -2.0 @ inside.T
    light[~rows.any(axis=1)] = inside.sum(axis=1)
    np.testing.assert_allclose(shares, light / light.sum(axis=1, keepdims=True), rtol=2e-4)


def test_most_of_a_halo_is_near() -> None:
    rows = csr_array(([1.0], ([0], [20 * 128 + 100])), shape=(1, 128 * 128), dtype=np.float32)
    shares = backgrounds((128, 128), (8, 8)).spread(rows).reshape(8, 8)
    assert shares.argmax() == 1 * 8 + 6
    assert shares[1, 6] > 0.25 > 20 * shares[7, 0]


@pytest.mark.parametrize("shape", [(300, 200), (128, 256)])
def test_large_projectors_are_halved_to_squares(shape: tuple[int, int]) -> None:
    pixels = shape[0] * shape[1]
    rows = csr_array(([1.0], ([0], [pixels - 1])), shape=(1, pixels), dtype=np.float32)
    shares = backgrounds(shape, (4, 4)).spread(rows)
    assert shares.argmax() == 15
    assert shares.sum() == pytest.approx(1, abs=1e-5)


def test_light_under_the_patterns() -> None:
    made = backgrounds((9, 7), (3, 2))
    random = np.random.default_rng(1)
    shares = random.dirichlet(np.ones(6), 4).astype(np.float32)
    images = np.concatenate([made.shown.images(), made.unseen.images()]).reshape(8, -1)
    expected = shares @ cell_means((9, 7), (3, 2)).toarray() @ images.T
    np.testing.assert_allclose(made.under_patterns(shares), expected, rtol=1e-5, atol=1e-6)
    assert made.cells(1.0, unseen=True).means.shape == (6, 8)
    assert made.cells(1.0, unseen=False).means.shape == (6, 5)
    assert backgrounds((9, 7), (1, 1)).cells(1.0, unseen=True).means.shape == (0, 8)


def test_a_cell_costs_the_less_the_larger_it_is() -> None:
    """0.05 of the clip level over the regularization, over the side of a cell in pixels."""
    made = backgrounds((9, 7), (3, 2))
    sizes = cell_means((9, 7), (3, 2)).toarray().astype(bool).sum(axis=1)
    assert len(np.unique(sizes)) > 1
    shares = made.cells(10.0, unseen=False).penalties
    np.testing.assert_allclose(shares, 0.05 * 10 / np.sqrt(sizes), rtol=1e-6)
