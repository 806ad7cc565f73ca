"""The error that clipping causes at full size, by fidelity.

    python -m benchmarks.clipping_at_scale [--paper] [SCENE ...]

It estimates the middle 32 x 32 camera pixels at 128 x 128 with 256 patterns, the benchmark exposure
(a fifth of all rows have a single response that clips), noise 0.3 %, 8 bits, lambda a tenth of the
clip level. Relative errors count rows whose single responses do not clip; a second figure counts
those of them with at most half of their samples clipped. It fails unless `one-sided` has at most a
quarter of the error of `linear`. `--paper` adds the paper's own fidelity, which takes minutes per
scene.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

import numpy as np

from lightmatrix.camera.samples import Samples
from lightmatrix.camera.sensor import Sensor
from lightmatrix.evaluation.metrics import benchmark_exposure, relative_error, unclipped_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation import library
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.solvers import ActiveSet, Fidelity, Problem, SaturationADMM, Solver, solve
from lightmatrix.transport.matrix import LightTransport

SIZE = (128, 128)
PATTERNS = 256
REGULARIZATION = 0.1
# The convex fidelities are solved to a certified gap, so that errors come from the problem and not
# from a solver that stopped early. ADMM converges to the solution of `linear`.
SOLVERS: dict[str, Solver] = {
    "linear": ActiveSet(Fidelity.LINEAR),
    "rejection": ActiveSet(Fidelity.REJECTION),
    "one-sided": ActiveSet(Fidelity.ONE_SIDED),
}
PAPER: dict[str, Solver] = {"clipped": SaturationADMM(Fidelity.CLIPPED)}


def measure(name: str, solvers: dict[str, Solver]) -> dict[str, Any]:
    """Measure errors, times and peak memory of all fidelities on one scene."""
    truth = library.truth(name, SIZE)
    exposure = benchmark_exposure(truth.transport())
    rows = (np.arange(48, 80)[:, None] * SIZE[1] + np.arange(48, 80)).ravel()
    matrix = truth.matrix[rows]
    known = LightTransport.from_matrix(matrix, (32, 32), SIZE)
    patterns = BernoulliPatterns(SIZE, PATTERNS)
    frames = Sensor(exposure, 0.0, 0.003, 0.0, 8).expose(irradiance(matrix, patterns))
    clipped = frames == 255
    samples = (frames / np.float32(255 * exposure)).astype(np.float32)
    level = np.full(PATTERNS, 1 / exposure, np.float32)
    problem = Problem(patterns, Samples(samples, clipped, level), REGULARIZATION / exposure)
    counted = np.flatnonzero(unclipped_rows(known, exposure))
    lightly = counted[clipped[counted].mean(axis=1) <= 0.5]
    errors, half_errors, seconds = {}, {}, {}
    for fidelity, solver in solvers.items():
        started = time.perf_counter()
        result = solve(problem, solver)
        seconds[fidelity] = time.perf_counter() - started
        estimate = LightTransport(
            result.coefficients, result.background[:, None].astype(np.float32), (32, 32), SIZE
        )
        errors[fidelity] = relative_error(estimate, known, counted)
        half_errors[fidelity] = relative_error(estimate, known, lightly)
        print(f"{name}, {fidelity}: {errors[fidelity]:.4f}", file=sys.stderr, flush=True)
    return {
        "scene": name,
        "exposure": exposure,
        "clipped_samples": float(clipped.mean()),
        "rows_counted": len(counted),
        "relative_error": errors,
        "rows_at_most_half_clipped": len(lightly),
        "relative_error_at_most_half_clipped": half_errors,
        "seconds": seconds,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main() -> int:
    names = [word for word in sys.argv[1:] if word != "--paper"]
    solvers = {**SOLVERS, **PAPER} if "--paper" in sys.argv else SOLVERS
    results = [measure(name, solvers) for name in names or ("l_objects", "gripper", "metal")]
    print(json.dumps(results, indent=2))
    good = True
    for result in results:
        error = result["relative_error"]
        ratio = error["linear"] / error["one-sided"]
        good &= ratio >= 4
        print(f"{result['scene']}: linear {ratio:.1f} times the clip-aware error", file=sys.stderr)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
