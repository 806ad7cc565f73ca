"""Shape from T against structured light: how much of each scene is right, and how much is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import Experiment, Measured, Row, all_rows, means
from lightmatrix.errors import InputError
from lightmatrix.estimators.estimate import estimate
from lightmatrix.geometry.rig_geometry import RigGeometry, binned_matrix
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import (
    NOTHING,
    GrayCodePatterns,
    MicroPhasePatterns,
    PhasePatterns,
    StripePatterns,
)
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.planning.plan import plan
from lightmatrix.shape.decode import decode
from lightmatrix.shape.shape import Shape
from lightmatrix.shape.triangulation import triangulate
from lightmatrix.simulation import library, scenes
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth, trace_surface

SEEDS = (0, 1, 2)
NOISE = 0.003
# Photographs of micro phase shifts, and their mean period in projector pixels: as many as Gray code
# with inverses has at 128 x 128, and the better one of 8 and 16 at 64 x 64.
_MICRO_COUNT, _MICRO_PERIOD = 28, 8.0
# A depth is right within this share of the distance of a surface in its pixel.
_RIGHT = 0.01
# Depths of the scene are taken on a grid of this side in each camera pixel.
_WITHIN = 4
# A camera pixel is lit if its direct light exceeds this share of a bright one's (the 0.9 quantile),
# and the projector has a pixel for its centre.
_LIT, _BRIGHT_QUANTILE = 0.02, 0.9
_KEY = ("scene", "size", "rig", "method", "photographs")
_METRICS = {
    "right": "right (% of lit pixels)",
    "wrong": "wrong (% of depths)",
    "rms": "RMS (1/1000 unit)",
}


@dataclass(frozen=True)
class Case:
    """One scene under one rig: its exposure relative to the planned one, its projector's blur."""

    scene: str
    side: int
    seed: int
    # Random patterns for T.
    patterns: int = 32
    exposed: float = 1.0
    blur: float = 0.0

    @property
    def name(self) -> str:
        """A file name."""
        rig = f"k{self.patterns}-x{self.exposed:g}-b{self.blur:g}"
        return f"{self.scene}-{self.side}-{rig}-s{self.seed}"

    @property
    def rig(self) -> str:
        """What is unusual about the rig, in words."""
        if self.exposed != 1:
            return f"exposed {self.exposed:g} x"
        return f"blur {self.blur:g}" if self.blur else "usual"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run measures two scenes once at 64 x 64."""
    if quick:
        yield from (Case(scene, 64, 0) for scene in ("corner", "l_objects"))
        return
    for seed in SEEDS:
        yield Case("gripper", 64, seed)
        yield Case("corner", 64, seed, patterns=16)
        yield Case("l_objects", 64, seed, exposed=4)
        yield Case("corner", 64, seed, blur=1)
        for scene in ("corner", "l_objects", "metal"):
            yield Case(scene, 128, seed)


def measure(case: Case) -> Measured:
    """The rows of all methods; each passes the same test of its epipolar lines."""
    truth = library.truth(case.scene, (case.side, case.side))
    assert truth.geometry is not None
    reference = Reference.of(truth)
    exposure = exposure_of(truth, case)
    settings: dict[str, Any] = {"noise": NOISE, "seed": case.seed, "blur": case.blur}
    random = BernoulliPatterns(truth.projector_shape, case.patterns, seed=case.seed)
    # What the checks say of these captures is measured elsewhere.
    capture = simulate(truth, random, exposure=exposure, **settings)
    transport = estimate(capture, check=False)
    shapes = {
        ("T", case.patterns): triangulate(transport, truth.geometry),
        ("T, p >= 0.99", case.patterns): triangulate(
            transport, truth.geometry, least_probability=0.99
        ),
    }
    for name, code in codes(truth.projector_shape).items():
        capture = simulate(truth, code, exposure=exposure, **settings)
        matches = decode(capture, check=False)
        shapes[name, code.count] = triangulate(matches, truth.geometry)
    return Measured(
        [
            {
                "scene": case.scene,
                "size": case.side,
                "rig": case.rig,
                "method": method,
                "photographs": count,
                "seed": case.seed,
                **reference.judged(shape),
            }
            for (method, count), shape in shapes.items()
        ]
    )


def codes(shape: tuple[int, int]) -> dict[str, PatternSet]:
    """The codes by name; inverses and shifts need no white and black patterns."""
    gray = GrayCodePatterns(shape, inverse=True)
    return {
        "Gray, inverse": _without_uniform(gray),
        "Gray, 4 shifts": PhasePatterns(shape, inverse=True),
        "micro phase shifts": MicroPhasePatterns(shape, _MICRO_COUNT, _MICRO_PERIOD),
    }


def _without_uniform(patterns: StripePatterns) -> PatternSet:
    return patterns.subset(np.flatnonzero(patterns.stripes.axes != NOTHING))


def exposure_of(truth: Truth, case: Case) -> float | str:
    """The planned exposure, times that of the case."""
    exposure = plan(truth, frames=case.patterns, noise=NOISE).exposure
    if case.exposed == 1:
        return exposure
    if isinstance(exposure, str):
        raise InputError(
            f"the planned exposures of {case.scene} are several: {exposure}",
            hint="expose a scene longer that is planned with one",
        )
    return exposure * case.exposed


def depths_within(truth: Truth, side: int) -> NDArray[np.float64]:
    """Exact depths on a grid of `side` x `side` points in each pixel, (rows, cols, side^2).

    A pixel at an edge sees several surfaces; the depth of its centre belongs to one of them.
    """
    geometry = truth.geometry
    assert geometry is not None
    rows, cols = geometry.camera_shape
    finer = replace(
        geometry,
        camera_matrix=binned_matrix(geometry.camera_matrix, (1 / side, 1 / side)),
        camera_shape=(rows * side, cols * side),
    )
    fine = trace_surface(scenes.scene(str(truth.metadata["scene"])), finer)[0]
    return fine.reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, side * side)


@dataclass(frozen=True, eq=False)
class Reference:
    """The exact shape of a scene: depths (rows, cols, n) in each pixel, which pixels are lit."""

    depths: NDArray[np.float64]
    lit: NDArray[np.bool_]

    @classmethod
    def of(cls, truth: Truth) -> Reference:
        """The reference of a rendered scene."""
        geometry = truth.geometry
        assert geometry is not None
        depths = depths_within(truth, _WITHIN)
        direct = np.asarray(truth.direct.sum(axis=1), float).reshape(truth.camera_shape)
        bright = direct > _LIT * np.quantile(direct, _BRIGHT_QUANTILE)
        return cls(depths, bright & _on_projector(truth, geometry))

    def judged(self, shape: Shape) -> Row:
        """Right and wrong shares in per cent, and the RMS of right depths in 1/1000 of the unit."""
        apart = np.abs(shape.depth[..., None] - self.depths)
        distance = np.fmin.reduce(apart, axis=-1)
        right = np.fmin.reduce(apart - _RIGHT * self.depths, axis=-1) <= 0
        kept, found = shape.kept, shape.kept & right & self.lit
        rms = float(np.sqrt(np.mean(distance[found] ** 2))) if found.any() else float("nan")
        return {
            "right": 100 * float(found.sum() / self.lit.sum()),
            "wrong": 100 * float((kept & ~right).sum() / max(1, kept.sum())),
            "rms": 1000 * rms,
        }


def _on_projector(truth: Truth, geometry: RigGeometry) -> NDArray[np.bool_]:
    """Whether the projector has a pixel for the centre of each camera pixel."""
    rows, cols = geometry.camera_shape
    row, col = np.indices((rows, cols), float)
    assert truth.depth is not None
    rays = geometry.camera_rays(np.column_stack([col.ravel(), row.ravel()]))
    points = geometry.camera_centre + truth.depth.ravel()[:, None] * rays
    place = geometry.project_projector(points)[:, ::-1]
    size = np.array(geometry.projector_shape)
    # Comparisons with NaN, where a pixel sees nothing, are False.
    inside = (place >= -0.5) & (place <= size - 0.5)
    return np.asarray(inside.all(axis=1).reshape(rows, cols))


def _summary(rows: list[Row]) -> list[Row]:
    """The means over the seeds."""
    return means(rows, _KEY, tuple(_METRICS))


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """One panel for each metric: bars by scene and rig, and by method."""
    means = _summary(all_rows(results))
    places = list(dict.fromkeys(_place(row, means) for row in means))
    methods = list(dict.fromkeys(row["method"] for row in means))
    width = 0.8 / len(methods)
    with figure(2.2 + 1.3 * len(places), 6.5) as drawing:
        panels = drawing.subplots(len(_METRICS), 1, sharex=True)
        for axes, (metric, label) in zip(panels, _METRICS.items(), strict=True):
            for number, method in enumerate(methods):
                own = [row for row in means if row["method"] == method]
                offset = (number - (len(methods) - 1) / 2) * width
                at = [places.index(_place(row, means)) + offset for row in own]
                # Nearly all pixels are right: what counts is the rest, on a logarithmic scale.
                values = [100 - row[metric] if metric == "right" else row[metric] for row in own]
                axes.bar(at, values, width, color=COLOURS[number], label=method)
            axes.set_ylabel("not right (% of lit pixels)" if metric == "right" else label)
            axes.set_yscale("linear" if metric == "rms" else "log")
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(methods))
        panels[-1].set_xticks(range(len(places)), places)
        save(drawing, out, "shape", ("png", "svg"))


def _place(row: Row, means: list[Row]) -> str:
    """Scene, size and rig of a row, in two lines."""
    same = [other for other in means if all(other[name] == row[name] for name in _KEY[:3])]
    count = next(other["photographs"] for other in same if other["method"] == "T")
    rig = "" if row["rig"] == "usual" else f", {row['rig']}"
    return f"{row['scene']} {row['size']}\nT from {count}{rig}"


SHAPE_EXPERIMENT = Experiment("shape", cases, measure, _draw, summary=_summary)
