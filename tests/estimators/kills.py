"""Estimates of a large frame that are killed at random moments: are they whole afterwards?

    python -m tests.estimators.kills [--count 50] [--first 0] [--small] [--workers 2]

Each run starts one estimate on the same store again and again. It is killed (SIGKILL) after a
random time up to three times, then left alone. The store must equal that of an estimate that was
never killed, to the last bit, and nothing may be left beside it. The frame is a small one that is
treated as large, so that estimates spread from seeds, and every round has several tiles.

With `--workers` so many worker processes solve the tiles. Each time one of them is killed, which
the estimate must survive, or the process that hands out tiles, where the next one goes on, with
workers or without; none of its workers may outlive it.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import psutil

from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent import schedule
from lightmatrix.estimators.coherent.estimator import WINDOWS, CoherentEstimator
from lightmatrix.estimators.workers import dask_pool
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import simulate
from lightmatrix.transport import store

# Half widths of the windows, sides of camera and projector, patterns.
LARGER = (WINDOWS, 48, 40, 32)
SMALLER = (((2, 1), (1, 1)), 24, 24, 16)
MOST_KILLS = 3
# Workers end at once when the process that started them does; a busy machine takes its time.
ORPHANED = 120.0


def in_child(work: Callable[[], None], seconds: float | None = None) -> bool:
    """Do something in a process of its own; whether it was killed, after so many seconds."""
    child = os.fork()
    if child == 0:
        _do(work)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return True
    if os.waitstatus_to_exitcode(status):
        raise RuntimeError("an estimate failed")
    return False


def estimated(
    capture: Path,
    target: Path,
    windows: tuple[tuple[int, int], ...],
    *,
    overwrite: bool = False,
    workers: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Begin an estimate, or go on with it."""
    estimator = CoherentEstimator(windows=windows, tile_rows=200, threads=1)
    opened = Capture.open(capture)
    with dask_pool(workers) if workers else nullcontext() as pool:
        estimator.estimate(opened, output=target, overwrite=overwrite, progress=progress, pool=pool)


def kill_later(victim: str, seconds: float, killed: Path) -> Callable[[int, int], None]:
    """Progress that kills this process or one of its workers, so long after it was called first.

    The file `killed` then exists if a worker was killed.
    """
    timers: list[threading.Timer] = []

    def kill() -> None:
        victims = workers_of(psutil.Process()) if victim == "worker" else [psutil.Process()]
        if victims:
            victims[0].kill()
            killed.touch()

    def progress(done: int, total: int) -> None:
        if not timers:
            timers.append(threading.Timer(seconds, kill))
            timers[0].daemon = True
            timers[0].start()

    return progress


def workers_of(process: psutil.Process) -> list[psutil.Process]:
    """The worker processes that a process has started."""
    children = process.children(recursive=True)
    return [child for child in children if any("spawn_main" in part for part in child.cmdline())]


def outlived(workers: list[psutil.Process]) -> int:
    """How many workers are still there, after a while."""
    _, alive = psutil.wait_procs(workers, timeout=ORPHANED)
    return len(alive)


def killed_with_workers(
    draw: random.Random, work: Callable[..., None], usual: float, killed: Path
) -> bool:
    """Start an estimate with workers and kill one of these, or the estimate; whether it was."""
    victim = draw.choice(["worker", "client"])
    progress = kill_later(victim, draw.uniform(0, usual), killed)
    seen: dict[int, psutil.Process] = {}
    child = os.fork()
    if child == 0:
        _do(partial(work, progress=progress))
    while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
        with suppress(psutil.Error):
            seen |= {one.pid: one for one in workers_of(psutil.Process(child))}
        time.sleep(0.05)
    if not os.WIFSIGNALED(ended[1]) and os.waitstatus_to_exitcode(ended[1]):
        raise RuntimeError("an estimate failed")
    if outlived(list(seen.values())):
        raise RuntimeError("workers outlived the estimate")
    worker = killed.exists()
    killed.unlink(missing_ok=True)
    return worker or os.WIFSIGNALED(ended[1])


def digest(target: Path) -> str:
    """A hash of all rows of a store."""
    matrix = store.open(target)
    hasher = hashlib.sha256()
    parts = [matrix.sparse.indptr, matrix.sparse.indices, matrix.sparse.data, matrix.background]
    for values in (*parts, *(matrix.diagnostics[name] for name in sorted(matrix.diagnostics))):
        hasher.update(np.ascontiguousarray(values).tobytes())
    return hasher.hexdigest()


def main() -> int:
    """Run many estimates, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--workers", type=int, default=0)
    options = parser.parse_args()
    schedule.GROWTH = replace(schedule.GROWTH, large=0, fewest_seeds=3)
    windows, camera, projector, count = SMALLER if options.small else LARGER
    kills = wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        capture, whole = Path(folder) / "capture.zarr", Path(folder) / "whole.zarr"
        scene = ProceduralScene((camera, camera), (projector, projector))
        patterns = BernoulliPatterns((projector, projector), count)
        in_child(lambda: _simulated(capture, scene, patterns))
        started = time.monotonic()
        in_child(lambda: estimated(capture, whole, windows))
        usual = time.monotonic() - started
        wanted = digest(whole)
        for seed in range(options.first, options.first + options.count):
            draw = random.Random(seed)
            place = Path(folder) / f"run-{seed}"
            place.mkdir()
            target = place / "scene.zarr"

            def work(target: Path = target, **how: Any) -> None:
                estimated(capture, target, windows, **how)

            killed = 0
            for _ in range(draw.randint(1, MOST_KILLS)):
                if target.exists():
                    break
                if options.workers:
                    helped = partial(work, workers=options.workers)
                    killed += killed_with_workers(draw, helped, usual, place / "killed")
                else:
                    killed += in_child(work, draw.uniform(0, usual))
            # Killed between its last renaming and tidying up, an estimate is whole, and the next
            # one in its place tidies up.
            in_child(partial(work, overwrite=target.exists()))
            left = sorted(entry.name for entry in place.iterdir())
            right = digest(target) == wanted and left == ["scene.zarr"]
            kills, wrong = kills + killed, wrong + (not right)
            print(f"{seed}: {killed} kills, {'right' if right else f'WRONG, {left}'}", flush=True)
    print(f"{options.count} runs, {kills} kills, {wrong} wrong")
    return 1 if wrong or not kills else 0


def _do(work: Callable[[], None]) -> NoReturn:
    """Do something in this process, a fork, and end it."""
    try:
        work()
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def _simulated(capture: Path, scene: ProceduralScene, patterns: BernoulliPatterns) -> None:
    simulate(scene.truth(), patterns).save(capture)


if __name__ == "__main__":
    sys.exit(main())
