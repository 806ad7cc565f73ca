"""Backgrounds: halos fall off with distance, shares sum to one, cells are means of patterns."""

from __future__ import annotations

import numpy as np
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
