"""The problems of the solver benchmarks: rows of rendered scenes, and synthetic rows."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.evaluation.metrics import benchmark_exposure
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import Problem

SCENES = ("l_objects", "gripper", "metal")
SIZE = (128, 128)
# Standard deviation of the noise, as a share of the clip level.
NOISE = 0.003
BITS = 8
# lambda as a share of the clip level, for every number of patterns: twice the default.
REGULARIZATION = 0.32


@cache
def exposed_truth(name: str, folder: Path | None = None) -> csr_array:
    """T of a scene at 128 x 128, times the benchmark exposure. Rendered on first use."""
    truth = library.truth(name, SIZE) if folder is None else Truth.load(folder / f"{name}.npz")
    return truth.matrix * np.float32(benchmark_exposure(truth.transport()))


@cache
def bernoulli(count: int, shape: tuple[int, int] = SIZE) -> BernoulliPatterns:
    return BernoulliPatterns(shape, count, seed=1)


def photographed(
    matrix: csr_array,
    patterns: PatternSet,
    *,
    clip: bool = True,
    regularization: float = REGULARIZATION,
    seed: int = 0,
) -> Problem:
    """The problem of the rows of an exposed T: noise, clipping (optional) and 8 bits."""
    light = irradiance(csr_array(matrix, dtype=np.float32), patterns)
    noise = np.random.default_rng(seed).normal(0, NOISE, light.shape)
    levels = np.rint((light + noise) * (2**BITS - 1))
    samples: NDArray[Any] = np.clip(levels, 0, None) / (2**BITS - 1)
    if clip:
        samples = np.minimum(samples, 1)
    clipped = samples >= 1 if clip else np.zeros(samples.shape, bool)
    ones = np.ones(patterns.count, np.float32)
    return Problem(patterns, Samples(samples.astype(np.float32), clipped, ones), regularization)


def spread(problem: Problem, rows: int) -> Problem:
    """The problem of some rows, evenly spread over the frame."""
    return problem.take(np.unique(np.linspace(0, problem.rows - 1, rows).astype(np.int64)))


def synthetic_truth(rows: int, pixels: int, seed: int = 0) -> csr_array:
    """Rows of three direct entries and a hundred weak ones, with the benchmark exposure."""
    rng = np.random.default_rng(seed)
    direct, tail = 3, 100
    columns = rng.integers(0, pixels, (rows, direct + tail))
    values = np.empty(columns.shape, np.float32)
    values[:, :direct] = rng.random((rows, direct)) * rng.lognormal(-1.5, 0.8, (rows, 1))
    values[:, direct:] = rng.exponential(1e-3, (rows, tail))
    matrix = csr_array(
        (values.ravel(), (np.repeat(np.arange(rows), direct + tail), columns.ravel())),
        shape=(rows, pixels),
    )
    matrix.sum_duplicates()
    level = np.quantile(matrix.max(axis=1).toarray(), 0.8)
    return matrix / np.float32(level)
