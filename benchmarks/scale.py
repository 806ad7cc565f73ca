"""What estimates of any size take and how good they are: `python -m benchmarks.scale`.

The default estimate of the procedural scene, from packed capture to stored matrix, each size in a
process of its own: processor and clock seconds, and the largest resident set beside the bound that
`estimate --dry-run` states. Then its error against the truth, the stated one and the verdict. What
is fitted to the processor's seconds is a constant times a power of the camera's pixels times one of
the projector's.

    python -m benchmarks.scale [--sizes 128:128 192:384 ... 576:384] [--4k] [--count 64] [-o OUT]

A size is camera:projector, each a side or ROWSxCOLS; 1024x1024:768x1024 is a megapixel. A camera of
96of1024 is the middle of one of 1024 x 1024, as a projector of 4K needs fine camera pixels. `--4k`
adds such sizes, which take an hour. OUT/scale.jsonl gets the lines, and OUT/scale.png a figure; a
later run goes on after the last size.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from benchmarks.procedural_captures import photograph
from experiments.harness import options as options_of
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.transport.sparse_rows import stack_rows

Shape = tuple[int, int]
SIZES = ("128:128", "192:384", "384:192", "384:384", "384:768", "576:384")
SIZES_4K = ("96of1024:2160x3840", "256of1024:2160x3840", "1024:2160x3840")


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a line of JSON for each size and one for the fit."""
    parser = options_of("benchmarks.scale", __doc__)
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="SIZE")
    parser.add_argument("--4k", dest="large", action="store_true")
    parser.add_argument("--count", type=int, default=64)
    parser.add_argument("-o", "--out", type=Path, default=Path("scale-out"))
    parser.add_argument("--make", metavar="FOLDER", help="write the capture of the first size")
    parser.add_argument("--judge", metavar="STORE", help="the error of the first size's estimate")
    options = parser.parse_args(arguments)
    sizes = [*options.sizes, *(SIZES_4K if options.large else ())]
    if options.make:
        scene = Middle.of(sizes[0])
        patterns = lm.BernoulliPatterns(scene.projector_shape, options.count)
        photograph(Path(options.make), scene, patterns)
        return
    if options.judge:
        print(json.dumps(judged(lm.open(options.judge), Middle.of(sizes[0]))))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    lines = options.out / "scale.jsonl"
    known = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    costs = {cost["size"]: cost for cost in known}
    for name in sizes:
        if name not in costs:
            costs[name] = {"size": name, **estimated(name, options.count)}
            with lines.open("a") as stream:
                stream.write(json.dumps(costs[name]) + "\n")
        print(json.dumps(costs[name]), flush=True)
    if len(sizes) >= 3:
        draw_growth([costs[name] for name in sizes], options.out)


def draw_growth(costs: list[dict[str, Any]], folder: Path) -> None:
    """Time and memory against what they grow with, and a line for each, as OUT/scale.png."""
    pixels = np.array([[np.prod(shape) for shape in size(cost["size"])] for cost in costs], float)
    shown = (
        ("processor_s", "processor, seconds", COLOURS[0]),
        ("peak_gib", "memory, GiB", COLOURS[1]),
    )
    with figure(7.2, 3.2) as drawing:
        for axes, (key, label, colour) in zip(drawing.subplots(1, 2), shown, strict=True):
            values = np.array([cost[key] for cost in costs])
            camera, projector, factor = powers(np.column_stack([pixels, values]))
            print(
                json.dumps({"of": key, "power_of_camera": camera, "power_of_projector": projector})
            )
            grown = pixels[:, 0] ** camera * pixels[:, 1] ** projector
            order = np.argsort(grown)
            axes.loglog(grown[order], factor * grown[order], color=colour)
            axes.loglog(grown, values, "o", color=colour)
            axes.set_xlabel(
                f"camera pixels$^{{{camera:.2f}}}$ × projector pixels$^{{{projector:.2f}}}$"
            )
            axes.set_ylabel(label)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter(NullFormatter())
            for cost, across, up in zip(costs, grown, values, strict=True):
                axes.annotate(
                    cost["size"].replace(":", " : "), (across, up), (4, -3),
                    textcoords="offset points", fontsize=6, va="top",
                )  # fmt: skip
        save(drawing, folder, "scale")


@dataclass(frozen=True)
class Middle:
    """The middle rows and columns of the procedural scene's camera, or all of them."""

    scene: lm.ProceduralScene
    camera_shape: Shape

    @classmethod
    def of(cls, text: str) -> Middle:
        """The scene of a size such as 384:768x1024 or 96of1024:2160x3840."""
        camera, projector = text.split(":")
        part, _, whole = camera.partition("of")
        scene = lm.ProceduralScene(_shape(whole or part), _shape(projector))
        return cls(scene, _shape(part))

    @property
    def seed(self) -> int:
        """That of the scene."""
        return self.scene.seed

    @property
    def projector_shape(self) -> Shape:
        """Rows and columns of the projector's pixels."""
        return self.scene.projector_shape

    def rows(self, start: int, stop: int) -> tuple[csr_array, None]:
        """Rows start..stop of T."""
        whole, own = self.scene.camera_shape, self.camera_shape
        top, left = (whole[0] - own[0]) // 2, (whole[1] - own[1]) // 2
        parts = []
        for row in range(start // own[1], -(-stop // own[1])):
            first, last = max(start, row * own[1]), min(stop, (row + 1) * own[1])
            place = (top + row) * whole[1] + left - row * own[1]
            parts.append(self.scene.rows(place + first, place + last)[0])
        return stack_rows(parts), None

    def blocks(self) -> Iterator[tuple[int, csr_array]]:
        """All rows, some at a time, with the first row's number."""
        count = self.camera_shape[0] * self.camera_shape[1]
        for start in range(0, count, 16_384):
            yield start, self.rows(start, min(start + 16_384, count))[0]


def _shape(text: str) -> Shape:
    rows, _, cols = text.partition("x")
    return int(rows), int(cols or rows)


def size(text: str) -> tuple[Shape, Shape]:
    """Camera and projector of 384:768x1024."""
    scene = Middle.of(text)
    return scene.camera_shape, scene.projector_shape


def estimated(name: str, count: int) -> dict[str, Any]:
    """What the estimate of one size takes, by a process of its own, and how good it is."""
    with tempfile.TemporaryDirectory() as folder:
        capture, matrix = Path(folder) / "capture.zarr", Path(folder) / "scene.zarr"
        # A new process begins with the largest set that its parent had: others do the rest.
        again = [sys.executable, "-m", "benchmarks.scale", "--count", str(count), "--sizes", name]
        subprocess.run([*again, "--make", str(capture)], check=True)
        bound = subprocess.run(
            [sys.executable, "-m", "lightmatrix", "estimate", str(capture), "--dry-run", "--json"],
            check=True,
            capture_output=True,
        )
        # The middle of a camera sees so little of the projector that checks cannot judge it.
        unchecked = ["--no-check", "--correct", "none"] if "of" in name else []
        cost = command_cost("estimate", capture, "-o", matrix, *unchecked)
        error = subprocess.run(
            [*again, "--judge", str(matrix)], check=True, capture_output=True
        ).stdout
        return {
            **cost,
            "bound_gib": json.loads(bound.stdout)["memory_bytes"] / 2**30,
            **json.loads(error),
        }


def judged(estimate: lm.LightTransport, truth: Middle) -> dict[str, Any]:
    """The error of T, background included, by rows, and what the estimate states of it."""
    wrong, whole = 0.0, 0.0
    for start, known in truth.blocks():
        rows, shape = estimate.some_rows(start, start + known.shape[0]), (known.shape[0], 1)
        parts = rows.coefficients, rows.background, shape, estimate.projector_shape
        right = lm.LightTransport.from_matrix(known, shape, estimate.projector_shape)
        energy = float(np.square(known.data, dtype=np.float64).sum())
        found = lm.LightTransport(*parts, estimate.background_grid)
        wrong += relative_error(found, right) ** 2 * energy
        whole += energy
    verdict = lm.verdicts(estimate).transport
    return {
        "error": (wrong / whole) ** 0.5,
        "stated": verdict.error,
        "verdict": verdict.level,
    }


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


def powers(measured: NDArray[np.float64]) -> tuple[float, float, float]:
    """The powers of camera and of projector pixels with which a cost grows, and its factor.

    They are fitted by least squares of the logarithms of `measured`, (n, 3): camera pixels,
    projector pixels, cost.
    """
    logs = np.log(measured)
    terms = np.column_stack([logs[:, :2], np.ones(len(logs))])
    camera, projector, factor = np.linalg.lstsq(terms, logs[:, 2])[0]
    return float(camera), float(projector), float(np.exp(factor))


if __name__ == "__main__":
    main()
