"""Small problems that several test files share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lightmatrix.capture.samples import Samples
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.solvers import Problem


def clipping_problem(
    *,
    rows: int = 6,
    shape: tuple[int, int] = (9, 11),
    count: int = 40,
    clip_level: float = 1.0,
    regularization: float = 0.05,
    dtype: Any = np.float64,
    seed: int = 0,
    **options: Any,
) -> tuple[Problem, np.ndarray[Any, Any]]:
    """Sparse rows seen through Bernoulli patterns by a camera that clips, and the true rows."""
    random = np.random.default_rng(seed)
    patterns = BernoulliPatterns(shape, count, seed=seed)
    x = np.zeros((rows, patterns.pixels))
    for row in x:
        lit = random.permutation(patterns.pixels)[:5]
        row[lit] = random.random(len(lit))
    light = patterns.forward(x) + 0.1 * patterns.means
    samples = np.minimum(light + 0.003 * random.standard_normal(light.shape), clip_level)
    problem = Problem(
        patterns,
        Samples(samples.astype(dtype), samples >= clip_level, np.full(count, clip_level, dtype)),
        regularization,
        **options,
    )
    return problem, x


def with_samples(problem: Problem, **changes: Any) -> Problem:
    """The problem with other values, clip states, clip levels or weights of its samples."""
    return replace(problem, samples=replace(problem.samples, **changes))
