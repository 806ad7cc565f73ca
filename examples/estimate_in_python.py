"""The whole way in Python: patterns, a simulated capture, an estimate, its error.

    python examples/estimate_in_python.py

The same as the README's commands, on a scene made up in a moment instead of rendered.
"""

from __future__ import annotations

import lightmatrix as lm
from lightmatrix.rig.procedural import ProceduralScene


def main() -> dict[str, float]:
    """Estimate with three solvers and return their relative errors."""
    truth = ProceduralScene((16, 16), (24, 24), seed=1, bounces=8).truth()
    patterns = lm.BernoulliPatterns(truth.projector_shape, 160)

    # The camera: 8 bits, a little noise, and an exposure at which samples clip.
    exposure = 2.5
    capture = lm.simulate(truth, patterns, exposure=exposure)
    print(f"{100 * capture.clipped_share:.0f} % of the samples clip")

    solvers = {
        "ADMM, which ignores clipping": ("admm", "linear"),
        "Saturation ADMM, the paper's": ("saturation-admm", "clipped"),
        "Saturation ADMM, one-sided": ("saturation-admm", "one-sided"),
    }
    errors = {}
    for name, (solver, fidelity) in solvers.items():
        found = lm.estimate(
            capture, solver=solver, fidelity=fidelity, regularization=0.05 / exposure
        )
        # Of the rows that do not clip under a single projector pixel: the others no one can know.
        errors[name] = lm.evaluate(found, truth, exposure).relative_error_unclipped_responses
        print(f"{name}: relative error {errors[name]:.3f}")
    return errors


if __name__ == "__main__":
    main()
