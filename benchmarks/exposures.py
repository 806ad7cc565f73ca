"""The error of T at several exposures: the tables of docs/planning.md.

    python -m benchmarks.exposures [--noise 0.003] [--misfit 0.03] [--estimator plain] ...

Exposures are relative to s, at which the brightest white level just does not clip. The captures
have 64 fine patterns of 128 x 128 pixels and 8 bits, with one seed. Estimates are row by row (of
every fifth row) or coherent (of whole frames).
"""

from __future__ import annotations

import numpy as np

from benchmarks.plan_calibration import SCENES, SIZE, photograph, some_rows
from experiments.harness import markdown
from experiments.harness import options as options_of
from lightmatrix.capture import exposures as noise
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.planning.exposure_advice import WhiteFrame
from lightmatrix.simulation.library import truth
from lightmatrix.solvers import ActiveSet

PLANS: dict[str, list[tuple[float, float]]] = {
    "4 s": [(4, 1.0)],
    "2 s": [(2, 1.0)],
    "s": [(1, 1.0)],
    "s/2": [(1 / 2, 1.0)],
    "s/4": [(1 / 4, 1.0)],
    "s/8": [(1 / 8, 1.0)],
    "4 s: 1/2, s: 1/2": [(4, 0.5), (1, 0.5)],
    "4 s: 3/4, s: 1/4": [(4, 0.75), (1, 0.25)],
    "16 s, 4 s, s: 1/3 each": [(16, 1 / 3), (4, 1 / 3), (1, 1 / 3)],
}


def main() -> None:
    """Print a table in Markdown: a row for each plan, a column for each scene."""
    parser = options_of("benchmarks.exposures", __doc__)
    parser.add_argument("--noise", type=float, default=USUAL_NOISE)
    parser.add_argument("--estimator", choices=("plain", "coherent"), default="plain")
    parser.add_argument("--plans", nargs="+", default=tuple(PLANS), choices=tuple(PLANS))
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--size", type=int, default=SIZE[0])
    parser.add_argument("--misfit", type=float, default=noise.MISFIT)
    arguments = parser.parse_args()
    # With 0 the weights follow the noise alone, e^2; with a large value all weights are equal.
    noise.MISFIT = arguments.misfit
    size, scenes = (arguments.size, arguments.size), arguments.scenes
    patterns = BernoulliPatterns(size, 64)
    lines = []
    for name in arguments.plans:
        cells = [name]
        for scene in scenes:
            known = truth(scene, size)
            levels = known.matrix.sum(axis=1)
            shortest = 1 / WhiteFrame(levels, np.zeros(len(levels), bool)).brightest
            if arguments.estimator == "plain":
                known = some_rows(known)
            exposures = [(factor * shortest, share) for factor, share in PLANS[name]]
            capture, clipped = photograph(known, patterns, exposures, arguments.noise)
            plain = PlainEstimator(ActiveSet(tolerance=1e-3))
            estimator = plain if arguments.estimator == "plain" else CoherentEstimator()
            error = relative_error(estimator.estimate(capture), known.transport())
            cells.append(f"{error:.3f} ({100 * clipped:.1f} %)")
        lines.append(cells)
    print(markdown(["exposures", *scenes], lines))


if __name__ == "__main__":
    main()
