"""The memory and time of estimates: the coefficients of `lightmatrix.estimators.cost_model`.

    python -m benchmarks.resource_estimate [--quick] [--old resources.json] [-o resources.json]

Every case is a capture folder of a procedural scene. `lightmatrix estimate` takes it, with all its
checks, as a process of its own: its largest resident set and its processor time are compared with
what the model says. Afterwards the model's coefficients are fitted to them: those of the time by
least squares of relative errors, those of the memory so that no case takes more than is said, and
that what is said is otherwise as little as possible. All are >= 0. Sizes are sides of square
cameras and projectors. `--old` fits and compares earlier measurements.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, nnls

import lightmatrix as lm
from benchmarks.growth import command_cost
from experiments.harness import options as options_of
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
    ("coherent", 128, 128, 32, False),
    ("coherent", 128, 128, 64, True),
    ("coherent", 256, 64, 32, False),
    ("coherent", 256, 128, 64, False),
    ("coherent", 192, 256, 32, False),
    ("coherent", 256, 256, 64, False),
    ("coherent", 256, 256, 64, True),
    ("coherent", 256, 512, 32, False),
    ("coherent", 384, 192, 128, False),
    ("coherent", 512, 256, 64, False),
    ("coherent", 512, 512, 64, False),
    ("plain", 64, 64, 64, False),
    ("plain", 64, 256, 64, False),
    ("plain", 64, 512, 64, False),
    ("plain", 64, 512, 256, False),
    ("plain", 128, 512, 64, False),
    ("plain", 128, 1024, 256, False),
    ("plain", 64, 64, 64, True),
    ("plain", 64, 256, 64, True),
    ("plain", 64, 256, 256, True),
    ("plain", 128, 64, 256, False),
    ("plain", 128, 64, 512, False),
    ("plain", 256, 64, 64, False),
    ("plain", 128, 128, 256, False),
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


def measure(case: Case) -> dict[str, Any]:
    """One case, in processes of its own."""
    with tempfile.TemporaryDirectory() as place:
        in_process_of_its_own("--make", json.dumps(case), place)
        cost = in_process_of_its_own("--estimate", case[0], place)
    names = ("method", "camera", "projector", "count", "grey")
    return dict(zip(names, case, strict=True)) | cost


def in_process_of_its_own(*words: str) -> dict[str, Any]:
    """What this program prints for some words.

    The resident set of the estimate's process begins with the largest that its parent ever had.
    """
    command = [sys.executable, "-m", MODULE, *words]
    ran = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(ran.stdout or "{}"))


def estimate(method: str, folder: Path) -> dict[str, float]:
    """Peak of memory in bytes, and processor seconds, of the command; and what checks may take."""
    way = [] if method == "coherent" else ["--no-coherent"]
    capture = folder / "capture"
    cost = command_cost("estimate", capture, *way, "-o", folder / "scene.zarr")
    ran = lm.StoredTransport.open(folder / "scene.zarr").provenance["estimator"]
    if ran != method:
        raise SystemExit(f"{capture}: was estimated by {ran}, not by {method}")
    said = lm.estimate_resources(capture, lm.EstimateSettings(coherent=method == "coherent"))
    return {
        "bytes": cost["peak_gib"] * 2**30,
        "seconds": cost["processor_s"],
        "checking": said.size.check_bytes,
    }


def size_of(row: dict[str, Any]) -> cost_model.EstimateSize:
    """The size of a case, as the model knows it."""
    camera, projector = row["camera"], row["projector"]
    shape, count, grey = (camera, camera), row["count"], row["grey"]
    windows = lm.CoherentEstimator.windows
    return cost_model.EstimateSize(
        row["method"],
        shape,
        projector**2,
        count,
        grey,
        check_bytes=row["checking"],
        windows=windows,
    )


def fit(rows: list[dict[str, Any]], kind: str) -> None:
    """Print the coefficients that fit best, beside those in the code, and what the code says."""
    some = [row for row in rows if size_of(row).kind == kind]
    if not some:
        return
    sizes = [size_of(row) for row in some]
    numbers = [(size.rows, size.pixels, size.count, size.grey) for size in sizes]
    memory = [cost_model.memory_terms(kind, *each) for each in numbers]
    time = [
        cost_model.time_terms(kind, *each, size.searching)
        for each, size in zip(numbers, sizes, strict=True)
    ]
    # Small cases take what is loaded anyway.
    own = np.array([row["bytes"] for row in some]) - cost_model.LOADED_BYTES
    own = np.maximum(own, cost_model.LOADED_BYTES / 10)
    print(f"\n{kind}, bytes:")
    show(kind, "bytes", memory, covering(matrix_of(memory) / own[:, None]))
    print(f"{kind}, seconds:")
    seconds = np.array([row["seconds"] for row in some])
    fitted, _ = nnls(matrix_of(time) / seconds[:, None], np.ones(len(some)))
    show(kind, "seconds", time, fitted)
    for row, size in zip(some, sizes, strict=True):
        times = size.memory / row["bytes"], (size.seconds(1) or 0) / row["seconds"]
        print(
            f"    {_words(row):<44} {row['bytes'] / 2**20:7.0f} MiB, {row['seconds']:7.1f} s; "
            f"the code says {times[0]:.2f} and {times[1]:.2f} times as much"
        )


def matrix_of(columns: list[dict[str, float]]) -> NDArray[np.float64]:
    """The terms of each case, a row each."""
    return np.array([list(column.values()) for column in columns])


def covering(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients >= 0 that give each case at least 1, and as little more as possible."""
    cases = len(shares)
    # Terms differ by orders of magnitude, which the solver does not like.
    scale = np.maximum(shares.max(axis=0), 1e-300)
    result = linprog((shares / scale).sum(axis=0), A_ub=-shares / scale, b_ub=-np.ones(cases))
    if not result.success:
        raise SystemExit(f"no coefficients cover all cases: {result.message}")
    return np.asarray(result.x) / scale


def show(
    kind: str, what: str, columns: list[dict[str, float]], fitted: NDArray[np.float64]
) -> None:
    """Print coefficients beside those in the code."""
    now = cost_model.COEFFICIENTS[kind][what]
    for name, value in zip(columns[0], fitted, strict=True):
        print(f"  {name:<12} {value:10.3g}   in the code {now.get(name, 0):.3g}")


def _words(row: dict[str, Any]) -> str:
    kind = "grey" if row["grey"] else "bits"
    return f"camera {row['camera']}, projector {row['projector']}, {row['count']} {kind}"


def main() -> None:
    parser = options_of("benchmarks.resource_estimate", __doc__)
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--make", nargs=2, metavar=("CASE", "FOLDER"))
    parser.add_argument("--estimate", nargs=2, metavar=("METHOD", "FOLDER"))
    parser.add_argument("--old", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("resources.json"))
    arguments = parser.parse_args()
    if arguments.make:
        text, place = arguments.make
        make(tuple(json.loads(text)), Path(place) / "capture")
        return
    if arguments.estimate:
        method, place = arguments.estimate
        print(json.dumps(estimate(method, Path(place))))
        return
    rows = json.loads(arguments.old.read_text()) if arguments.old else []
    for case in () if arguments.old else CASES:
        if not arguments.quick or case[1] * case[2] <= QUICK * 2:
            rows.append(measure(case))
            print(json.dumps(rows[-1]), flush=True)
            arguments.output.write_text(json.dumps(rows, indent=1))
    for kind in cost_model.COEFFICIENTS:
        fit(rows, kind)


if __name__ == "__main__":
    main()
