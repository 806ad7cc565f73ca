"""Estimates of a large frame that are killed at random moments: are they whole afterwards?

    python -m tests.kills [--count 50] [--first 0] [--small]

Each run starts one estimate on the same store again and again. It is killed (SIGKILL) after a
random time up to three times, then left alone. The store must equal that of an estimate that was
never killed, to the last bit, and nothing may be left beside it. The frame is a small one that is
treated as large, so that light grows from seeds, and every round has several tiles.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from lightmatrix import store
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent import stages
from lightmatrix.estimators.coherent.estimator import WINDOWS, CoherentEstimator
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.rig.at_scale import simulate_procedural
from lightmatrix.rig.procedural import ProceduralScene

# Half widths of the windows, sides of camera and projector, patterns.
LARGER = (WINDOWS, 48, 40, 32)
SMALLER = (((2, 1), (1, 1)), 24, 24, 16)
MOST_KILLS = 3


def in_child(work: Callable[[], None], seconds: float | None = None) -> bool:
    """Do something in a process of its own; whether it was killed, after so many seconds."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
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
) -> None:
    """Begin an estimate, or go on with it."""
    estimator = CoherentEstimator(windows=windows, tile_rows=200, threads=1)
    opened = Capture.open(capture, check=False)
    estimator.estimate(opened, checkpoint=target, overwrite=overwrite)


def digest(target: Path) -> str:
    """Of all that a store says of its rows."""
    found = store.open(target)
    hasher = hashlib.sha256()
    parts = [found.sparse.indptr, found.sparse.indices, found.sparse.data, found.background]
    for values in (*parts, *(found.diagnostics[name] for name in sorted(found.diagnostics))):
        hasher.update(np.ascontiguousarray(values).tobytes())
    return hasher.hexdigest()


def main() -> int:
    """Run many, and tell what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--small", action="store_true")
    options = parser.parse_args()
    stages.LARGE, stages.FEWEST_SEEDS = 0, 3
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

            def work(target: Path = target, *, overwrite: bool = False) -> None:
                estimated(capture, target, windows, overwrite=overwrite)

            killed = 0
            for _ in range(draw.randint(1, MOST_KILLS)):
                if target.exists():
                    break
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


def _simulated(capture: Path, scene: ProceduralScene, patterns: BernoulliPatterns) -> None:
    simulate_procedural(capture, scene, patterns)


if __name__ == "__main__":
    sys.exit(main())
