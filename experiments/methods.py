"""The methods that the paper's real-scene figures compare, each under a name and a label."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.pictures.style import COLOURS
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, Fidelity, SaturationADMM, Solver
from lightmatrix.transport.matrix import LightTransport

# The paper states none of these. All methods take this regularization lambda, in clip levels; ROMP
# takes the n of Fig. 4; the iterated solvers choose mu and nu by rule and stop after this many
# iterations. Chosen by hand.
REGULARIZATION = 0.16
ROMP_SPARSITY = 10
ITERATIONS = 400


class Reach(StrEnum):
    """The camera pixels that a method is fast enough for."""

    CAMERA = "all camera pixels"
    BLOCKS = "camera blocks"
    ROWS = "some rows"


@dataclass(frozen=True)
class Method:
    """An estimator with its name in tables, its label in figures and the style of its curve."""

    name: str
    label: str
    # Makes the estimator from the regularization, in units of the samples.
    make: Callable[[float], PlainEstimator | MultiScaleEstimator | CoherentEstimator]
    colour: str
    style: str = "-"
    marker: str = "o"
    reach: Reach = Reach.BLOCKS

    def estimate(self, capture: Capture, clip_level: float) -> LightTransport:
        """Estimate T from a capture whose samples clip at `clip_level`."""
        return self.make(REGULARIZATION * clip_level).estimate(capture)


def _pair(name: str, label: str, solver: Solver, colour: str, marker: str) -> list[Method]:
    """A solver row by row, and multi-scale."""
    return [
        Method(name, label, lambda value: PlainEstimator(solver, value), colour, "-", marker),
        Method(
            f"{name}-multi-scale",
            f"{label} multi-scale",
            lambda value: MultiScaleEstimator(solver, value),
            colour,
            "--",
            marker,
        ),
    ]


METHODS = [
    *_pair("romp", "ROMP", ROMP(ROMP_SPARSITY, Fidelity.LINEAR), COLOURS[0], "s"),
    *_pair("admm", "ADMM (Eq. 2)", ActiveSet(Fidelity.LINEAR), COLOURS[1], "o"),
    *_pair("saturation-admm", "Saturation ADMM (one-sided)", ActiveSet(), COLOURS[2], "^"),
    Method(
        "coherent",
        "coherent (ours)",
        lambda _: CoherentEstimator(),
        COLOURS[6],
        reach=Reach.CAMERA,
    ),
    Method(
        "admm-iterated",
        "ADMM, iterated",
        lambda value: PlainEstimator(ADMM(max_iterations=ITERATIONS), value),
        COLOURS[1],
        "",
        "+",
        Reach.ROWS,
    ),
    Method(
        "saturation-admm-iterated",
        "Saturation ADMM (Eq. 6), iterated",
        lambda value: PlainEstimator(
            SaturationADMM(Fidelity.CLIPPED, max_iterations=ITERATIONS), value
        ),
        COLOURS[2],
        "",
        "x",
        Reach.ROWS,
    ),
]
BY_NAME = {method.name: method for method in METHODS}
