"""Probing: T times a mask entry by entry; and max-min of a capture's own frames."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from scipy.sparse import csr_array

import lightmatrix as lm
from tests.helpers.stores import transport as small_transport


@pytest.mark.parametrize("camera", [(5, 4), (3, 2, 3)])
def test_probing_is_a_product_entry_by_entry(camera: tuple[int, ...]) -> None:
    matrix = small_transport(camera)
    mask = csr_array(scipy.sparse.random_array(matrix.shape, density=0.3, rng=0))
    dense = matrix.to_matrix(dense_background=True).toarray()
    probed = lm.probe(matrix, mask)
    np.testing.assert_allclose(
        probed.to_matrix(dense_background=True).toarray(), dense * mask.toarray(), atol=1e-6
    )
    # A mask and its complement give T again.
    rest = lm.probe(matrix, csr_array(1 - mask.toarray()))
    both = (probed.sparse + rest.sparse).toarray()
    np.testing.assert_allclose(both, dense, atol=1e-6)


def test_masks_that_do_not_fit_are_refused() -> None:
    matrix = small_transport()
    for wrong in (scipy.sparse.eye_array(20), None, np.ones(42)):
        with pytest.raises(lm.InputError, match="probing mask of shape"):
            lm.probe(matrix, wrong)
    endless = csr_array(np.full(matrix.shape, np.inf))
    with pytest.raises(lm.InputError, match="not finite"):
        lm.probe(matrix, endless)


def test_max_min_of_a_sharp_scene() -> None:
    known = lm.truth("l_objects")
    patterns = lm.BernoulliPatterns((64, 64), 64, seed=0)
    capture = lm.simulate(known, patterns, exposure=0.2, noise=0)
    parts = lm.max_min(capture)
    direct = np.asarray(known.direct.sum(axis=1)).reshape(64, 64)
    others = np.asarray(known.indirect.sum(axis=1)).reshape(64, 64)
    for found, expected, most in ((parts.direct, direct, 0.35), (parts.global_, others, 0.8)):
        assert np.linalg.norm(found - expected) < most * np.linalg.norm(expected)
    assert (parts.direct >= 0).all()
    assert (parts.global_ >= 0).all()
    assert len(repr(parts)) < 200
