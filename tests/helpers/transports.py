"""Small light transport matrices for tests of what is computed from them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, random_array

import lightmatrix as lm

ROWS, COLS = 9, 7


def random_transport() -> lm.LightTransport:
    """30 random rows over a projector of 9 x 7, one of them dark, with a background."""
    generator = np.random.default_rng(3)
    sparse = random_array((30, ROWS * COLS), density=0.2, rng=generator, format="csr")
    dense = sparse.toarray().astype(np.float32)
    dense[4] = 0
    background = generator.random((30, 2)).astype(np.float32)
    return lm.LightTransport(csr_array(dense), background, (5, 6), (ROWS, COLS), (2, 1))
