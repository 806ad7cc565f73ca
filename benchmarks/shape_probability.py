"""Fits how probably a spot is a surface, and tests each scene with a fit to the others.

    python -m benchmarks.shape_probability [--quick]

For T from 32 patterns, and for decoded places, it prints the coefficients of
lightmatrix/shape/spots.py, fitted to all scenes. Then, for each scene and size, with a fit that has
not seen the scene: the shares of lit pixels with a right depth and of wrong depths in per cent, of
all points and of those at a probability of 0.99; and by tenths of the probability how many points
more often spots are right than it says, with the standard error and the number of spots. Scenes
are rendered on first use.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import options
from experiments.layers import two_surfaces
from experiments.shape import NOISE, Case, Reference, codes, exposure_of
from lightmatrix.errors import LightMatrixWarning
from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.shape.decode import decode
from lightmatrix.shape.spots import Seen, features, seen_by
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport

SCENES: tuple[str, ...] = (
    "corner",
    "l_objects",
    "metal",
    "gripper",
    "vase",
    "translucent",
    "mirror_balls",
)
SCENES += ("curtain", "glass", "mirror", "wall")
# Errors that are tolerated, as shares of the distance.
TOLERANCES = (0.005, 0.01, 0.02)
# Places of codes have no width.
OF_T_ALONE = ("width", "width bend")
# From this score on, the log odds rise more steeply. Chosen by hand.
BEND = 2.0
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spots:
    """The spots of a case beside their lines, and the depths of its surfaces (P, m)."""

    case: Case
    seen: Seen
    depths: Array
    lit: NDArray[np.bool_]

    @property
    def chosen(self) -> NDArray[np.bool_]:
        """The spots (P, n) that the fit counts: those that are not hopelessly faint."""
        return self.seen.direct & (self.seen.share > 0.003)

    def design(self, tolerance: float, decoded: bool) -> Array:
        """What is known of the chosen spots, (S, features)."""
        known = features(self.seen, tolerance)
        zero = OF_T_ALONE if decoded else ()
        columns = [0 * each if name in zero else each for name, each in known.items()]
        return np.column_stack(columns)[self.chosen[self.seen.direct]]

    def right(self, tolerance: float) -> NDArray[np.bool_]:
        """Which of the chosen spots are right, (S,)."""
        known = self.depths[:, None]
        apart = np.abs(self.seen.depth[..., None] - known) - tolerance * known
        return np.asarray(np.fmin.reduce(apart, axis=-1) <= 0)[self.chosen]


def cases(quick: bool, decoded: bool) -> Iterator[Case]:
    """All scenes with three seeds at 64 x 64 and once at 128 x 128; codes once at 64 x 64."""
    for scene in ("curtain", "l_objects", "metal") if quick else SCENES:
        yield Case(scene, 64, 0)
        if not quick and not decoded:
            yield from (Case(scene, side, seed) for side, seed in ((64, 1), (64, 2), (128, 0)))


def sources(case: Case, decoded: bool) -> Iterator[LightTransport | Correspondence]:
    """T of a case, or the places of each code."""
    truth = library.truth(case.scene, (case.side, case.side))
    settings: dict[str, Any] = {"noise": NOISE, "seed": case.seed, "blur": case.blur}
    settings["exposure"] = exposure_of(truth, case)
    if decoded:
        for code in codes(truth.projector_shape).values():
            yield decode(simulate(truth, code, **settings), check=False)
        return
    random = BernoulliPatterns(truth.projector_shape, case.patterns, seed=case.seed)
    yield estimate(simulate(truth, random, **settings), check=False)


def spots_of(case: Case, decoded: bool) -> Iterator[Spots]:
    """The spots of T, or the places of each code."""
    truth = library.truth(case.scene, (case.side, case.side))
    assert truth.geometry is not None
    reference = Reference.of(truth)
    depths = reference.depths.reshape(reference.lit.size, -1)
    if case.scene in ("curtain", "glass"):
        # Threads and grains are finer than the grid of the reference.
        depths = np.concatenate([depths, two_surfaces(truth).surfaces], axis=1)
    for source in sources(case, decoded):
        yield Spots(case, seen_by(source, truth.geometry), depths, reference.lit.ravel())


def regression(design: Array, right: Array) -> Array:
    """Coefficients of a logistic regression, by Newton's method."""
    found = np.zeros(design.shape[1])
    for _ in range(20):
        expected = 1 / (1 + np.exp(-np.clip(design @ found, -30, 30)))
        slope = np.maximum(expected * (1 - expected), 1e-6)
        # A little less than certain, so that scenes without an error have a finite optimum.
        curvature = (design * slope[:, None]).T @ design + 1e-2 * np.eye(len(found))
        found += np.linalg.solve(curvature, design.T @ (right - expected) - 1e-2 * found)
    return found


def fitted(parts: list[tuple[Array, Array]]) -> Array:
    """The coefficients of all features, how much steeper the score rises, and from where on."""
    design, right = map(np.concatenate, zip(*parts, strict=True))
    coefficients = regression(design, right)
    # A straight line fits the many spots that may be wrong, and doubts those that are surely right.
    score = design @ coefficients
    bent = np.column_stack([np.ones_like(score), score, np.maximum(score - BEND, 0)])
    shift, factor, steeper = regression(bent, right)
    coefficients *= factor
    coefficients[0] += shift
    return np.array([*coefficients, steeper / factor, shift + BEND * factor])


def probability(design: Array, coefficients: Array) -> Array:
    """How probable spots are, as `surface_probability` has it."""
    *weights, steeper, start = coefficients
    score = design @ np.array(weights)
    score += steeper * np.maximum(score - start, 0)
    return np.asarray(1 / (1 + np.exp(-np.clip(score, -50, 50))))


def tenths(found: Array, right: NDArray[np.bool_]) -> str:
    """Points by which spots are right more often than it says, standard error, and number."""
    words = []
    which = np.minimum(10 * found, 9).astype(int)
    for number in range(10):
        own = which == number
        if not own.any():
            words.append("-")
            continue
        mean, count = float(found[own].mean()), int(own.sum())
        error = 100 * np.sqrt(mean * (1 - mean) / count)
        words.append(f"{100 * (right[own].mean() - mean):+.0f}±{error:.0f} ({count})")
    return " ".join(words)


def points(part: Spots, found: Array, right: NDArray[np.bool_]) -> str:
    """Right and wrong shares in per cent, of all points and of those at 0.99."""
    whole, good = np.zeros(part.seen.light.shape), np.zeros(part.seen.light.shape, bool)
    whole[part.chosen], good[part.chosen] = found, right
    best = np.arange(len(whole)), whole.argmax(axis=1)
    words = []
    for least in (0.5, 0.99):
        kept = whole[best] >= least
        found_right = 100 * (kept & good[best] & part.lit).sum() / part.lit.sum()
        wrong = 100 * (kept & ~good[best]).sum() / max(1, kept.sum())
        words.append(f"{least}: {found_right:.1f} / {wrong:.2f}")
    return ", ".join(words)


def main() -> None:
    """Fit and test for T, then for codes."""
    parser: argparse.ArgumentParser = options("benchmarks.shape_probability", __doc__)
    parser.add_argument("--quick", action="store_true", help="three scenes once, T only")
    quick = parser.parse_args().quick
    for decoded in (False,) if quick else (False, True):
        parts = [part for case in cases(quick, decoded) for part in spots_of(case, decoded)]
        designs = [
            [(part.design(each, decoded), part.right(each).astype(float)) for each in TOLERANCES]
            for part in parts
        ]
        all_found = fitted([pair for pairs in designs for pair in pairs])
        rounded = ", ".join(f"{value:.2f}" for value in all_found)
        print(f"{'codes' if decoded else 'T'}: ({rounded})", flush=True)
        pooled = []
        for scene in dict.fromkeys(part.case.scene for part in parts):
            others = [
                pair
                for part, pairs in zip(parts, designs, strict=True)
                for pair in pairs
                if part.case.scene != scene
            ]
            coefficients = fitted(others)
            for part, pairs in zip(parts, designs, strict=True):
                if part.case.scene == scene:
                    design, right = pairs[TOLERANCES.index(0.01)][0], part.right(0.01)
                    found = probability(design, coefficients)
                    pooled.append((found, right))
                    print(
                        f"  {part.case.name}: {points(part, found, right)}; {tenths(found, right)}"
                    )
        print(f"  all: {tenths(*map(np.concatenate, zip(*pooled, strict=True)))}", flush=True)


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LightMatrixWarning)
        main()
