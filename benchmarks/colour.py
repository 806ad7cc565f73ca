"""Errors of a colour projector's T by photographs in colour, and by what was there before.

python -m benchmarks.colour                    four scenes, about 15 minutes
python -m benchmarks.colour --scenes l_objects

The rigs are those of `python -m experiments rigs` (`experiments/colour_rigs.py`), at 64 x 64: with
"other surfaces" the global light is tinted.
"""

from __future__ import annotations

import argparse
import re

import numpy as np
from rich.console import Console
from rich.table import Table

import lightmatrix as lm
from experiments.colour_rigs import colour_capture, tinted
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.evaluation.metrics import relative_error
from lightmatrix.simulation.colour import in_all_primaries

SCENES = ("l_objects", "gripper", "metal", "corner")
SIZE, NOISE = (64, 64), 0.003


def photographed(
    truth: lm.Truth, count: int, grey: bool = True, wide: lm.Truth | None = None
) -> lm.SimulatedCapture:
    """Photographs under patterns in colour, at the exposure that `plan` advises for grey ones."""
    exposure = lm.plan(truth, frames=32, noise=NOISE).exposure
    return colour_capture(wide or in_all_primaries(truth), count, exposure, grey=grey)


def shared(capture: lm.SimulatedCapture) -> str:
    """The error of the estimate that shares its geometry, and what it states."""
    colour = lm.estimate_colour(capture, check=False)
    error = lm.evaluate_colour(colour, capture.truth).relative_error
    sentence = lm.verdict(colour.red).sentence
    stated = re.search(r"error of T: ([\d.]+ %)", sentence)
    return f"{error:.4f} ({stated[1] if stated else 'not stated'})"


def three_captures(scene: str, truth: lm.Truth, count: int) -> float:
    """The error of three captures in one primary each, of `count` photographs."""
    exposure = lm.plan(truth, frames=32, noise=NOISE).exposure
    missed, whole = 0.0, 0.0
    for primary in ("red", "green", "blue"):
        capture = lm.simulate(
            scene, lm.BernoulliPatterns(SIZE, count), exposure=exposure, primary=primary
        )
        known = capture.truth.transport()
        energy = float((known.sparse.data.astype(float) ** 2).sum())
        missed += relative_error(lm.estimate(capture, check=False), known) ** 2 * energy
        whole += energy
    return float(np.sqrt(missed / whole))


def side_by_side(capture: lm.SimulatedCapture) -> float:
    """The error of one projector three times as wide, whose pixels share nothing."""
    return relative_error(CoherentEstimator().estimate(capture), capture.truth.transport())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--before", action="store_true", help="also what was there before")
    chosen = parser.parse_args()
    table = Table("scene", "photographs", "error (stated)")
    for scene in chosen.scenes:
        truth = lm.truth(scene)
        for count, grey in ((32, True), (32, False), (64, True)):
            error = shared(photographed(truth, count, grey))
            table.add_row(scene, f"{count}, {16 if grey else 0} grey", error)
        for other in (False, True):
            capture = photographed(truth, 32, wide=tinted(truth, other))
            what = "other surfaces" if other else "tinted"
            table.add_row(scene, f"32, 16 grey, {what}", shared(capture))
        if chosen.before:
            wide = side_by_side(photographed(truth, 32, grey=False))
            table.add_row(scene, "32, side by side", f"{wide:.4f}")
            for count in (11, 32):
                each = three_captures(scene, truth, count)
                table.add_row(scene, f"three captures of {count}", f"{each:.4f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
