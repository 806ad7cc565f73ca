"""The regularization that an estimate chooses by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.estimators.automatic_regularization import (
    automatic_regularization,
    default_regularization,
    reached_level,
)
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.solvers import ActiveSet

TRUTH = ProceduralScene((24, 24), (16, 16), seed=4, background=0.02, bounces=6).truth()
BITS = 16


def photographed(exposure: float, count: int = 64, noise: float = 0.0) -> Capture:
    patterns: PatternSet = BernoulliPatterns(TRUTH.projector_shape, count, seed=1)
    sensor = Sensor(exposure, 0.0, noise, 0.0, BITS)
    frames = sensor.expose(irradiance(TRUTH.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(count, *TRUTH.camera_shape)
    # As if nothing were known of the exposure: T comes out that much brighter.
    return Capture.from_arrays(patterns, stack, Sensor(1.0, 0.0, 0.0, 0.0, BITS))


def test_a_capture_that_clips_reaches_its_clip_level() -> None:
    capture = photographed(5.0)
    assert reached_level(capture) == pytest.approx(1)
    expected = default_regularization(capture.patterns, 1.0, 0.003)
    assert automatic_regularization(capture) == pytest.approx(expected)


def test_the_regularization_goes_with_the_light() -> None:
    bright, dark = photographed(0.3), photographed(0.1)
    assert reached_level(bright) < 1
    assert reached_level(dark) == pytest.approx(reached_level(bright) / 3, rel=1e-3)
    bright_value, dark_value = automatic_regularization(bright), automatic_regularization(dark)
    noise = default_regularization(dark.patterns, 1e-9, 0.003)
    assert bright_value == pytest.approx(0.16 * reached_level(bright))
    assert dark_value == pytest.approx(max(0.16 * reached_level(dark), noise))


def test_black_frames_still_have_one() -> None:
    patterns = BernoulliPatterns((4, 4), 8)
    sensor, frames = Sensor(1.0, 0.0, 0.0, 0.0, 8), np.zeros((8, 3, 3), np.uint8)
    black = Capture.from_arrays(patterns, frames, sensor)
    assert automatic_regularization(black) > 0
    assert PlainEstimator(ActiveSet()).estimate(black).sparse.nnz == 0


def test_dark_captures_are_shrunk_less_than_by_their_clip_level() -> None:
    known, exposure = TRUTH.transport(), 0.2
    capture = photographed(exposure, 128)
    by_clip_level = default_regularization(capture.patterns, 1.0, 0.003)
    errors = []
    for regularization in (None, by_clip_level):
        estimate = PlainEstimator(ActiveSet(), regularization).estimate(capture)
        scaled = replace(
            estimate, sparse=estimate.sparse / exposure, background=estimate.background / exposure
        )
        errors.append(relative_error(scaled, known))
    assert errors[0] < 0.7 * errors[1]
