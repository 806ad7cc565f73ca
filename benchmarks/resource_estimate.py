"""The memory of estimates, beside the bound that `lm.estimate_resources` states.

    python -m benchmarks.resource_estimate [--quick] [-o resources.json]

Every case is a capture folder of a procedural scene. `lightmatrix estimate` takes it, with all its
checks, as a process of its own, whose largest resident set is compared with the bound. The run
fails if an estimate takes more. Sizes are sides of square cameras and projectors.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import lightmatrix as lm
from benchmarks.scale import command_cost
from experiments.harness import options
from lightmatrix.simulation.procedural import ProceduralScene

# Whether neighbours help; camera, projector, patterns; grey patterns or bits. Those of `--quick`
# come first.
CASES: tuple[tuple[bool, int, int, int, bool], ...] = (
    (True, 64, 64, 32, False),
    (True, 64, 256, 32, True),
    (True, 128, 128, 32, False),
    (False, 64, 256, 64, False),
    (False, 128, 128, 64, True),
    (False, 256, 64, 64, False),
    (True, 64, 256, 128, True),
    (True, 256, 128, 64, False),
    (True, 256, 256, 64, True),
    (True, 384, 192, 128, False),
    (True, 512, 512, 64, False),
    (False, 64, 512, 256, False),
    (False, 256, 256, 256, True),
    (False, 512, 512, 64, False),
)
QUICK = 6


def measure(case: tuple[bool, int, int, int, bool]) -> dict[str, Any]:
    """The bound and the peak of a case, in bytes, and its time."""
    coherent = case[0]
    way = "--coherent" if coherent else "--no-coherent"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "capture"
        # The resident set of a process begins with the largest that its parent ever had, so that
        # another process makes the capture.
        words = [sys.executable, "-m", "benchmarks.resource_estimate", "--make", json.dumps(case)]
        subprocess.run([*words, str(folder)], check=True)
        cost = command_cost("estimate", folder, way, "-o", Path(place) / "scene.zarr")
        said = lm.estimate_resources(folder, lm.EstimateSettings(coherent=coherent))
    peak = cost["peak_gib"] * 2**30
    return {
        "case": case,
        "bound": said.memory,
        "peak": peak,
        "share": round(peak / said.memory, 2),
        "said_s": said.seconds,
        "processor_s": cost["processor_s"],
    }


def make(case: tuple[bool, int, int, int, bool], folder: Path) -> None:
    """Write the capture of a case."""
    _, camera, projector, count, grey = case
    patterns: lm.PatternSet = lm.BernoulliPatterns((projector, projector), count)
    if grey:
        levels = np.random.default_rng(0).integers(0, 256, (count, projector, projector))
        patterns = lm.ImagePatterns((levels / 255).astype(np.float32))
    truth = ProceduralScene((camera, camera), (projector, projector), seed=1).truth()
    exposure = 1 / float(np.quantile(truth.matrix.sum(axis=1), 0.999))
    lm.simulate(truth, patterns, exposure=exposure, noise=0.003).save(folder)


def main() -> None:
    parser = options("benchmarks.resource_estimate", __doc__)
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--make", nargs=2, metavar=("CASE", "FOLDER"))
    parser.add_argument("-o", "--output", type=Path, default=Path("resources.json"))
    arguments = parser.parse_args()
    if arguments.make:
        text, place = arguments.make
        make(tuple(json.loads(text)), Path(place))
        return
    rows = []
    for case in CASES[: QUICK if arguments.quick else None]:
        rows.append(measure(case))
        print(json.dumps(rows[-1]), flush=True)
        arguments.output.write_text(json.dumps(rows, indent=1))
    if max(row["share"] for row in rows) > 1:
        raise SystemExit("an estimate took more memory than its bound")


if __name__ == "__main__":
    main()
