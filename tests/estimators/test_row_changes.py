"""Rows settle if nothing changes around them; rows that are solved again replace their own."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.neighbourhood import REACH
from lightmatrix.estimators.coherent.rounds import (
    CHANGE,
    replaced,
    unchanged,
    unsettled,
    with_change,
)
from lightmatrix.transport.sparse_rows import SparseRows


def rows(values: list[list[float]], **diagnostics: list[float]) -> SparseRows:
    matrix = csr_array(np.array(values, np.float32))
    kept = {name: np.array(each, np.float32) for name, each in diagnostics.items()}
    return SparseRows(matrix, np.zeros((len(values), 1), np.float32), kept)


def test_the_change_is_a_share_of_the_light() -> None:
    before = rows([[1, 0, 2], [0, 4, 0], [0, 0, 3], [0, 0, 0]])
    now = rows([[2, 0, 2], [0, 0, 4], [0, 0, 0], [0, 0, 0]], other=[1, 2, 3, 4])
    changed = with_change(now, before)
    # A row that lost all of its light changed as a whole; one that never had any did not.
    np.testing.assert_allclose(changed.diagnostics[CHANGE], [1 / 4, 8 / 4, 1, 0])
    np.testing.assert_array_equal(changed.diagnostics["other"], [1, 2, 3, 4])
    assert (changed.coefficients != now.coefficients).nnz == 0


def test_a_change_unsettles_the_rows_around_it() -> None:
    camera = (11, 13, 2)
    change = np.zeros(camera, np.float32)
    change[5, 6, 1] = 0.03
    change[0, 0, 0] = 0.01
    count = change.size
    all_rows = rows([[1.0]] * count, **{CHANGE: [float(each) for each in change.ravel()]})
    moving = unsettled(all_rows, camera).reshape(camera)
    expected = np.zeros(camera, bool)
    expected[5 - REACH : 6 + REACH, 6 - REACH : 7 + REACH, 1] = True
    np.testing.assert_array_equal(moving, expected)


def test_new_rows_take_the_places_of_the_old_ones() -> None:
    old = rows([[1, 0], [2, 0], [3, 0], [4, 0]], **{CHANGE: [0.5, 0.5, 0.5, 0.5]})
    new = rows([[0, 7], [0, 8]], **{CHANGE: [0.1, 0.2]})
    joined = replaced(old, new, np.array([1, 3]))
    np.testing.assert_array_equal(joined.coefficients.toarray(), [[1, 0], [0, 7], [3, 0], [0, 8]])
    np.testing.assert_allclose(joined.diagnostics[CHANGE], [0, 0.1, 0, 0.2])
    assert not unchanged(old).diagnostics[CHANGE].any()
