"""Measures the solver and checks its claims: `python -m benchmarks` (or `make bench`).

Answers come first: certified gaps, agreement with an independent float64 solver, objectives and
gaps of other packages. Then times. Tables go to the terminal, everything to `bench-out/`
(`solver.json`, `scaling.png`, `scaling.svg`). Problems have the benchmark exposure, noise of 0.003
clip levels, 8 bits and lambda = 0.32 clip levels. BLAS runs the processor's own kernel, whatever
the environment says.

    python -m benchmarks [--quick] [--truth FOLDER] [-o bench-out]

`--truth` is a folder of rendered truths at 128 x 128, SCENE.npz. Without it they come from the
cache or are rendered, which takes minutes per scene.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import peers, solver_claims, solver_speed
from experiments.harness import Row, show, write_json
from experiments.harness import options as options_of

# Environment variables of OpenBLAS that choose a kernel or its block size.
BLAS_SETTINGS = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE")
# The columns of each table: keys of its rows, and their headings.
FRAMES = {
    "scene": "scene",
    "patterns": "K",
    "regularization": "lambda",
    "seconds": "s",
    "sgemm_seconds": "one SGEMM, s",
    "ratio": "ratio",
    "microseconds_per_row": "one core, µs per row",
    "core_ratio": "ratio",
    "certified": "certified",
    "worst_gap": "worst gap",
    "passes": "passes",
    "support": "support",
    "clipped": "clipped",
}
AGREEMENT = {
    "scene": "scene",
    "rows": "rows",
    "beyond_certified_gap": "beyond certified gap",
    "objective_difference_at_1e-6": "difference at 1e-6",
    "reference_gap": "gap of the reference",
}
ADMM = {
    "scene": "scene",
    "patterns": "K",
    "rows": "rows",
    "microseconds_per_row": "active set, µs per row",
    "admm_iterations": "ADMM iterations",
    "admm_microseconds_per_row": "ADMM, µs per row",
    "admm_above_optimum": "above optimum",
    "times_faster": "times",
}
PASSES = {
    "patterns": "K",
    "kernel": "kernel",
    "microseconds_per_row": "µs per row",
    "sgemm_microseconds_per_row": "SGEMM, µs per row",
    "times_sgemm": "times SGEMM",
}
PEERS = {
    "patterns": "K",
    "name": "method",
    "setting": "its setting",
    "microseconds_per_row": "µs per row",
    "worst_gap": "worst gap",
    "objective": "mean objective",
    "times_active_set": "times active set",
    "note": "",
}
SCALING = {
    "size": "side",
    "patterns": "K",
    "rows": "rows",
    "microseconds_per_row": "µs per row",
    "nanoseconds_per_pattern_pixel": "ns / (K N)",
    "certified": "certified",
}


def main(arguments: list[str] | None = None) -> None:
    parser = options_of("benchmarks", __doc__)
    parser.add_argument("--quick", action="store_true", help="one scene, few rows")
    parser.add_argument("--truth", type=Path, help="folder of rendered truths, SCENE.npz")
    parser.add_argument("-o", "--out", type=Path, default=Path("bench-out"))
    options = parser.parse_args(arguments)
    # OpenBLAS reads its settings when it is loaded, so the process restarts without them.
    environment = {name: value for name, value in os.environ.items() if name not in BLAS_SETTINGS}
    if arguments is None and len(environment) < len(os.environ):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)
    started = time.perf_counter()
    quick = options.quick
    scenes = solver_speed.SCENES[:1] if quick else solver_speed.SCENES
    results: dict[str, Any] = {"machine": _machine(), "quick": quick}
    print(f"BLAS: {results['machine']['blas'] or 'unknown (install threadpoolctl)'}")

    results |= _frames(scenes, options)
    show("Whole frames, all cores, best of 3, and on one core", results["frames"], FRAMES)
    title = "Against an independent float64 solver, relative to the objective"
    show(title, results["agreement"], AGREEMENT)
    title = "Against Saturation ADMM until within 0.1 % of the optimum, one core"
    show(title, results["saturation_admm"], ADMM)
    with _single_core():
        results["passes"] = [row for count in (256, 1024) for row in solver_speed.passes(count)]
        show("One correlation pass, one core", results["passes"], PASSES)
        counts = (64,) if quick else (64, 256, 1024)
        results["peers"] = [row for count in counts for row in _peer_rows(scenes, count, options)]
        show("Peers to a gap of 1e-4, unclipped rows, one core", results["peers"], PEERS)
        sizes = (32, 64) if quick else (32, 64, 128, 256)
        results["scaling"] = solver_speed.scaling(sizes, (64, 256, 1024), 192)
        results["scaling_rows"] = solver_speed.scaling_rows(64, 256, (64, 256, 1024, 4096))
        show("Cost of synthetic rows, one core", results["scaling"], SCALING)
        show("Cost against rows, one core", results["scaling_rows"], SCALING)
    results["claims"] = solver_claims.claims(results)
    show("Claims", results["claims"])
    results["minutes"] = (time.perf_counter() - started) / 60
    write_json(options.out / "solver.json", results)
    draw_scaling(results["scaling"], results["scaling_rows"], options.out)
    print(f"{results['minutes']:.1f} minutes; see {options.out}")


def draw_scaling(table: list[dict[str, Any]], by_rows: list[dict[str, Any]], folder: Path) -> None:
    """Plot the cost of a row against N and K, with lines proportional to N, and against rows."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for count in sorted({row["patterns"] for row in table}):
        rows = [row for row in table if row["patterns"] == count]
        pixels = [row["size"] ** 2 for row in rows]
        cost = [row["microseconds_per_row"] for row in rows]
        (line,) = left.loglog(pixels, cost, "o-", label=f"K = {count:,}")
        left.loglog(
            pixels, [cost[-1] * n / pixels[-1] for n in pixels], ":", color=line.get_color()
        )
    left.set(xlabel="projector pixels N", ylabel="µs per row, one core")
    left.legend(title="dotted: proportional to N")
    costs = [row["microseconds_per_row"] for row in by_rows]
    right.semilogx([row["rows"] for row in by_rows], costs, "o-")
    first = by_rows[0]
    right.set(
        xlabel=f"rows (N = {first['size'] ** 2:,}, K = {first['patterns']})",
        ylabel="µs per row, one core",
        ylim=(0, 1.2 * max(costs)),
    )
    for kind in ("png", "svg"):
        figure.savefig(folder / f"scaling.{kind}", dpi=150)


def _frames(scenes: tuple[str, ...], options: argparse.Namespace) -> dict[str, list[Row]]:
    """Measure whole frames of the scenes, and compare their answers with independent solvers."""
    frames, agreements, admm = [], [], []
    for scene in scenes:
        truth = solver_speed.exposed_truth(scene, options.truth)
        for count in (64, 256, 1024):
            patterns = solver_speed.bernoulli(count)
            problem = solver_speed.photographed(truth, patterns)
            frames.append({"scene": scene, **solver_speed.whole_frame(problem)})
            with _single_core():
                frames[-1] |= solver_speed.on_one_core(problem)
            if count == 256:
                compared = solver_speed.agreement(problem, 20 if options.quick else 67)
                agreements.append({"scene": scene, **compared})
                low = solver_speed.photographed(truth, patterns, regularization=0.11)
                frames.append({"scene": scene, **solver_speed.whole_frame(low, repeats=1)})
            if scene == scenes[0] and count > 64:
                with _single_core():
                    compared = solver_speed.against_saturation_admm(problem, 64)
                admm.append({"scene": scene, "patterns": count, **compared})
    return {"frames": frames, "agreement": agreements, "saturation_admm": admm}


def _peer_rows(scenes: tuple[str, ...], count: int, options: argparse.Namespace) -> list[Row]:
    truth = solver_speed.exposed_truth(scenes[0], options.truth)
    every = truth[np.arange(0, truth.shape[0], 16)]
    problem = solver_speed.photographed(every, solver_speed.bernoulli(count), clip=False)
    centred = peers.Centred(peers.with_active_rows(problem, 4 if options.quick else 12))
    many = peers.Centred(peers.with_active_rows(problem, 256))
    table: list[Row] = []
    for name, (method, ladder) in peers.methods(centred).items():
        try:
            outcome = asdict(centred.run(name, method, ladder, 1e-4))
        except ImportError as error:
            table.append({"patterns": count, "name": name, "note": f"no module {error.name}"})
            continue
        if name == "active set":
            # The cost varies from row to row, so time many rows; accuracy is from the same rows.
            batch = peers.methods(many)[name][0]
            seconds = many.run(name, batch, ladder, 1e-4, repeats=5).seconds_per_row
        else:
            seconds = outcome["seconds_per_row"]
        missed = outcome["worst_gap"] > 1e-4
        table.append(
            {
                "patterns": count,
                **outcome,
                "microseconds_per_row": 1e6 * seconds,
                "note": "does not reach the gap" if missed else "",
            }
        )
    ours = table[0]["microseconds_per_row"]
    for row in table:
        if "microseconds_per_row" in row:
            row["times_active_set"] = row["microseconds_per_row"] / ours
    return table


def _single_core() -> Any:
    try:
        from threadpoolctl import threadpool_limits
    except ImportError as error:
        raise SystemExit('install the extra: pip install "lightmatrix[bench]"') from error
    return threadpool_limits(1)


def _machine() -> Row:
    core = solver_speed.bernoulli(8, (8, 8)).prepared
    known = Path("/proc/cpuinfo")
    lines = known.read_text().splitlines() if known.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if "model name" in line), "")
    return {
        "cores": os.cpu_count(),
        "processor": model or platform.processor() or platform.machine(),
        "instructions": core.instructions,
        "blas": _blas(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
    }


PACKAGES = ("lightmatrix", "numpy", "scipy", "celer", "skglm", "scikit-learn", "sporco")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _blas() -> list[str]:
    """The loaded BLAS libraries and their kernels; empty without threadpoolctl."""
    try:
        from threadpoolctl import threadpool_info
    except ImportError:
        return []
    return [
        f"{one.get('internal_api')} {one.get('version')}, {one.get('architecture')}"
        for one in threadpool_info()
        if one.get("user_api") == "blas"
    ]


if __name__ == "__main__":
    main()
