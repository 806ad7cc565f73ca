"""What every estimator does with a capture: problems of its rows, diagnostics, provenance."""

from __future__ import annotations

import platform
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

import lightmatrix
from lightmatrix.capture import Capture, Samples
from lightmatrix.solvers.problem import Problem, Result

Progress = Callable[[int, int], None]

# Working memory of one tile of rows, well below the 4 GiB that any estimate may take.
TILE_BYTES = 512 << 20


def problem_of(
    capture: Capture,
    samples: Samples,
    regularization: float,
    *,
    nonnegative: bool = True,
    background: bool = True,
) -> Problem:
    """The problem of some rows of a capture."""
    return Problem(
        capture.patterns,
        samples.values,
        samples.clipped,
        samples.clip_level,
        regularization,
        samples.weights,
        nonnegative,
        background,
    )


def row_diagnostics(samples: Samples, result: Result) -> dict[str, NDArray[Any]]:
    """What is kept of each row beside its light transport, (M,) each."""
    return {
        "clipped_share": samples.clipped.mean(axis=1, dtype=np.float32),
        "iterations": result.iterations,
        "converged": result.converged,
        "gap": result.gap.astype(np.float32),
        "objective": result.objective,
    }


def provenance_of(capture: Capture, **more: Any) -> dict[str, Any]:
    """What an estimate was made from and by which versions, JSON-ready."""
    return {
        **more,
        "patterns": capture.patterns.description,
        "pattern_digest": capture.patterns.digest,
        "capture_description": capture.description,
        "versions": {
            "lightmatrix": lightmatrix.__version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
    }


def plain_value(value: Any) -> Any:
    """A parameter as JSON holds it."""
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)
