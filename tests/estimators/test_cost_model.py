"""The model of memory and time: what takes more, and what was measured."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

import lightmatrix as lm
from lightmatrix.estimators.cost_model import (
    COEFFICIENTS,
    LOADED_BYTES,
    EstimateSize,
    first_round_cost,
    memory_terms,
    time_terms,
)

GIB = 2**30


def test_more_of_everything_takes_more() -> None:
    for kind in COEFFICIENTS:
        for terms, what in ((memory_terms, "bytes"), (time_terms, "seconds")):
            coefficients = COEFFICIENTS[kind][what]

            def total(rows: int, pixels: int, count: int, grey: bool) -> float:
                quantities = terms(kind, rows, pixels, count, grey)  # noqa: B023
                return sum(coefficients[name] * quantities[name] for name in coefficients)  # noqa: B023

            usual = total(4096, 4096, 64, False)
            assert usual > 0
            assert total(8192, 4096, 64, False) > usual
            assert total(4096, 8192, 64, False) > usual
            assert total(4096, 4096, 128, False) > usual
            assert total(4096, 4096, 64, True) >= usual


def test_the_coherent_estimate_has_pseudo_samples_beside_the_frames() -> None:
    plain, coherent = (
        memory_terms(kind, 100, 1000, 32, False)["value"] for kind in ("plain", "coherent")
    )
    assert plain == 1000 * 32
    assert coherent > plain


def documented() -> list[tuple[tuple[int, int], int, float, float]]:
    """Camera, projector pixels, processor seconds and GiB of each estimate in docs/scale.md."""
    page = Path(__file__).parents[2] / "docs" / "scale.md"
    cells = [line.replace(",", "").split("|")[1:-1] for line in page.read_text().splitlines()]
    rows = []
    for row in cells:
        sides = re.fullmatch(r"(\d+) x (\d+) \D*(\d+) x (\d+) ", "".join(row[:2]).lstrip())
        if sides and len(row) == 5:
            a, b, c, d = map(int, sides.groups())
            rows.append(((a, b), c * d, float(row[3]), float(row[4])))
    return rows


def test_forecasts_agree_with_the_measurements_in_the_documentation() -> None:
    cases = documented()
    assert len(cases) == 2
    for camera, pixels, seconds, gigabytes in cases:
        size = EstimateSize(
            "coherent", camera, pixels, 64, False, windows=lm.CoherentEstimator.windows
        )
        assert size.memory / GIB == pytest.approx(gigabytes, rel=0.2), camera
        assert 1 / 1.7 < (size.seconds(1) or 0) / seconds < 1.7, camera
    # Row by row with 256 patterns: a megapixel takes 18 to 22 minutes of two cores and 2.0 GiB.
    plain = EstimateSize("plain", (1024, 1024), 768 * 1024, 256, False)
    assert 18 * 60 / 1.7 < (plain.seconds(2) or 0) < 22 * 60 * 1.7
    assert 1.5 < plain.memory / GIB < 6


def test_grey_patterns_take_longer_and_binned_samples_more_memory() -> None:
    for method in ("coherent", "plain"):
        size = EstimateSize(
            method, (64, 64), 256 * 256, 64, False, windows=lm.CoherentEstimator.windows
        )
        grey = replace(size, grey=True)
        seconds = [each.seconds(1) or 0 for each in (size, grey)]
        assert 1.1 < seconds[1] / seconds[0] < 100
        start = COEFFICIENTS[size.kind]["seconds"]["start"]
        assert size.seconds(4) == pytest.approx(start + (seconds[0] - start) / 4)
        # Each sample that is kept in 5 bytes takes 4 more than one of 1 byte.
        binned = replace(size, sample_bytes=5)
        assert binned.memory - size.memory == 4 * 64 * 64 * 64
        assert replace(size, check_bytes=10 * GIB).memory == LOADED_BYTES + 10 * GIB


def test_samples_that_lie_on_disk_take_no_memory() -> None:
    small = EstimateSize("plain", (1000, 1000), 64, 1000, False, sample_bytes=2)
    assert small.temporary == 0
    large = replace(small, camera=(1200, 1000))
    assert large.temporary == 1200 * 1000 * 1000 * 2
    assert large.memory < small.memory + GIB


def test_the_first_round_takes_a_larger_share_of_large_projectors() -> None:
    costs = [first_round_cost(64 * 64, side * side, 32, False) for side in (32, 64, 128, 256)]
    assert costs == sorted(costs)
    # All rows searching 64 x 64 pixels take about as long as 1 to 5 of the later rounds.
    assert 1 < costs[1] < 5


def test_other_solvers_keep_all_values_of_patterns() -> None:
    """Only the active set takes no more memory for further ones."""
    few, many = (EstimateSize("other", (9, 9), 1 << 14, count, False) for count in (4096, 8192))
    assert many.memory > 1.8 * few.memory
