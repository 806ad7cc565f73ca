"""How fast this machine is, beside the one whose times `cost_model` holds."""

from __future__ import annotations

import time
from functools import cache

import numpy as np

from lightmatrix.camera.samples import Samples
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.problem import Problem

# A small problem: its rows, the projector pixels that each sees, the side of the projector in
# pixels, and the number of patterns. Chosen by hand, so that ten tries take about .1 s.
_ROWS, _SEEN, _SIDE, _PATTERNS = 32, 40, 64, 64
# Seconds in which one core of the machine of `cost_model.COEFFICIENTS` solves it.
_USUAL_SECONDS = 11.9e-3
# It is solved this often, and the shortest time counts, since other programs can only prolong it.
# Chosen by hand.
_TRIES = 10


@cache
def slowness() -> float:
    """How many times as long one core of this machine takes; measured once, in .1 s."""
    solver, problem = ActiveSet(threads=1), _problem()
    times = []
    for _ in range(_TRIES):
        started = time.perf_counter()
        solver.solve(problem)
        times.append(time.perf_counter() - started)
    return min(times) / _USUAL_SECONDS


def _problem() -> Problem:
    draw = np.random.default_rng(0)
    patterns = BernoulliPatterns((_SIDE, _SIDE), _PATTERNS)
    light = np.zeros((_ROWS, patterns.pixels), np.float32)
    for row in light:
        row[draw.choice(patterns.pixels, _SEEN, replace=False)] = draw.random(_SEEN)
    values = patterns.forward(light)
    brightest = values.max(axis=1, keepdims=True)
    samples = Samples(values / brightest, values >= brightest, np.ones(_PATTERNS, np.float32))
    return Problem(patterns, samples, regularization=0.02)
