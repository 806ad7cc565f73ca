"""The compiled correlation pass against its definition in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightmatrix._core import PreparedPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

INSTRUCTIONS = ("portable", "avx2", "avx512", "amx")


def prepared(patterns: PatternSet, instructions: str) -> PreparedPatterns:
    """Patterns prepared for an instruction set; skips the test if the CPU does not have it."""
    try:
        return patterns.prepare(instructions=instructions)
    except ValueError as error:
        assert instructions != "portable"
        pytest.skip(str(error))


def check(core: PreparedPatterns, patterns: PatternSet, e: NDArray[np.float64]) -> None:
    scores, bounds = core.scores(e)
    unit, offset, up, down = bounds.reshape(-1, 4).T[:, :, None]
    exact = e @ patterns.dense().astype(np.float64)
    slack = 1e-9 * np.abs(e).sum(axis=1, keepdims=True)
    assert (exact <= unit * (scores + offset + up) + slack).all()
    assert (exact >= unit * (scores + offset - down) - slack).all()


@pytest.mark.parametrize("instructions", INSTRUCTIONS)
@given(
    shape=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    count=st.integers(1, 60),
    rows=st.integers(1, 7),
    seed=st.integers(0, 99),
    kind=st.sampled_from(["bernoulli", "hadamard", "images"]),
)
@settings(max_examples=80, deadline=None)
def test_scores_bound_the_correlations(
    instructions: str, shape: tuple[int, int], count: int, rows: int, seed: int, kind: str
) -> None:
    rng = np.random.default_rng(seed)
    patterns: PatternSet
    if kind == "bernoulli":
        patterns = BernoulliPatterns(shape, count, seed=seed)
    elif kind == "hadamard":
        count = min(count, shape[0] * shape[1])
        patterns = HadamardPatterns(shape, count, order="random", permute=True, seed=seed)
    else:
        patterns = ImagePatterns(rng.random((count, *shape)).astype(np.float32))
    e = rng.normal(size=(rows, count))
    check(prepared(patterns, instructions), patterns, e)


@pytest.mark.parametrize("instructions", INSTRUCTIONS[1:])
def test_instruction_sets_give_the_same_scores(instructions: str) -> None:
    patterns = BernoulliPatterns((61, 67), 131)
    e = np.random.default_rng(0).normal(size=(5, 131))
    portable = prepared(patterns, "portable").scores(e)
    other = prepared(patterns, instructions).scores(e)
    np.testing.assert_array_equal(other[0], portable[0])
    np.testing.assert_array_equal(other[1], portable[1])
