"""The regularization that an estimate chooses by itself."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.estimators.automatic_regularization import (
    automatic_regularization,
    held_out_path,
    reached_level,
)
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.solvers import ActiveSet
from lightmatrix.solvers.regularization import default_regularization

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
    expected = default_regularization(capture.patterns, 1.0)
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
    by_clip_level = default_regularization(capture.patterns, 1.0)
    errors = []
    for regularization in (None, by_clip_level):
        estimate = PlainEstimator(ActiveSet(), regularization).estimate(capture)
        scaled = replace(
            estimate, sparse=estimate.sparse / exposure, background=estimate.background / exposure
        )
        errors.append(relative_error(scaled, known))
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_hold_out_chooses_among_values_around_the_automatic_one(noise: float) -> None:
    capture = photographed(0.6, 128, noise)
    path = held_out_path(capture)
    middle = automatic_regularization(capture)
    assert path.values[0] == pytest.approx(2 * middle)
    assert path.values[-1] == pytest.approx(middle / 4)
    # What it picks without knowing T is about what gives the least error of T.
    errors = {}
    for value in path.values:
        estimate = PlainEstimator(ActiveSet(), float(value)).estimate(capture)
        scaled = replace(
            estimate, sparse=estimate.sparse / 0.6, background=estimate.background / 0.6
        )
        errors[float(value)] = relative_error(scaled, TRUTH.transport())
    assert errors[path.best] < 1.1 * min(errors.values())
    assert max(errors.values()) > 1.5 * min(errors.values())


def test_hold_out_needs_patterns_to_hold_out() -> None:
    with pytest.raises(InputError, match="held out"):
        held_out_path(photographed(0.6, 2))


def test_the_command_takes_the_value_held_out_patterns_ask_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    patterns, sensor = BernoulliPatterns(TRUTH.projector_shape, 48, seed=1), Sensor(1.0, bits=8)
    frames = sensor.expose(irradiance(TRUTH.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(patterns.count, *TRUTH.camera_shape)
    folder, output = tmp_path / "capture", tmp_path / "scene.zarr"
    write_capture(folder, patterns, stack, sensor=sensor, camera_shape=TRUTH.camera_shape)
    words = ["estimate", str(folder), "-o", str(output), "--regularization", "path"]
    assert main([*words, "--coherent"]) == 2
    assert "coherent" in capsys.readouterr().err
    assert main([*words, "--json"]) == 0
    estimate = json.loads(capsys.readouterr().out)["regularization"]
    assert estimate == pytest.approx(held_out_path(Capture.open(folder)).best)
