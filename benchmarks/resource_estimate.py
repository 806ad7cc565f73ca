"""The memory and time of estimates: the coefficients of `lightmatrix.estimators.cost_model`.

    python -m benchmarks.resource_estimate [--quick] [-o resources.json]

Every case is a capture folder of a procedural scene, estimated by a process of its own on one core
after what has been loaded and opened: its peak of resident memory above that of a process that has
only opened the capture, and its CPU time. Afterwards the model's coefficients are fitted to them,
by least squares of relative errors with coefficients >= 0, and printed beside those in the code.
Sizes are sides of square cameras and projectors.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from scipy.optimize import nnls

import lightmatrix as lm
from lightmatrix.estimators import cost_model
from lightmatrix.simulation.procedural_scene import ProceduralScene

Case = tuple[str, int, int, int, bool]

# Method, camera, projector, patterns, grey patterns or bits.
CASES: tuple[Case, ...] = (
    ("coherent", 64, 64, 32, False),
    ("coherent", 64, 128, 32, False),
    ("coherent", 64, 256, 32, False),
    ("coherent", 64, 512, 32, False),
    ("coherent", 64, 64, 32, True),
    ("coherent", 64, 256, 32, True),
    ("coherent", 64, 64, 128, False),
    ("coherent", 64, 256, 128, False),
    ("coherent", 64, 256, 128, True),
    ("coherent", 128, 64, 32, False),
    ("coherent", 128, 128, 64, True),
    ("coherent", 256, 64, 32, False),
    ("coherent", 256, 128, 64, False),
    ("plain", 64, 64, 64, False),
    ("plain", 64, 256, 64, False),
    ("plain", 64, 512, 64, False),
    ("plain", 64, 512, 256, False),
    ("plain", 64, 64, 64, True),
    ("plain", 64, 256, 64, True),
    ("plain", 64, 256, 256, True),
    ("plain", 128, 64, 256, False),
    ("plain", 128, 64, 512, False),
    ("plain", 256, 64, 64, False),
    ("plain", 256, 128, 256, False),
)
QUICK = 32 * 64
MODULE = "benchmarks.resource_estimate"


def make(case: Case, folder: Path) -> None:
    """Write the capture of a case."""
    _, camera, projector, count, grey = case
    truth = ProceduralScene((camera, camera), (projector, projector), seed=1).truth()
    patterns: lm.PatternSet = lm.BernoulliPatterns((projector, projector), count)
    if grey:
        random = np.random.default_rng(0)
        levels = random.integers(0, 256, (count, projector, projector)) / 255
        patterns = lm.ImagePatterns(levels.astype(np.float32))
    exposure = 1 / float(np.quantile(truth.matrix.sum(axis=1), 0.999))
    lm.simulate(truth, patterns, exposure=exposure, noise=0.003).save(folder)


def estimate(case: Case, folder: Path) -> dict[str, float]:
    """Peak of memory in bytes beyond what is loaded anyway, and CPU seconds, of one estimate."""
    capture = lm.Capture.open(folder)
    settings = lm.EstimateSettings(coherent=case[0] == "coherent")
    estimator = lm.choose_estimator(capture, settings)
    loaded = psutil.Process().memory_info().rss
    started = time.process_time()
    estimator.estimate(capture, output=folder / "scene.zarr")
    return {
        "bytes": _peak() - loaded,
        "loaded": loaded,
        "seconds": time.process_time() - started,
    }


def _peak() -> int:
    """Most resident memory that this process ever had, in bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def measure(case: Case) -> dict[str, Any]:
    """One case, in processes of its own."""
    costs: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as place:
        for step in ("make", "estimate"):
            ran = subprocess.run(
                [sys.executable, "-m", MODULE, "--step", step, json.dumps(case), place],
                check=True, capture_output=True, text=True,
                env={**os.environ, "RAYON_NUM_THREADS": "1"},
            )  # fmt: skip
            costs = json.loads(ran.stdout or "{}")
    return dict(zip(("method", "camera", "projector", "count", "grey"), case, strict=True)) | costs


def fit(rows: list[dict[str, Any]], method: str) -> None:
    """Print the coefficients that fit best, beside those in the code."""
    some = [row for row in rows if row["method"] == method]
    sizes = [(r["camera"] ** 2, r["projector"] ** 2, r["count"], r["grey"]) for r in some]
    for what, terms in (("bytes", cost_model.memory_terms), ("seconds", cost_model.time_terms)):
        measured = np.array([row[what] for row in some])
        columns = [terms(method, *size) for size in sizes]
        names = list(columns[0])
        matrix = np.array([[column[name] for name in names] for column in columns])
        fitted, _ = nnls(matrix / measured[:, None], np.ones(len(some)))
        now = cost_model.COEFFICIENTS[method][what]
        print(f"\n{method}, {what}:")
        for name, value in zip(names, fitted, strict=True):
            print(f"  {name:<20} {value:12.4g}   in the code {now.get(name, 0):.4g}")
        for row, model, own in zip(some, matrix @ fitted, measured, strict=True):
            print(f"    {_words(row):<44} measured {own:10.4g}, model {model / own:5.2f} of it")


def _words(row: dict[str, Any]) -> str:
    kind = "grey" if row["grey"] else "bits"
    return f"camera {row['camera']}, projector {row['projector']}, {row['count']} {kind}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--step", nargs=3, metavar=("STEP", "CASE", "FOLDER"))
    parser.add_argument("-o", "--output", type=Path, default=Path("resources.json"))
    arguments = parser.parse_args()
    if arguments.step:
        step, text, place = arguments.step
        case: Case = tuple(json.loads(text))
        if step == "make":
            make(case, Path(place) / "capture")
        else:
            print(json.dumps(estimate(case, Path(place) / "capture")))
        return
    rows = []
    for case in CASES:
        if not arguments.quick or case[1] * case[2] <= QUICK * 2:
            rows.append(measure(case))
            print(json.dumps(rows[-1]), flush=True)
            arguments.output.write_text(json.dumps(rows, indent=1))
    for method in ("coherent", "plain"):
        fit(rows, method)


if __name__ == "__main__":
    main()
