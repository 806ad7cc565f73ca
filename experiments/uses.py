"""What T is for: how well the uses of an estimate work on the bundled scenes, with their peers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.harness import Experiment, Measured, Row, all_rows, means
from experiments.uses_compensation import compensation_rows, inverse_light_rows
from experiments.uses_separation import separation_rows
from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.planning.plan import plan
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport

SCENES = ("l_objects", "gripper", "metal", "corner")
SIDES = (64, 128)
SEEDS = (0, 1, 2)
PATTERNS, NOISE = 32, 0.003
# Each use judges an estimate by the truth of a scene, with a seed for photographs of its own: rows
# with use, scene, size, method, metric, value.
USES: tuple[Callable[[LightTransport, Truth, str, int], list[Row]], ...] = (
    lambda transport, truth, scene, _: compensation_rows(transport, truth, scene),
    lambda transport, truth, scene, _: inverse_light_rows(transport, truth, scene),
    separation_rows,
)
# The metrics that the figure shows, with the title of their panels and the label of their axis.
_DRAWN = {
    ("compensate", "PSNR"): ("compensation", "PSNR of the photograph (dB)"),
    ("cancel global", "residue"): ("global light cancelled", "global / direct light"),
    ("separate", "global error"): ("separation", "error of the global image"),
    ("separate, blur 1", "global error"): (
        "separation, blur of 1 pixel",
        "error of the global image",
    ),
}
# The methods of the table, each with its words and its colour in the figure: ours are blue, what
# only a simulation knows is grey.
_METHODS = {
    "pixel gains": ("gain of each pixel", COLOURS[4]),
    "white pattern": ("under white", COLOURS[4]),
    "T, window 5 x 5": ("T, window of 5 x 5", COLOURS[4]),
    "Nayar, best square": ("Nayar et al., best square", COLOURS[1]),
    "estimate": ("T from 32 photographs", COLOURS[0]),
    "T, separated": ("T from 32 photographs", COLOURS[0]),
    "true T": ("true T", "0.6"),
}


@dataclass(frozen=True)
class Case:
    """One estimate of one scene."""

    scene: str
    side: int
    seed: int

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.scene}-{self.side}-s{self.seed}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run measures each scene once at 64 x 64."""
    for side in SIDES[:1] if quick else SIDES:
        for seed in SEEDS[:1] if quick else SEEDS:
            for scene in SCENES:
                yield Case(scene, side, seed)


def measure(case: Case) -> Measured:
    """The rows of all uses for one case."""
    truth = library.truth(case.scene, (case.side, case.side))
    exposure = plan(truth, frames=PATTERNS, noise=NOISE).exposure
    patterns = BernoulliPatterns(truth.projector_shape, PATTERNS, seed=case.seed)
    capture = simulate(truth, patterns, exposure=exposure, noise=NOISE, seed=case.seed)
    transport = estimate(capture)
    rows = [row for use in USES for row in use(transport, truth, case.scene, case.seed)]
    return Measured([{**row, "seed": case.seed} for row in rows])


def _summary(rows: list[Row]) -> list[Row]:
    """The means over the seeds."""
    return means(rows, ("use", "scene", "size", "method", "metric"), ("value",))


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """One panel for each metric and size: bars by scene and method."""
    rows = all_rows(results)
    sizes = sorted({row["size"] for row in rows})
    drawn = [metric for metric in _DRAWN if any(_of(row) == metric for row in rows)]
    with figure(3.4 * len(sizes) + 1.6, 1.9 * len(drawn)) as drawing:
        panels = drawing.subplots(len(drawn), len(sizes), squeeze=False, sharey="row")
        for line, metric in zip(panels, drawn, strict=True):
            title, label = _DRAWN[metric]
            for axes, size in zip(line, sizes, strict=True):
                own = [row for row in rows if _of(row) == metric and row["size"] == size]
                _draw_bars(axes, own)
                axes.set_title(f"{title}, {size} x {size}")
            line[0].set_ylabel(label)
            line[-1].legend(loc="upper left", bbox_to_anchor=(1, 1))
        save(drawing, out, "uses", ("png", "svg"))


def _of(row: Row) -> tuple[str, str]:
    return row["use"], row["metric"]


def _draw_bars(axes: Any, rows: list[Row]) -> None:
    """Means over the seeds, with a line from the least to the largest value."""
    scenes = [scene for scene in SCENES if any(row["scene"] == scene for row in rows)]
    methods = [name for name in _METHODS if any(row["method"] == name for row in rows)]
    width = 0.8 / max(1, len(methods))
    for number, method in enumerate(methods):
        words, colour = _METHODS[method]
        for place, scene in enumerate(scenes):
            values = [
                row["value"] for row in rows if (row["method"], row["scene"]) == (method, scene)
            ]
            x = place + (number - (len(methods) - 1) / 2) * width
            axes.bar(x, np.mean(values), width, color=colour, label=None if place else words)
            axes.vlines(x, min(values), max(values), color="black", linewidth=0.8)
    axes.set_xticks(range(len(scenes)), scenes)


USES_EXPERIMENT = Experiment("uses", cases, measure, _draw, summary=_summary)
