"""Thinning: the largest entries stay, and light stays where it was."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import csr_array

from lightmatrix.simulation.thinning import thinned

rows_of_light = arrays(
    np.float32,
    st.tuples(st.integers(1, 8), st.integers(1, 12)),
    elements=st.floats(0, 1, width=32).map(lambda v: v if v > 1e-3 else 0.0),
)


@settings(max_examples=80, deadline=None)
@given(rows_of_light, st.floats(0.05, 1), st.integers(0, 9))
def test_the_largest_entries_stay_and_rows_keep_their_sums(
    dense: np.ndarray, keep: float, seed: int
) -> None:
    matrix = csr_array(dense)
    share = np.random.default_rng(seed).random(matrix.nnz, dtype=np.float32)
    direct = matrix.data * np.where(share > 0.7, share, 0).astype(np.float32)
    thin, thin_direct = thinned(matrix, direct, keep)
    assert thin.has_canonical_format
    assert len(thin_direct) == thin.nnz
    assert (thin_direct <= thin.data).all()
    np.testing.assert_allclose(thin.sum(axis=1), dense.sum(axis=1), rtol=1e-5, atol=1e-6)
    for row, result in zip(dense.astype(np.float64), thin.toarray(), strict=True):
        ordered = np.sort(row)[::-1]
        total = row.sum()
        held = np.cumsum(ordered)
        # The fewest that hold the energy; with rounding, one more or less.
        needed = int((held < keep * total * (1 - 1e-6)).sum())
        must_stay = row > (ordered[needed] if needed < len(row) else np.inf)
        assert (result[must_stay] > 0).all()
        assert ((result > 0) <= (row > 0)).all()


def test_light_stays_in_its_neighbourhood() -> None:
    """A pattern that lights a part of the projector sees what it saw before."""
    random = np.random.default_rng(0)
    dense = random.random((300, 1000), dtype=np.float32) * 1e-3
    dense[:, 100] += 1
    dense[:, 500:] *= 3
    matrix = csr_array(dense)
    thin, _ = thinned(matrix, np.zeros_like(matrix.data), 0.9)
    assert thin.nnz < 0.9 * matrix.nnz
    for start, stop in ((0, 100), (200, 300), (600, 900), (950, 1000)):
        before, after = dense[:, start:stop].sum(), thin.toarray()[:, start:stop].sum()
        np.testing.assert_allclose(after, before, rtol=0.01)
