"""How the cost of an estimate grows with camera and projector: `python -m benchmarks.growth`.

The default estimate of the procedural scene, from packed capture to stored matrix, each size in a
process of its own: processor and clock seconds, and the largest resident set. What is fitted to the
processor's seconds is a constant times a power of the camera's pixels times one of the projector's.

    python -m benchmarks.growth [--sizes 128:128 192:384 384:192 384:384 384:768 576:384]
                                [--count 64]

A size is camera:projector, each a side or ROWSxCOLS; 1024x1024:768x1024 is a megapixel,
256:2160x3840 has a 4K projector and takes 27 GiB.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm
from benchmarks.procedural_captures import photograph
from experiments.harness import options as options_of

Shape = tuple[int, int]
SIZES = ("128:128", "192:384", "384:192", "384:384", "384:768", "576:384")


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a line of JSON for each size and one for the fit."""
    parser = options_of("benchmarks.growth", __doc__)
    usual = list(map(size, SIZES))
    parser.add_argument("--sizes", nargs="+", type=size, default=usual, metavar="SIZE")
    parser.add_argument("--count", type=int, default=64)
    options = parser.parse_args(arguments)
    measured = []
    for camera, projector in options.sizes:
        cost = estimated(camera, projector, options.count)
        print(json.dumps({"camera": camera, "projector": projector, **cost}), flush=True)
        measured.append((np.prod(camera), np.prod(projector), cost["processor_s"]))
    if len(measured) >= 3:
        camera_power, projector_power = powers(np.array(measured, float))
        print(json.dumps({"power_of_camera": camera_power, "power_of_projector": projector_power}))


def size(text: str) -> tuple[Shape, Shape]:
    """Camera and projector of 384:768x1024."""
    camera, projector = map(_shape, text.split(":"))
    return camera, projector


def _shape(text: str) -> Shape:
    rows, _, cols = text.partition("x")
    return int(rows), int(cols or rows)


def estimated(camera: Shape, projector: Shape, count: int) -> dict[str, float]:
    """What the estimate of one size takes, by a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        capture, matrix = Path(folder) / "capture.zarr", Path(folder) / "scene.zarr"
        scene = lm.ProceduralScene(camera, projector)
        photograph(capture, scene, lm.BernoulliPatterns(projector, count))
        return command_cost("estimate", capture, "-o", matrix)


def command_cost(*words: str | Path) -> dict[str, float]:
    """Processor and clock seconds of a command, and its largest resident set.

    The process that asks must be small, because the set of a new process starts as its parent's.
    """
    command = [sys.executable, "-m", "lightmatrix", *map(str, words), "--json"]
    unseen = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    started = time.perf_counter()
    child = os.posix_spawn(sys.executable, command, os.environ, file_actions=unseen)
    _, status, used = os.wait4(child, 0)
    clock = time.perf_counter() - started
    if status:
        raise SystemExit(f"failed: lightmatrix {' '.join(command[3:])}")
    spent = used.ru_utime + used.ru_stime
    return {"processor_s": spent, "clock_s": clock, "peak_gib": used.ru_maxrss / 2**20}


def powers(measured: NDArray[np.float64]) -> tuple[float, float]:
    """The powers of camera and of projector pixels with which a cost grows.

    They are fitted by least squares of the logarithms of `measured`, (n, 3): camera pixels,
    projector pixels, cost.
    """
    logs = np.log(measured)
    terms = np.column_stack([logs[:, :2], np.ones(len(logs))])
    camera, projector, _ = np.linalg.lstsq(terms, logs[:, 2])[0]
    return float(camera), float(projector)


if __name__ == "__main__":
    main()
