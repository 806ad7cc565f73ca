"""Which rows are unexplained, and search all projector pixels again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.capture.sensor import Sensor
from lightmatrix.estimators.coherent.row_solver import RowSolver
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.solvers import ActiveSet
from lightmatrix.solvers.problem import Problem

PATTERNS = BernoulliPatterns((16, 16), 24)


def row_solver() -> RowSolver:
    frames = np.zeros((24, 2, 2), np.uint8)
    capture = Capture.from_arrays(PATTERNS, frames, Sensor(1.0, bits=8))
    return RowSolver(capture, ActiveSet(), None, 0.01, 50, (0.0,), (1, 1))


def test_rows_are_unexplained_by_their_share_of_what_an_even_background_leaves() -> None:
    solver = row_solver()
    random = np.random.default_rng(0)
    values = random.random((4, 24)).astype(np.float32)
    # The last row is so dark that no atom could enter it.
    values[3] *= 1e-3
    weights = np.ones((4, 24), np.float32)
    weights[:, :5] = 0.5
    samples = Samples(values, np.zeros((4, 24), bool), np.ones(24, np.float32), weights)
    mean = (weights * values).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
    left = (weights * (values - mean) ** 2).sum(axis=1) / 2
    # What a pixel that explains everything would pay.
    penalty = solver.penalty * np.sqrt(2 * left / 24) / solver.atoms.single_contrast
    objective = 0.25 * left * np.array([0.9, 1.1, 1.1, 10]) + penalty
    solved: Any = SimpleNamespace(rows=SimpleNamespace(diagnostics={"objective": objective}))
    assert solver.unexplained(samples, solved, 0.25).tolist() == [1, 2]


def test_dark_rows_that_one_pixel_explains_are_explained() -> None:
    solver = row_solver()
    light = np.array([0.05, 0.1, 0.3, 0.9], np.float32)
    values = light[:, None] * PATTERNS.columns(np.arange(4)).T.astype(np.float32)
    samples = Samples(values, np.zeros((4, 24), bool), np.ones(24, np.float32))
    penalty = solver.penalty * solver.atoms.gains[0]
    solved = ActiveSet().solve(Problem(solver.atoms, samples, penalty))
    assert not len(solver.unexplained(samples, solved, 0.05))
