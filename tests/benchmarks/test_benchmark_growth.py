"""The benchmark of growth: sizes as they are written, powers as they were put in."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import growth
from tests.helpers.systems import needs_posix


def test_sizes_are_sides_or_rows_and_columns() -> None:
    assert growth.size("128:96x128") == ((128, 128), (96, 128))
    with pytest.raises(ValueError, match="unpack"):
        growth.size("128")


def test_powers_are_found() -> None:
    pixels = np.array([[100, 400], [900, 400], [900, 100], [3600, 900]], float)
    seconds = 3 * pixels[:, 0] ** 0.9 * pixels[:, 1] ** 0.2
    assert growth.powers(np.column_stack([pixels, seconds])) == pytest.approx((0.9, 0.2))


@needs_posix("wait4")
def test_an_estimate_is_measured_in_a_process_of_its_own() -> None:
    found = growth.estimated((16, 16), (12, 16), 8)
    assert 0.02 < found["peak_gib"] < 2
    assert found["clock_s"] > 0
    assert found["processor_s"] > 0
