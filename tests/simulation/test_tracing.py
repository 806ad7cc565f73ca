"""Sums of contributions against plain addition."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.simulation.renderer import sum_contributions


@pytest.mark.parametrize(
    ("shape", "count"), [((7, 5), 400), ((1, 1), 9), ((3, 4), 0), ((40, 2), 3)]
)
def test_sums_are_those_of_plain_addition(shape: tuple[int, int], count: int) -> None:
    random = np.random.default_rng(count)
    place = random.integers(0, shape[0] * shape[1], count).astype(np.uint32)
    value = np.maximum(random.random(count) - 0.2, 0).astype(np.float32)
    direct = random.random(count) < 0.4
    expected = np.zeros(shape[0] * shape[1], np.complex128)
    np.add.at(expected, place, value + 1j * value * direct)
    sums = sum_contributions(place, value, direct, shape)
    assert sums.has_canonical_format
    assert (sums.data.real > 0).all()
    np.testing.assert_allclose(sums.toarray(), expected.reshape(shape), rtol=1e-6)
    order = random.permutation(count)
    shuffled = place[order], value[order], direct[order]
    again = sum_contributions(*shuffled, shape)
    np.testing.assert_array_equal(again.toarray(), sums.toarray())


def test_the_last_place_of_32_bits_is_summed() -> None:
    place = np.array([2**32 - 1, 0, 2**32 - 1], np.uint32)
    light = np.array([1, 2, 3], np.float32)
    direct = np.array([True, False, False])
    sums = sum_contributions(place, light, direct, (2**14, 2**18))
    assert sums.nnz == 2
    assert sums[2**14 - 1, 2**18 - 1] == 4 + 1j
    assert sums[0, 0] == 2
