"""The one-pass matrix against the renderer's own path integrator with a textured projector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.simulation.renderer import load_mitsuba, mitsuba_scene, render
from lightmatrix.simulation.scenes import scene
from tests.helpers.renderer import needs_llvm

pytestmark = needs_llvm


@pytest.fixture(scope="module")
def mitsuba() -> Any:
    return load_mitsuba()


def test_patterns(side: int) -> NDArray[np.float32]:
    rows, cols = np.indices((side, side))
    block = np.zeros((side, side))
    block[side // 4 : side * 3 // 4, side // 2 : side * 3 // 4] = 1
    ramp = (3 * rows + cols) / (4 * side - 4)
    white, checker = np.ones((side, side)), (rows // 3 + cols // 3) % 2
    return np.stack([white, checker, block, ramp]).astype(np.float32)


test_patterns.__test__ = False  # type: ignore[attr-defined]


def reference(
    mi: Any, name: str, pattern: NDArray[np.float32], samples: int, depth: int
) -> tuple[NDArray[np.float64], float, float]:
    """The path integrator's image; relative noise of it and of its sum, from two halves."""
    integrator = {"type": "path", "max_depth": depth, "rr_depth": 1000}
    loaded = mitsuba_scene(mi, scene(name), pattern.shape, pattern.shape, pattern, integrator)
    halves = [
        np.asarray(mi.render(loaded, spp=samples, seed=seed), np.float64).mean(axis=2).ravel()
        for seed in (101, 202)
    ]
    mean = (halves[0] + halves[1]) / 2
    noise = np.linalg.norm(halves[0] - halves[1]) / 2
    return mean, float(noise / np.linalg.norm(mean)), float(noise / mean.sum())


@pytest.mark.parametrize(
    "name",
    [
        "metal",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("l_objects", "gripper", "corner")
        ),
    ],
)
def test_relighting_agrees_with_the_path_integrator(mitsuba: Any, name: str) -> None:
    side, samples = 16, 2048
    # Four times as many paths as both halves of the reference have: measured, 1.24 of its noise.
    truth = render(name, (side, side), samples=8 * samples, keep=1.0)
    for pattern in test_patterns(side):
        expected, noise, sum_noise = reference(
            mitsuba, name, pattern, samples, truth.metadata["max_depth"] + 1
        )
        image = truth.matrix @ pattern.ravel() / truth.metadata["scale"]
        assert np.linalg.norm(image - expected) <= 1.5 * noise * np.linalg.norm(expected)
        # 0.1 %, which so few pixels know only up to their noise.
        assert image.sum() == pytest.approx(expected.sum(), rel=max(1e-3, 4 * sum_noise))
        assert sum_noise < 3e-3


def test_the_direct_part_agrees_with_paths_of_one_bounce(mitsuba: Any) -> None:
    side, samples = 16, 1024
    truth = render("metal", (side, side), samples=4 * samples, keep=1.0)
    pattern = test_patterns(side)[3]
    expected, noise, sum_noise = reference(mitsuba, "metal", pattern, samples, 2)
    image = truth.direct @ pattern.ravel() / truth.metadata["scale"]
    assert np.linalg.norm(image - expected) <= 1.5 * noise * np.linalg.norm(expected)
    assert image.sum() == pytest.approx(expected.sum(), rel=max(1e-3, 4 * sum_noise))
