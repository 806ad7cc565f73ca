"""Fig. 6: RMSE against one-pixel responses on rendered scenes (the paper's Section 4.2).

Projector and camera have 128 x 128 pixels and the patterns are Bernoulli. The 8-bit camera has
noise of 0.003 of its range, at the exposure at which a fifth of the camera pixels clip under their
strongest projector pixel.

All methods are judged on 4,096 camera pixels, which form 64 blocks of 8 x 8: every other block in
both directions. They are compared with the responses to 256 projector pixels, 64 of which are the
middles of these blocks. ADMM and Saturation ADMM would take hours for all of them. Their curves are
therefore the minima of their objectives (of the convex form, for Saturation ADMM), which the
active-set solver finds to a duality gap of 1e-4. The two methods themselves run, for a limited
number of iterations, on 128 of the camera pixels: in each block the pixel that the sampled
projector pixel lights most, and a random one.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from experiments.harness import Experiment, Measured, all_rows
from experiments.measured_scene import (
    BITS,
    LETTERED,
    SCENES,
    bernoulli_capture,
    measured_scene,
)
from experiments.methods import (
    BY_NAME,
    ITERATIONS,
    METHODS,
    REGULARIZATION,
    ROMP_SPARSITY,
    Reach,
)
from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import COHERENT_UP_TO, USUAL_NOISE
from lightmatrix.patterns.blocks import sampled_pixels
from lightmatrix.pictures.style import figure, save

# Numbers of patterns in the order of measurement, so that a run in progress spans the whole range.
OBSERVATIONS = (16, 64, 256, 1024, 32, 128, 512)
QUICK_OBSERVATIONS = (16, 64)
# Pixels per side of camera and projector.
SIZE, QUICK_SIZE = 128, 64
# The side of camera blocks, and the distance of sampled projector pixels.
BLOCK = 8


@dataclass(frozen=True)
class Case:
    """One method on one capture."""

    scene: str
    method: str
    observations: int
    size: int = SIZE

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.scene}-{self.size}-{self.method}-k{self.observations}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases, method by method."""
    counts, size = (QUICK_OBSERVATIONS, QUICK_SIZE) if quick else (OBSERVATIONS, SIZE)
    for count in counts:
        for reach in Reach:
            for scene in SCENES:
                for method in METHODS:
                    slow = reach is Reach.CAMERA and count > COHERENT_UP_TO
                    if method.reach is reach and not slow:
                        yield Case(scene, method.name, count, size)


def parameters(quick: bool) -> dict[str, Any]:
    """The parameters of the table."""
    return {
        "size": QUICK_SIZE if quick else SIZE,
        "noise": USUAL_NOISE,
        "bits": BITS,
        "lambda": REGULARIZATION,
        "iterations": ITERATIONS,
        "romp_n": ROMP_SPARSITY,
        "seed": 0,
    }


def measure(case: Case) -> Measured:
    """RMSE in clip levels of one case, over all judged pixels and over the few."""
    scene = measured_scene(case.scene, case.size)
    capture = bernoulli_capture(case.scene, case.size, case.observations)
    method = BY_NAME[case.method]
    blocks, few = judged_rows(case.scene, case.size)
    rows = {Reach.CAMERA: None, Reach.BLOCKS: blocks, Reach.ROWS: few}[method.reach]
    part = capture if rows is None else of_rows(capture, rows)
    started = time.perf_counter()
    estimate = method.estimate(part, 1 / scene.exposure)
    seconds = time.perf_counter() - started
    columns = sampled_pixels(scene.known.projector_shape, BLOCK, BLOCK // 2)
    responses = estimate.dense_columns(columns)
    known = scene.truth.matrix[:, columns].toarray()
    if rows is None:
        responses, rows = responses[blocks], blocks
    squares = np.square((responses - known[rows]) * scene.exposure, dtype=np.float64)
    whole = method.reach is not Reach.ROWS
    row = {
        **asdict(case),
        "rmse": float(np.sqrt(squares.mean())) if whole else None,
        "rmse_few": float(np.sqrt(squares[np.isin(rows, few)].mean())),
        "clipped": float(capture.clipped_share),
        "iterations": float(np.median(estimate.diagnostics["iterations"])),
        "seconds": round(seconds, 2),
        "rows": len(rows) if method.reach is not Reach.CAMERA else capture.rows,
    }
    return Measured([row])


def of_rows(capture: Capture, rows: NDArray[np.integer]) -> Capture:
    """A capture of some camera pixels only, arranged as blocks below each other or as a column."""
    frames = np.stack([capture.frames.read(k).ravel()[rows] for k in range(capture.count)])
    side = BLOCK if len(rows) % BLOCK**2 == 0 and len(rows) > BLOCK**2 else 1
    stack = np.ascontiguousarray(frames).reshape(capture.count, -1, side)
    return Capture.from_arrays(capture.patterns, stack, capture.decoder)


@lru_cache(maxsize=1)
def judged_rows(name: str, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The camera pixels of every other block, block by block, and the few among them."""
    scene = measured_scene(name, size)
    index = np.arange(size * size).reshape(size // BLOCK, BLOCK, size // BLOCK, BLOCK)
    blocks = index.swapaxes(1, 2)[::2, ::2].reshape(-1, BLOCK * BLOCK)
    middles = sampled_pixels((size, size), 2 * BLOCK, BLOCK // 2)
    known = scene.truth.matrix[:, middles].toarray()
    random = np.random.default_rng(0)
    few = []
    for number, block in enumerate(blocks):
        few.append(block[known[block, number].argmax()])
        few.append(random.choice(np.setdiff1d(block, few[-1:])))
    return blocks.ravel(), np.sort(np.array(few))


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    rows = all_rows(results)
    with figure(7.2, 4.9) as drawing:
        panels = drawing.subplots(2, len(SCENES), sharex=True, sharey="row")
        for column, (scene, title) in enumerate(LETTERED.items()):
            for line, error in enumerate(("rmse", "rmse_few")):
                axes = panels[line, column]
                for method in METHODS:
                    points = sorted(
                        (row["observations"], row[error])
                        for row in rows
                        if (row["scene"], row["method"]) == (scene, method.name)
                        and row[error] is not None
                    )
                    if not points or (line == 1 and _left_out(method.name)):
                        continue
                    k, value = zip(*points, strict=True)
                    options: dict[str, Any] = {
                        "color": method.colour,
                        "linestyle": method.style or "none",
                        "marker": method.marker,
                        # Open squares and large crosses do not hide the markers under them.
                        "markersize": {"s": 6, "x": 5, "+": 7}.get(method.marker, 3),
                        "markerfacecolor": "none" if method.marker == "s" else method.colour,
                        "label": method.label,
                    }
                    axes.plot(k, value, **options)
                axes.set_xscale("log", base=2)
                axes.set_yscale("log")
                ticks = sorted({row["observations"] for row in rows})
                labels = ticks if len(ticks) < 5 else ticks[::2]
                axes.set_xticks(labels, [str(k) for k in labels])
                axes.xaxis.set_minor_locator(NullLocator())
                axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                axes.yaxis.set_major_formatter("{x:g}")
                axes.yaxis.set_minor_locator(NullLocator())
            panels[0, column].set_title(title)
            panels[1, column].set_xlabel("patterns K")
        judged, few = rows[0]["size"] ** 2 // 4, rows[0]["size"] ** 2 // 128
        panels[0, 0].set_ylabel(f"RMSE (clip levels)\n{judged:,} camera pixels")
        panels[1, 0].set_ylabel(f"RMSE (clip levels)\n{few} of them")
        handles: dict[str, Any] = {}
        for axes in panels[:, 0]:
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        drawing.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3)
        save(drawing, out, "fig6", ("png", "svg"))


def _left_out(name: str) -> bool:
    """Whether the lower panels, of the iterated solvers and their minima, leave a method out."""
    return not name.startswith(("admm", "saturation-admm")) or name.endswith("multi-scale")


FIG6 = Experiment("fig6", cases, measure, _draw, parameters)
