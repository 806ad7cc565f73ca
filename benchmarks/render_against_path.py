"""Compare T p of rendered matrices with the renderer's own path integrator, at full size.

    python benchmarks/render_against_path.py [--size 128] [--spp 1024] [-o render_against_path.json]

The matrix comes from the cache (rendered at 16,384 paths per pixel on first use). The reference is
path traced twice, with different seeds, and the pattern as the projector's texture. The mean of the
two is the reference, and their difference shows its noise. The matrix passes if its images differ
from the reference by at most 1.5 times that noise, and their sums by at most 0.1 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation import library
from lightmatrix.simulation.llvm import load_mitsuba
from lightmatrix.simulation.mitsuba_scene import mitsuba_scene
from lightmatrix.simulation.scenes import scene
from lightmatrix.simulation.truth import Truth

# The limits stated above.
MOST_NOISE, MOST_SUM = 1.5, 1e-3


def patterns(side: int) -> dict[str, NDArray[np.float32]]:
    rows, cols = np.indices((side, side))
    block = (abs(rows - 0.45 * side) < side / 8) & (abs(cols - 0.55 * side) < side / 8)
    return {
        "white": np.ones((side, side), np.float32),
        "checker": ((rows // 8 + cols // 8) % 2).astype(np.float32),
        "block": block.astype(np.float32),
        "ramp": ((3 * rows + cols) / (4 * side - 4)).astype(np.float32),
    }


def compare(mi: Any, truth: Truth, name: str, samples: int) -> list[dict[str, Any]]:
    result = []
    integrator = {"type": "path", "max_depth": scene(name).max_depth + 1, "rr_depth": 1000}
    for kind, pattern in patterns(truth.projector_shape[0]).items():
        loaded = mitsuba_scene(
            mi, scene(name), truth.projector_shape, truth.projector_shape, pattern, integrator
        )
        halves = [
            np.asarray(mi.render(loaded, spp=samples, seed=seed), np.float64).mean(axis=2).ravel()
            for seed in (1, 2)
        ]
        expected = (halves[0] + halves[1]) / 2
        norm = np.linalg.norm(expected)
        noise = float(np.linalg.norm(halves[0] - halves[1]) / 2 / norm)
        image = truth.matrix @ pattern.ravel() / truth.metadata["scale"]
        error = float(np.linalg.norm(image - expected) / norm)
        result.append(
            {
                "scene": name,
                "pattern": kind,
                "relative_l2": error,
                "reference_noise": noise,
                "ratio": error / noise,
                "sum_error": float(image.sum(dtype=np.float64) / expected.sum() - 1),
            }
        )
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=1024, help="of each half of the reference")
    parser.add_argument("--scenes", nargs="+", default=list(library.BUNDLED))
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    mi, _ = load_mitsuba()
    rows = []
    print("| scene | pattern | relative L2 | noise of the reference | ratio | sum |")
    print("|---|---|---|---|---|---|")
    for name in options.scenes:
        started = time.perf_counter()
        truth = library.truth(name, (options.size, options.size))
        for row in compare(mi, truth, name, options.spp):
            rows.append(row)
            print(
                f"| {name} | {row['pattern']} | {row['relative_l2']:.2%} | "
                f"{row['reference_noise']:.2%} | {row['ratio']:.2f} | {row['sum_error']:+.3%} |",
                flush=True,
            )
        print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    passed = all(row["ratio"] <= MOST_NOISE and abs(row["sum_error"]) <= MOST_SUM for row in rows)
    if options.output:
        summary = {"size": options.size, "spp": options.spp, "passed": passed, "rows": rows}
        options.output.write_text(json.dumps(summary, indent=2) + "\n")
    print(
        f"{'all' if passed else 'NOT all'} within {MOST_NOISE} x noise and {MOST_SUM:.1%} of sums"
    )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
