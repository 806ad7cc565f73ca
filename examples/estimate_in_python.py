"""The whole way in Python: patterns, a simulated capture, an estimate, its error.

    python examples/estimate_in_python.py

The same as the README's commands, on a scene made up in a moment instead of rendered.
"""

from __future__ import annotations

import numpy as np

from lightmatrix.camera.samples import Samples
from lightmatrix.camera.sensor import Sensor
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.rig.procedural import ProceduralScene
from lightmatrix.rig.simulate import irradiance
from lightmatrix.solvers import ADMM, Fidelity, Problem, SaturationADMM, Solver, solve
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.metrics import relative_error, unclipped_rows


def main() -> dict[str, float]:
    """Estimate with three solvers and return their relative errors."""
    truth = ProceduralScene((16, 16), (24, 24), seed=1, bounces=8).truth()
    patterns = BernoulliPatterns(truth.projector_shape, 160)

    # The camera: 8 bits, a little noise, and an exposure at which samples clip.
    exposure = 2.5
    frames = Sensor(exposure, 0.0, 0.003, 0.0, 8).expose(irradiance(truth.matrix, patterns))
    samples = (frames / np.float32(255 * exposure)).astype(np.float32)
    clipped = frames == 255
    print(f"{100 * clipped.mean():.0f} % of the samples clip")

    level = np.full(patterns.count, 1 / exposure, np.float32)
    problem = Problem(patterns, Samples(samples, clipped, level), 0.05 / exposure)
    known = truth.transport()
    rows = np.flatnonzero(unclipped_rows(known, exposure))
    errors = {}
    solvers: dict[str, Solver] = {
        "ADMM, which ignores clipping": ADMM(),
        "Saturation ADMM, the paper's": SaturationADMM(Fidelity.CLIPPED),
        "Saturation ADMM, one-sided": SaturationADMM(Fidelity.ONE_SIDED),
    }
    for name, solver in solvers.items():
        result = solve(problem, solver)
        found = LightTransport(
            result.coefficients,
            result.background[:, None].astype(np.float32),
            truth.camera_shape,
            truth.projector_shape,
        )
        errors[name] = relative_error(found, known, rows)
        print(f"{name}: relative error {errors[name]:.3f}")
    return errors


if __name__ == "__main__":
    main()
