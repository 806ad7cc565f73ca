"""Small estimates have the figures that they had: a change of them is meant, or is a mistake.

Whoever means it runs `python -m tests.estimators.test_figures` and puts the printed lines here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.estimators.coherent import schedule
from lightmatrix.simulation.irradiance import irradiance
from tests.estimators.test_growth import LARGE_FRAMES

# Each case with its light, pattern, background, entries, clipped share and footprint.
EXPECTED: dict[str, tuple[float, ...]] = {
    "coherent": (424.079, 11.03238, 10.82218, 8474, 0.142485, 2450.219),
    "growing": (423.461, 10.86457, 11.14268, 8527, 0.142485, 2457.433),
    "row_by_row": (370.337, 9.02333, 54.6435, 10756, 0.145523),
    "multi_scale": (370.901, 8.49990, 54.3809, 10138, 0.145523),
    "saturation_admm": (308.851, 4.16251, 106.1585, 9169, 0.142485),
    "romp": (396.528, 8.46072, 29.0541, 7993, 0.145523),
}


def figures(estimate: lm.LightTransport) -> tuple[float, ...]:
    """Numbers that hardly any change of an estimate leaves alone."""
    summary = estimate.summary()
    rows, columns = estimate.sparse.shape
    along, across = np.cos(0.7 * np.arange(rows)), np.cos(0.3 * np.arange(columns))
    numbers = (
        float(estimate.sparse.sum()),
        float(along @ (estimate.sparse @ across)),
        float(estimate.background.sum()),
        float(estimate.sparse.nnz),
        summary["clipped_samples"],
    )
    if "footprint" not in estimate.diagnostics:
        return numbers
    return *numbers, float(np.nansum(estimate.diagnostics["footprint"]))


def photographed(count: int) -> lm.Capture:
    """A scene of few pixels, at two exposures of which the longer one clips."""
    size = (26, 24)
    truth = lm.ProceduralScene((24, 28), size, seed=4, background=0.02, bounces=4).truth()
    patterns = lm.BernoulliPatterns(size, count, seed=1)
    exposure = np.where(np.arange(count) % 4 == 2, 0.5, 2.0)
    sensor = lm.Sensor(exposure, 0.0, 0.003, 0.0, 8)
    frames = sensor.expose(irradiance(truth.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(count, *truth.camera_shape)
    return lm.Capture.from_arrays(patterns, stack, sensor)


def coherent() -> lm.LightTransport:
    return lm.estimate(photographed(24), check=False)


def growing() -> lm.LightTransport:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "GROWTH", LARGE_FRAMES)
        return lm.estimate(photographed(24), check=False)


def row_by_row() -> lm.LightTransport:
    return lm.estimate(photographed(48), coherent=False, check=False)


def multi_scale() -> lm.LightTransport:
    return lm.estimate(photographed(48), multi_scale=True, check=False)


def saturation_admm() -> lm.LightTransport:
    capture = photographed(24)
    return lm.estimate(capture, solver="saturation-admm", iterations=40, check=False)


def romp() -> lm.LightTransport:
    return lm.estimate(photographed(48), solver="romp", check=False)


CASES: tuple[Callable[[], lm.LightTransport], ...] = (
    *(coherent, growing, row_by_row, multi_scale, saturation_admm, romp),
)


@pytest.mark.parametrize("case", CASES)
def test_figures_are_those_of_before(case: Callable[[], lm.LightTransport]) -> None:
    # Processors add up in different orders.
    expected = EXPECTED[case.__name__]
    assert figures(case()) == pytest.approx(expected, rel=3e-4)


if __name__ == "__main__":
    for each in CASES:
        print(f"    {each.__name__!r}: {figures(each())},")
