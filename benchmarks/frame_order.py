"""How often frames out of order are noticed, and how often good captures are accused.

    python benchmarks/frame_order.py [--scenes l_objects corner ...] [--seeds 3] [-o order.json]

Each of the bundled 64 x 64 scenes is photographed (8 bits) under several pattern sets. Of each
capture, four versions are checked: as it is, two random frames swapped, one random frame missed
(later ones move up, the last is repeated), and all frames late by one.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.rig import library
from lightmatrix.rig.simulate import irradiance

COUNTS = (12, 16, 32, 64, 256)
# Quantile of the row maxima that just does not clip, and read noise.
CAMERAS = ((0.999, 0.003), (0.8, 0.003), (0.3, 0.02))


def pattern_sets(count: int, seed: int) -> dict[str, PatternSet]:
    size = library.BUNDLED_SIZE
    return {
        "Bernoulli 0.5": BernoulliPatterns(size, count, 0.5, seed),
        "Bernoulli 0.1": BernoulliPatterns(size, count, 0.1, seed),
        "Hadamard, random": HadamardPatterns(size, count, "random", True, seed),
        "Hadamard, sequency": HadamardPatterns(size, count, "sequency"),
    }


def complaint(
    patterns: PatternSet, frames: NDArray[np.integer], sensor: Sensor, order: NDArray[np.integer]
) -> str | None:
    try:
        Capture.from_arrays(patterns, frames[order], sensor, check=False).check()
    except InputError as error:
        return error.message
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=list(library.BUNDLED))
    parser.add_argument("--counts", nargs="+", type=int, default=list(COUNTS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    tally: dict[tuple[str, int], dict[str, int]] = {}
    for name, count, seed in itertools.product(
        options.scenes, options.counts, range(options.seeds)
    ):
        truth = library.truth(name)
        strongest = truth.matrix.max(axis=1).toarray().ravel()
        for kind, patterns in pattern_sets(count, seed).items():
            light = irradiance(truth.matrix, patterns)
            row = tally.setdefault((kind, count), dict.fromkeys(HEAD, 0))
            for quantile, noise in CAMERAS:
                sensor = Sensor(float(1 / np.quantile(strongest, quantile)), read_noise=noise)
                raw = sensor.expose(light, seed=seed)
                frames = np.ascontiguousarray(raw.T).reshape(count, *truth.camera_shape)
                generator = np.random.default_rng(seed)
                a, b = np.sort(generator.permutation(count)[:2])
                swapped = np.arange(count)
                swapped[[a, b]] = b, a
                lost = int(generator.integers(1, count - 2))
                shifted = np.append(np.delete(np.arange(count), lost), count - 1)
                late = np.append(np.arange(1, count), count - 1)
                said = complaint(patterns, frames, sensor, swapped)
                row["captures"] += 1
                row["accused"] += complaint(patterns, frames, sensor, np.arange(count)) is not None
                row["swap noticed"] += said is not None
                row["both named"] += said is not None and f"frame {a} and frame {b} " in said
                row["loss noticed"] += complaint(patterns, frames, sensor, shifted) is not None
                row["lag noticed"] += complaint(patterns, frames, sensor, late) is not None
    print(table(tally))
    if options.output:
        rows = [{"patterns": kind, "count": count, **row} for (kind, count), row in tally.items()]
        options.output.write_text(json.dumps({"rows": rows}, indent=2) + "\n")


HEAD = ("captures", "accused", "swap noticed", "both named", "loss noticed", "lag noticed")


def table(tally: dict[tuple[str, int], dict[str, int]]) -> str:
    lines = ["| patterns | K | " + " | ".join(HEAD) + " |", "|" + "---|" * (len(HEAD) + 2)]
    for (kind, count), row in sorted(tally.items()):
        cells = [kind, str(count), *(str(row[name]) for name in HEAD)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
