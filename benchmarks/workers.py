"""How much faster two workers are than one: `python -m benchmarks.workers`.

Workers have one thread each. Both must give the same bits as an estimate without workers. One and
two workers estimate in turn, so that other work on the machine affects both alike, and the best of
the repeats counts. The time includes reading, solving, writing and joining, but not the workers'
start. The processor time of the workers and of this process stands beside the clock's: on a busy
machine it bounds what two workers would gain on two idle cores.

With `--weak`, four workers estimate a camera of twice the sides, and one worker its quarter. Each
counts as if it had a core of its own, by processor seconds: first what this process prepares and
joins while workers wait, then the worker that takes longest. Messages travel while workers solve.

    python -m benchmarks.workers [--camera 256] [--projector 256] [--count 64] [--repeats 3]
                                [--weak]
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import lightmatrix as lm
from benchmarks.procedural_captures import photograph
from experiments.harness import options as options_of
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.workers import DaskPool, dask_pool


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a line of JSON for each kind of estimate."""
    parser = options_of("benchmarks.workers", __doc__)
    for name, value in (("camera", 256), ("projector", 256), ("count", 64), ("repeats", 3)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--weak", action="store_true")
    options = parser.parse_args(arguments)
    # Read by the workers, which divide it: one thread each.
    os.environ["RAYON_NUM_THREADS"] = "1"
    projector = (options.projector, options.projector)
    patterns = lm.BernoulliPatterns(projector, options.count)

    def capture(folder: str, side: int) -> Path:
        place = Path(folder) / f"{side}.zarr"
        photograph(place, lm.ProceduralScene((side, side), projector), patterns)
        return place

    with tempfile.TemporaryDirectory() as folder:
        if options.weak:
            places = [capture(folder, times * options.camera) for times in (1, 2)]
            times = {n: by_process(place, n) for n, place in zip((1, 4), places, strict=True)}
            ratio = sum(times[4]) / sum(times[1])
            print(json.dumps({**vars(options), "seconds": times, "ratio": ratio}), flush=True)
            return
        place = capture(folder, options.camera)
        for coherent in (False, True):
            figures = measured(place, coherent, options.repeats)
            print(json.dumps({"coherent": coherent, **vars(options), **figures}), flush=True)


def measured(place: Path, coherent: bool, repeats: int) -> dict[str, Any]:
    """Seconds of one worker and of two, by the clock and of the processors; the best of each."""
    capture = lm.Capture.open(place)
    alone = lm.estimate(capture, coherent=coherent)
    clock: dict[int, list[float]] = {1: [], 2: []}
    processors: dict[int, list[float]] = {1: [], 2: []}
    with dask_pool(1) as one, dask_pool(2) as two:
        for _ in range(repeats):
            for number, pool in ((1, one), (2, two)):
                before, started = spent(pool), time.perf_counter()
                estimate = estimated(capture, coherent, pool)
                clock[number].append(time.perf_counter() - started)
                processors[number].append(spent(pool) - before)
                if not same(estimate, alone):
                    raise SystemExit(f"{number} workers give another result than none")
    best = {number: min(times) for number, times in clock.items()}
    work = {number: min(times) for number, times in processors.items()}
    return {
        "seconds": best,
        "processor_seconds": work,
        "times_as_fast": best[1] / best[2],
        "at_best_on_two_cores": 2 * work[1] / work[2],
    }


def by_process(place: Path, number: int) -> tuple[float, float]:
    """Processor seconds of this thread and of the busiest of some workers."""
    with dask_pool(number) as pool:
        before, started = processes(pool), time.thread_time()
        estimated(lm.Capture.open(place), True, pool)
        own = time.thread_time() - started
        _, *workers = np.subtract(processes(pool), before)
    return own, float(max(workers))


def estimated(capture: lm.Capture, coherent: bool, pool: DaskPool) -> lm.LightTransport:
    """An estimate by workers."""
    settings = lm.EstimateSettings(coherent=coherent)
    return choose_estimator(capture, settings).estimate(capture, pool=pool)


def spent(pool: DaskPool) -> float:
    """Processor seconds of the workers and of this process so far."""
    return sum(processes(pool))


def processes(pool: DaskPool) -> list[float]:
    """Processor seconds of this process and of each worker so far."""
    pids = [os.getpid(), *pool.client.run(os.getpid).values()]
    times = [psutil.Process(pid).cpu_times() for pid in pids]
    return [one.user + one.system for one in times]


def same(one: lm.LightTransport, other: lm.LightTransport) -> bool:
    """Whether two matrices are the same to the last bit."""
    pairs = [(getattr(one.sparse, n), getattr(other.sparse, n)) for n in ("data", "indices")]
    pairs += [(one.background, other.background)]
    pairs += [(one.diagnostics[name], other.diagnostics[name]) for name in one.diagnostics]
    return all(np.array_equal(*pair, equal_nan=True) for pair in pairs)


if __name__ == "__main__":
    main()
