"""The patterns of the frames of a video against their definition in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array, random_array

from lightmatrix import _core


def problem(height: int, width: int, cells: int, frames: int, seed: int) -> dict[str, Any]:
    """Valid arguments of `frame_patterns` for a random T, of which some samples do not count."""
    random = np.random.default_rng(seed)

    def values(*shape: int) -> NDArray[np.float32]:
        return random.random(shape, dtype=np.float32)

    density = 0.1 if height * width > 4000 else 0.5
    found = random_array((height, width), density=density, rng=random, dtype=np.float32)
    sparse = csr_array(found)
    background = 0.1 * values(height, cells)
    light = np.asarray(sparse.sum(axis=1)).ravel() + background.sum(axis=1)
    weights = np.where(values(height) < 0.2, 0, values(height)).astype(np.float32)
    most = np.where(values(width) < 0.1, 0, 1).astype(np.float32)
    bounds = sparse.T @ (weights * (sparse @ most)) + np.float32(0.01)
    seen = sparse.T @ (weights > 0).astype(np.float32)
    samples = np.stack([values(height), 0.1 * values(height), weights, light], axis=1)
    return {
        "rows": sparse, "columns": csr_array(sparse.T), "background": background,
        "cells": random.integers(0, cells, width), "samples": samples.astype(np.float32),
        "pixels": np.stack([bounds, seen, most], axis=1).astype(np.float32),
        "wanted": [*values(frames, height)], "last_pattern": values(width),
        "last_wanted": values(height), "out": np.full((frames, width), np.nan, np.float32),
        "room": np.full(32 * (height + width) + 16, np.nan, np.float32),
        "ridge": 0.01, "tolerance": 0.05, "steps": 4,
    }  # fmt: skip


def by_numpy(given: dict[str, Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Patterns (K, N), squared errors and reached samples, as crates/core/src/frames.rs says."""
    sparse, background = given["rows"].astype(float), given["background"].astype(float)
    white, ambient, weights, full = given["samples"].T.astype(float)[:, :, None]
    bounds, seen, most = given["pixels"].T.astype(float)[:, :, None]
    cells, count = given["cells"], background.shape[1]
    mean = np.zeros((count, len(cells)))
    mean[cells, np.arange(len(cells))] = 1
    mean /= np.maximum(mean.sum(axis=1, keepdims=True), 1)
    target = white * np.stack(given["wanted"], axis=1)
    known = white * given["last_wanted"][:, None]
    near = ((target - known) ** 2).sum(axis=0) < (target**2).sum(axis=0)
    goal = target - ambient
    asked = np.where(weights > 0, (goal - near * (known - ambient)) / full, 0)
    start = near * given["last_pattern"][:, None].astype(float)
    pattern = start + np.where(seen > 0, sparse.T @ asked / np.where(seen > 0, seen, 1), 0)
    pattern = pattern.clip(0, most)
    goal -= background @ (mean @ pattern)
    first, ahead, least = pattern, 0.0, 0.1
    middle, half, rate = (1 + least) / 2, (1 - least) / 2, 0.0
    for step in range(given["steps"]):
        kept = 0.0 if step == 0 else (half * rate) ** 2 / (2 if step == 1 else 4)
        rate = 1 / (middle - (kept / rate if step else 0))
        gradient = sparse.T @ (weights * (sparse @ pattern - goal)) + given["ridge"] * pattern
        ahead = kept * ahead - gradient / bounds
        pattern = (pattern + rate * ahead).clip(0, most)
    missed = sparse @ pattern + background @ (mean @ (pattern - first)) - goal
    counted = weights > 0
    close = counted & (np.abs(missed) <= given["tolerance"] * white)
    return pattern.T, (counted * missed**2).sum(axis=0), close.sum(axis=0)


# Up to 5,000 samples and pixels make several tasks of 4,096 of them.
SIDES = st.one_of(st.integers(1, 140), st.integers(4090, 5000))


@given(
    height=SIDES, width=SIDES, cells=st.integers(1, 70), frames=st.integers(1, 16),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_patterns_are_those_of_the_definition(
    height: int, width: int, cells: int, frames: int, seed: int
) -> None:
    if height * width > 10**6:
        width = 50
    arguments = problem(height, width, cells, frames, seed)
    squares, reached = _core.frame_patterns(**arguments)
    expected = by_numpy(arguments)
    np.testing.assert_allclose(arguments["out"], expected[0], atol=2e-4)
    np.testing.assert_allclose(squares, expected[1], rtol=1e-3, atol=1e-6)
    # A sample may lie at the edge of the tolerance.
    assert np.abs(reached - expected[2]).max() <= 1 + 0.01 * height


def test_a_frame_does_not_depend_on_those_beside_it() -> None:
    arguments = problem(90, 70, 5, 16, seed=1)
    squares, _ = _core.frame_patterns(**arguments)
    for k in (0, 7, 15):
        out = np.empty((1, 70), np.float32)
        alone = arguments | {"wanted": arguments["wanted"][k : k + 1], "out": out}
        assert _core.frame_patterns(**alone)[0] == squares[k]
        np.testing.assert_array_equal(out[0], arguments["out"][k])


def test_arrays_that_results_are_written_to_are_checked() -> None:
    arguments = problem(6, 5, 2, 3, seed=0)
    locked = arguments["out"].copy()
    locked.flags.writeable = False
    for out in (np.empty((5, 3), np.float32).T, np.empty((3, 5)), locked, [[0.0] * 5] * 3):
        with pytest.raises(TypeError, match="out"):
            _core.frame_patterns(**arguments | {"out": out})
    with pytest.raises(TypeError, match="room cannot be written to"):
        _core.frame_patterns(**arguments | {"room": arguments["out"], "out": arguments["out"]})
    with pytest.raises(ValueError, match="room for 367 numbers, expected 368"):
        _core.frame_patterns(**arguments | {"room": arguments["room"][1:]})
