"""32 photographs of a rendered scene, row by row and with neighbours, in two exposures.

python examples/few_patterns.py
"""

from __future__ import annotations

import lightmatrix as lm
from lightmatrix.transport.metrics import benchmark_exposure


def main() -> dict[str, float]:
    """Estimate T three times and return the relative errors over all rows."""
    truth = lm.truth("gripper")  # 64 x 64, comes with the package
    patterns = lm.BernoulliPatterns(truth.projector_shape, 32)

    # At this exposure a fifth of the single responses clip: those cannot be had back. Every
    # fourth frame at a quarter of it brings them in.
    exposure = benchmark_exposure(truth.transport())
    one = lm.simulate(truth, patterns, exposure=exposure)
    two = lm.simulate(truth, patterns, exposure=f"{exposure}:0.75,{exposure / 4}:0.25")
    estimates = {
        "row by row": lm.estimate(one, coherent=False),
        "coherent": lm.estimate(one),
        "coherent, two exposures": lm.estimate(two),
    }
    errors = {}
    for name, estimate in estimates.items():
        errors[name] = lm.evaluate(estimate, truth).relative_error
        print(f"{name:24s} relative error {errors[name]:.3f}")
    return errors


if __name__ == "__main__":
    main()
