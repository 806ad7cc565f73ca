"""Measure the errors that `lightmatrix plan` states, on the rendered scenes.

    python -m benchmarks.plan_calibration            makes src/lightmatrix/planning/table.json

The scenes have 128 x 128 pixels (rendered on first use), or 64 x 64 below 12 frames, the camera 8
bits and noise of 0.003 of its clip level, with one seed. Row by row, every fifth camera row is
estimated; coherent estimates need whole frames. Each finished run is kept in the output, so that an
interrupted calibration continues.
"""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from experiments.harness import benchmark_exposure, markdown
from experiments.harness import options as options_of
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence
from lightmatrix.capture.sensor import Sensor
from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import (
    relative_error,
    relighting_error,
    unseen_patterns,
)
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.grey import grey_patterns
from lightmatrix.patterns.mix import MixedPatterns, default_mix
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.planning.exposure_advice import WhiteFrame, advise_exposures
from lightmatrix.simulation.library import truth
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import ActiveSet

TABLE = Path(__file__).parents[1] / "src" / "lightmatrix" / "planning" / "table.json"
SIZE = (128, 128)
SCENES = ("l_objects", "gripper", "metal")
COUNTS = (8, 10, 12, 16, 32, 64, 128, 256)
ROW_STEP = 5


def main() -> None:
    """Run the missing cases and write the table."""
    parser = options_of("benchmarks.plan_calibration", __doc__)
    parser.add_argument("--output", type=Path, default=TABLE)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--estimators", nargs="+", default=("row by row", "coherent"))
    parser.add_argument("--counts", nargs="+", type=int, default=COUNTS)
    parser.add_argument("--patterns", nargs="+", default=("grey", "fine", "mix"))
    parser.add_argument("--exposures", nargs="+", default=("advised", "long"))
    parser.add_argument("--densities", nargs="+", type=float, default=(0.5,))
    parser.add_argument("--show", action="store_true", help="Print the tables of the docs.")
    arguments = parser.parse_args()
    if arguments.show:
        show(json.loads(arguments.output.read_text())["rows"])
        return
    rows: list[dict[str, Any]] = (
        json.loads(arguments.output.read_text())["rows"] if arguments.output.exists() else []
    )
    wanted = (
        arguments.estimators,
        arguments.scenes,
        arguments.counts,
        arguments.patterns,
        arguments.exposures,
        arguments.densities,
    )
    names = ("estimator", "scene", "frames", "patterns", "exposures", "density")
    for values in itertools.product(*wanted):
        case = dict(zip(names, values, strict=True))
        grey = case["frames"] < FEWEST_BLACK_AND_WHITE
        if grey != (case["patterns"] == "grey") or (grey and case["estimator"] == "row by row"):
            continue
        if (case["patterns"] == "mix" and case["frames"] < 64) or _known(rows, case):
            continue
        rows.append({**case, **run(**case)})
        print(rows[-1], flush=True)
        _write(arguments.output, rows)


def _known(rows: list[dict[str, Any]], case: dict[str, Any]) -> bool:
    return any(all(row[key] == value for key, value in case.items()) for row in rows)


def _write(path: Path, rows: list[dict[str, Any]]) -> None:
    lines = ",\n".join("    " + json.dumps(row) for row in rows)
    made = "python -m benchmarks.plan_calibration"
    path.write_text(f'{{\n  "made_by": "{made}",\n  "rows": [\n{lines}\n  ]\n}}\n')


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table in Markdown: a row for each plan, a column for each scene."""
    plans = ("estimator", "frames", "patterns", "exposures", "density")
    table: dict[tuple[Any, ...], dict[str, str]] = {}
    for row in rows:
        cell = f"{row['relative_error']:.3f} / {row['relighting_error']:.3f}"
        table.setdefault(tuple(row[key] for key in plans), {})[row["scene"]] = cell
    lines = (
        [*map(str, plan), *(cells.get(scene, "") for scene in SCENES)]
        for plan, cells in sorted(table.items())
    )
    print(markdown([*plans, *SCENES], lines))


def run(
    estimator: str, scene: str, frames: int, patterns: str, exposures: str, density: float
) -> dict[str, float]:
    """One estimate and its errors."""
    # Fewer than twelve photographs do not tell so many pixels apart.
    size = SIZE if frames >= 12 else (64, 64)
    known = truth(scene, size)
    white = known.matrix.sum(axis=1)
    if exposures == "advised":
        chosen = advise_exposures(WhiteFrame(white, np.zeros(len(white), bool)), frames=frames)
    else:
        chosen = [(benchmark_exposure(known.transport()), 1.0)]
    if estimator == "row by row":
        known = some_rows(known)
    pattern_set: PatternSet = BernoulliPatterns(size, frames, density)
    if patterns == "grey":
        pattern_set = grey_patterns(size, frames)
    elif patterns == "mix":
        pattern_set = MixedPatterns(size, frames, default_mix(size, frames), density)
    capture, share = photograph(known, pattern_set, chosen)
    coherent = estimator == "coherent"
    started = time.perf_counter()
    estimate = (CoherentEstimator() if coherent else PlainEstimator(ActiveSet())).estimate(capture)
    seconds = time.perf_counter() - started
    expected = known.transport()
    unseen = np.stack(list(unseen_patterns(size).values()))
    return {
        "relative_error": round(relative_error(estimate, expected), 4),
        "relighting_error": round(relighting_error([estimate], [expected], unseen), 4),
        "clipped_share": round(share, 4),
        "seconds": round(seconds, 1),
    }


def some_rows(known: Truth) -> Truth:
    """Every fifth camera row, as a camera of one column."""
    chosen = np.arange(0, known.matrix.shape[0], ROW_STEP)
    part = csr_array(known.matrix[chosen])
    return replace(
        known, matrix=part, direct_data=np.zeros_like(part.data), camera_shape=(len(chosen), 1)
    )


def photograph(
    known: Truth,
    patterns: PatternSet,
    exposures: list[tuple[float, float]],
    noise: float = 0.003,
) -> tuple[Capture, float]:
    """A capture of 8 bits, and the share of its samples that clipped."""
    sensor = Sensor(exposure_sequence(exposures, patterns), read_noise=noise)
    frames = sensor.expose(irradiance(known.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(patterns.count, *known.camera_shape)
    return Capture.from_arrays(patterns, stack, sensor), float((frames == 255).mean())


if __name__ == "__main__":
    main()
