"""Forward simulation: the same product, whatever the threads."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.simulation import simulate
from lightmatrix.simulation.procedural import ProceduralScene


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 40))
def test_light_is_the_dense_product(rows: int, cols: int, count: int) -> None:
    truth = ProceduralScene((5, 4), (rows, cols)).truth()
    patterns = BernoulliPatterns((rows, cols), count)
    light = simulate.irradiance(truth.matrix, patterns)
    expected = truth.matrix.toarray().astype(float) @ patterns.dense().T
    assert light.dtype == np.float32
    np.testing.assert_allclose(light, expected, rtol=1e-5, atol=1e-6)


def test_threads_and_blocks_do_not_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = ProceduralScene((32, 32), (16, 16)).truth()
    patterns = HadamardPatterns((16, 16), 64)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    one = simulate.irradiance(truth.matrix, patterns)
    monkeypatch.setattr(simulate, "_BLOCK_ENTRIES", 999)
    monkeypatch.setattr(simulate, "_CACHED_VALUES", 256 * 20)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    many = simulate.irradiance(truth.matrix, patterns)
    np.testing.assert_array_equal(one, many)


def test_progress_ends_at_the_last_row() -> None:
    truth = ProceduralScene((8, 8), (4, 4)).truth()
    seen: list[tuple[int, int]] = []
    simulate.irradiance(
        truth.matrix,
        BernoulliPatterns((4, 4), 2),
        progress=lambda done, all_: seen.append((done, all_)),
    )
    assert seen[-1] == (64, 64)


def test_patterns_of_another_projector_are_refused() -> None:
    truth = ProceduralScene((8, 8), (4, 4)).truth()
    with pytest.raises(InputError, match="5 x 4"):
        simulate.irradiance(truth.matrix, BernoulliPatterns((5, 4), 2))
