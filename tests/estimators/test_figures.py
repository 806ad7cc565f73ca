"""Small estimates have the figures that they had: a change of them is meant, or is a mistake.

Whoever means it runs `python -m tests.estimators.test_figures` and puts the printed lines here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.estimators.coherent import schedule
from lightmatrix.simulation.simulate import irradiance
from tests.estimators.test_growth import LARGE_FRAMES

# Each case with its light, pattern, background, entries, clipped share and footprint.
EXPECTED: dict[str, tuple[float, ...]] = {
    "coherent": (423.637, 10.56620, 10.17306, 8455, 0.149120, 2448.349),
    "growing": (423.054, 10.38358, 11.01740, 8568, 0.149120, 2453.346),
    "row_by_row": (370.753, 5.62333, 55.2661, 10673, 0.151135),
    "multi_scale": (371.084, 5.99952, 55.1593, 10286, 0.151135),
    "saturation_admm": (308.881, 5.73078, 108.2521, 9013, 0.149120),
    "romp": (397.170, 5.70825, 28.6750, 7988, 0.151135),
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
    return lm.estimate(photographed(24), check=False, correct="none")


def growing() -> lm.LightTransport:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "GROWTH", LARGE_FRAMES)
        return lm.estimate(photographed(24), check=False, correct="none")


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
