"""Thinning: the largest entries stay, rows keep their sums."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import csr_array

from lightmatrix.rig.thinning import thinned

rows_of_light = arrays(
    np.float32,
    st.tuples(st.integers(1, 8), st.integers(1, 12)),
    elements=st.floats(0, 1, width=32).map(lambda v: v if v > 1e-3 else 0.0),
)


@settings(max_examples=60, deadline=None)
@given(rows_of_light, st.floats(0.05, 1), st.integers(0, 9))
def test_the_fewest_entries_with_enough_energy_stay(
    dense: np.ndarray, keep: float, seed: int
) -> None:
    matrix = csr_array(dense)
    share = np.random.default_rng(seed).random(matrix.nnz, dtype=np.float32)
    direct = matrix.data * np.where(share > 0.7, share, 0).astype(np.float32)
    thin, thin_direct = thinned(matrix, direct, keep)
    assert thin.has_canonical_format
    assert len(thin_direct) == thin.nnz
    assert (thin_direct <= thin.data * (1 + 1e-5)).all()
    for row in range(len(dense)):
        ordered = np.sort(dense[row])[::-1]
        kept = thin.indptr[row + 1] - thin.indptr[row]
        total = ordered.sum(dtype=np.float64)
        assert ordered[:kept].sum(dtype=np.float64) >= keep * total * (1 - 1e-5)
        if kept > 0:
            assert ordered[: kept - 1].sum(dtype=np.float64) <= keep * total * (1 + 1e-5)


@settings(max_examples=40, deadline=None)
@given(rows_of_light, st.floats(0.05, 1))
def test_rows_keep_their_sums(dense: np.ndarray, keep: float) -> None:
    matrix = csr_array(dense)
    for direct in (np.zeros_like(matrix.data), matrix.data / 2, matrix.data):
        thin, _ = thinned(matrix, direct, keep)
        np.testing.assert_allclose(thin.sum(axis=1), dense.sum(axis=1), rtol=1e-5, atol=1e-6)
