"""Fits how probably a spot is a surface to some scenes, and tests it on others.

    python -m benchmarks.shape_probability [--quick]

Prints the coefficients of lightmatrix/shape/spots.py, for T and for decoded places, and for each
scene that they were not fitted to: the shares of lit pixels with a right depth and of wrong depths,
of all points and of those at a probability of 0.99, and the largest difference between
probabilities and shares of right spots in tenths that hold 50 spots or more. Scenes are rendered on
first use.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import options
from experiments.shape import NOISE, Case, Reference, codes, exposure_of
from lightmatrix.errors import LightMatrixWarning
from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.shape.decode import decode
from lightmatrix.shape.spots import FEATURES, Seen, features, seen_by, surface_probability
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate

FITTED = [
    *(Case(scene, 64, 0) for scene in ("vase", "translucent", "mirror_balls", "curtain")),
    Case("vase", 64, 0, patterns=16),
    Case("vase", 64, 0, exposed=4),
    Case("mirror_balls", 64, 0, patterns=64),
    Case("translucent", 64, 0, blur=1),
    Case("vase", 128, 0),
]
TESTED = [
    *(Case(scene, 64, 0) for scene in ("corner", "l_objects", "metal", "gripper")),
    *(Case(scene, 128, 0) for scene in ("corner", "l_objects", "metal")),
]
# Errors that are tolerated, as shares of the distance.
TOLERANCES = (0.005, 0.01, 0.02)
# Places of codes have no width, and their confidence is near 1 whatever they are worth.
OF_CODES = tuple(name for name in FEATURES if name not in ("share", "width"))
# From this score on, the log odds rise more steeply. Chosen by hand.
BEND = 2.0
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spots:
    """The spots of a case, and how far each lies from the nearest surface, as a share (P, n)."""

    seen: Seen
    reference: Reference

    def right(self, tolerance: float) -> NDArray[np.bool_]:
        """Which spots (P, n) are right."""
        depths = self.reference.depths.reshape(len(self.seen.error), 1, -1)
        apart = np.abs(self.seen.depth[..., None] - depths) - tolerance * depths
        return np.asarray(np.fmin.reduce(apart, axis=-1) <= 0)


def spots_of(case: Case, decoded: bool) -> Iterator[Spots]:
    """The spots of T, or the places of each code."""
    truth = library.truth(case.scene, (case.side, case.side))
    assert truth.geometry is not None
    settings: dict[str, Any] = {"noise": NOISE, "seed": case.seed, "blur": case.blur}
    settings["exposure"] = exposure_of(truth, case)
    reference = Reference.of(truth)
    if decoded:
        for code in codes(truth.projector_shape).values():
            matches = decode(simulate(truth, code, **settings), check=False)
            yield Spots(seen_by(matches, truth.geometry), reference)
    else:
        random = BernoulliPatterns(truth.projector_shape, case.patterns, seed=case.seed)
        transport = estimate(simulate(truth, random, **settings), check=False)
        yield Spots(seen_by(transport, truth.geometry), reference)


def regression(design: Array, right: Array, weights: Array) -> Array:
    """Coefficients of a weighted logistic regression, by Newton's method."""
    found = np.zeros(design.shape[1])
    for _ in range(30):
        expected = 1 / (1 + np.exp(-np.clip(design @ found, -30, 30)))
        slope = weights * np.maximum(expected * (1 - expected), 1e-6)
        # A little less than certain, so that scenes without an error have a finite optimum.
        curvature = design.T @ (design * slope[:, None]) + 1e-3 * np.eye(len(found))
        found += np.linalg.solve(
            curvature, design.T @ (weights * (right - expected)) - 1e-3 * found
        )
    return found


def fitted(parts: Sequence[Spots], names: Sequence[str]) -> list[float]:
    """The coefficients of all features, how much steeper the score rises, and from where on."""
    designs, rights, weights = [], [], []
    for part in parts:
        chosen = part.seen.direct & (part.seen.share > 0.003)
        for tolerance in TOLERANCES:
            values = features(part.seen, tolerance)
            designs.append(np.column_stack([values[name][chosen] for name in names]))
            rights.append(part.right(tolerance)[chosen].astype(float))
            # Each case counts alike.
            weights.append(np.full(int(chosen.sum()), 4000 / chosen.sum()))
    design, right, weight = map(np.concatenate, (designs, rights, weights))
    coefficients = regression(design, right, weight)
    # A straight line fits the many spots that may be wrong, and doubts those that are surely right.
    score = design @ coefficients
    bent = np.column_stack([np.ones_like(score), score, np.maximum(score - BEND, 0)])
    shift, factor, steeper = regression(bent, right, weight)
    found = dict(zip(names, factor * coefficients, strict=True))
    found["one"] += shift
    told = [*(found.get(name, 0.0) for name in FEATURES), steeper / factor, shift + BEND * factor]
    return [round(float(value), 2) for value in told]


def tested(part: Spots) -> str:
    """Right and wrong shares in per cent by least probability, and the worst tenth."""
    right, lit = part.right(0.01), part.reference.lit.ravel()
    probability = surface_probability(part.seen, 0.01)
    best = np.arange(len(lit)), probability.argmax(axis=1)
    told = []
    for least in (0.5, 0.9, 0.99):
        kept = probability[best] >= least
        good = 100 * (kept & right[best] & lit).sum() / lit.sum()
        wrong = 100 * (kept & ~right[best]).sum() / max(1, kept.sum())
        told.append(f"{least}: {good:.2f} / {wrong:.2f}")
    tenth = np.minimum(10 * probability, 9).astype(int)
    off = [0.0]
    for number in range(10):
        chosen = part.seen.direct & (tenth == number)
        if chosen.sum() >= 50:
            off.append(float(100 * abs(probability[chosen].mean() - right[chosen].mean())))
    return ", ".join([*told, f"worst tenth {max(off):.0f} points off"])


def main() -> None:
    """Fit and test for T, then for codes."""
    parser: argparse.ArgumentParser = options("benchmarks.shape_probability", __doc__)
    parser.add_argument("--quick", action="store_true", help="two scenes of each kind, T only")
    quick = parser.parse_args().quick
    for decoded in (False,) if quick else (False, True):
        fit, test = (FITTED[:1], TESTED[2:4]) if quick else (FITTED, TESTED)
        names = OF_CODES if decoded else FEATURES
        print("codes" if decoded else "T", end=": ")
        print(fitted([part for case in fit for part in spots_of(case, decoded)], names))
        for case in test:
            for part in spots_of(case, decoded):
                print(f"  {case.name}: {tested(part)}", flush=True)


if __name__ == "__main__":
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LightMatrixWarning)
        main()
