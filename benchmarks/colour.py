"""Errors of a colour projector's T by photographs in colour, and by what was there before.

python -m benchmarks.colour                    four scenes, about 15 minutes
python -m benchmarks.colour --scenes l_objects

"Tinted" surfaces have random colours, in squares of 8 x 8 camera pixels. With "other surfaces" all
global light is tinted once more, by a colour that direct light never has.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table

import lightmatrix as lm
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.evaluation.metrics import relative_error
from lightmatrix.simulation import simulate
from lightmatrix.simulation.colour import in_all_primaries

SCENES = ("l_objects", "gripper", "metal", "corner")
SIZE, NOISE, SQUARE = (64, 64), 0.003, 8
# How much of red, green and blue light the surface passes on that tints global light.
OTHER_SURFACE = (0.3, 1.0, 0.6)


def tinted(truth: lm.Truth, other: bool) -> lm.Truth:
    """A colour truth with surfaces of random colours; `other` tints global light once more."""
    wide = in_all_primaries(truth)
    rows, cols, channels = wide.camera_shape
    squares = np.random.default_rng(5).uniform(
        0.25, 1, (-(-rows // SQUARE), -(-cols // SQUARE), channels)
    )
    surface = np.kron(squares, np.ones((SQUARE, SQUARE, 1)))[:rows, :cols].reshape(-1)
    of_global = np.tile(OTHER_SURFACE if other else np.ones(channels), rows * cols)
    entries = np.diff(wide.matrix.indptr)
    direct = wide.direct_data * np.repeat(surface, entries)
    rest = (wide.matrix.data - wide.direct_data) * np.repeat(surface * of_global, entries)
    data = (direct + rest).astype(np.float32)
    return replace(wide, matrix=wide.with_data(data), direct_data=direct.astype(np.float32))


def photographed(
    scene: str, truth: lm.Truth, count: int, grey: int, wide: lm.Truth | None = None
) -> lm.SimulatedCapture:
    """Photographs under patterns in colour, at the exposure that `plan` advises for grey ones."""
    patterns = lm.colour_bernoulli(SIZE, count, grey=grey)
    exposure = lm.plan(truth, frames=32, noise=NOISE).exposure
    if wide is None:
        return lm.simulate(scene, patterns, exposure=exposure, noise=NOISE)
    with patch.object(simulate, "in_all_primaries", lambda _: wide):
        return lm.simulate(scene, patterns, exposure=exposure, noise=NOISE)


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
        for count, grey in ((32, 16), (32, 0), (64, 16)):
            error = shared(photographed(scene, truth, count, grey))
            table.add_row(scene, f"{count}, {grey} grey", error)
        for other in (False, True):
            capture = photographed(scene, truth, 32, 16, tinted(truth, other))
            what = "other surfaces" if other else "tinted"
            table.add_row(scene, f"32, 16 grey, {what}", shared(capture))
        if chosen.before:
            wide = side_by_side(photographed(scene, truth, 32, 0))
            table.add_row(scene, "32, side by side", f"{wide:.4f}")
            for count in (11, 32):
                each = three_captures(scene, truth, count)
                table.add_row(scene, f"three captures of {count}", f"{each:.4f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
