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
import json
import os
import platform
import time
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import (
    blas,
    peers,
    solver_claims,
    solver_plot,
    solver_rows,
    solver_speed,
    solver_tables,
)

Row = dict[str, Any]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scene, few rows")
    parser.add_argument("--truth", type=Path, help="folder of rendered truths, SCENE.npz")
    parser.add_argument("-o", "--out", type=Path, default=Path("bench-out"))
    options = parser.parse_args(arguments)
    if arguments is None:
        blas.at_its_best()
    options.out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    console = Console(width=150)
    console.print(f"BLAS: {blas.described()}")
    quick = options.quick
    scenes = solver_rows.SCENES[:1] if quick else solver_rows.SCENES
    results: dict[str, Any] = {"machine": _machine(), "quick": quick}

    results |= _frames(scenes, options)
    show, tables = solver_tables.show, solver_tables
    show(
        console,
        "Whole frames, all cores, best of 3, and on one core",
        results["frames"],
        tables.FRAMES,
    )
    agreement = "Against an independent float64 solver, relative to the objective"
    show(console, agreement, results["agreement"], tables.AGREEMENT)
    admm = "Against Saturation ADMM until within 0.1 % of the optimum, one core"
    show(console, admm, results["saturation_admm"], tables.ADMM)
    with _single_core():
        results["passes"] = [row for count in (256, 1024) for row in solver_speed.passes(count)]
        show(console, "One correlation pass, one core", results["passes"], tables.PASSES)
        counts = (64,) if quick else (64, 256, 1024)
        results["peers"] = [row for count in counts for row in _peer_rows(scenes, count, options)]
        show(
            console,
            "Peers to a gap of 1e-4, unclipped rows, one core",
            results["peers"],
            tables.PEERS,
        )
        sizes = (32, 64) if quick else (32, 64, 128, 256)
        results["scaling"] = solver_speed.scaling(sizes, (64, 256, 1024), 192)
        results["scaling_rows"] = solver_speed.scaling_rows(64, 256, (64, 256, 1024, 4096))
        show(console, "Cost of synthetic rows, one core", results["scaling"], tables.SCALING)
        show(console, "Cost against rows, one core", results["scaling_rows"], tables.SCALING)
    results["claims"] = solver_claims.claims(results)
    show(console, "Claims", results["claims"], tables.CLAIMS)
    solver_plot.scaling(results["scaling"], results["scaling_rows"], options.out)
    results["minutes"] = (time.perf_counter() - started) / 60
    (options.out / "solver.json").write_text(json.dumps(results, indent=1) + "\n")
    console.print(
        f"{results['minutes']:.1f} minutes; written: {options.out}/solver.json, scaling.png, "
        "scaling.svg"
    )


def _frames(scenes: tuple[str, ...], options: argparse.Namespace) -> dict[str, list[Row]]:
    """Measure whole frames of the scenes, and compare their answers with independent solvers."""
    frames, agreements, admm = [], [], []
    for scene in scenes:
        truth = solver_rows.exposed_truth(scene, options.truth)
        for count in (64, 256, 1024):
            patterns = solver_rows.bernoulli(count)
            problem = solver_rows.photographed(truth, patterns)
            frames.append({"scene": scene, **solver_speed.whole_frame(problem)})
            with _single_core():
                frames[-1] |= solver_speed.on_one_core(problem)
            if count == 256:
                compared = solver_speed.agreement(problem, 20 if options.quick else 67)
                agreements.append({"scene": scene, **compared})
                low = solver_rows.photographed(truth, patterns, regularization=0.11)
                frames.append({"scene": scene, **solver_speed.whole_frame(low, repeats=1)})
            if scene == scenes[0] and count > 64:
                with _single_core():
                    compared = solver_speed.against_saturation_admm(problem, 64)
                admm.append({"scene": scene, "patterns": count, **compared})
    return {"frames": frames, "agreement": agreements, "saturation_admm": admm}


def _peer_rows(scenes: tuple[str, ...], count: int, options: argparse.Namespace) -> list[Row]:
    truth = solver_rows.exposed_truth(scenes[0], options.truth)
    every = truth[np.arange(0, truth.shape[0], 16)]
    problem = solver_rows.photographed(every, solver_rows.bernoulli(count), clip=False)
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
        raise SystemExit("install the extra: pip install 'lightmatrix[bench]'") from error
    return threadpool_limits(1)


def _machine() -> Row:
    core = solver_rows.bernoulli(8, (8, 8)).prepared
    known = Path("/proc/cpuinfo")
    lines = known.read_text().splitlines() if known.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if "model name" in line), "")
    return {
        "cores": os.cpu_count(),
        "processor": model or platform.processor() or platform.machine(),
        "instructions": core.instructions,
        "blas": blas.kernels(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
    }


PACKAGES = ("lightmatrix", "numpy", "scipy", "celer", "skglm", "scikit-learn", "sporco")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    main()
