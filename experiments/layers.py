"""Surfaces behind a curtain, behind dusty glass and in a mirror: T against structured light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.harness import Experiment, Measured, Row, all_rows, means
from experiments.shape import NOISE, Case, codes, exposure_of
from lightmatrix.estimators.estimate import estimate
from lightmatrix.geometry.rig_geometry import RigGeometry, binned_matrix
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.shape.decode import decode
from lightmatrix.shape.layers import layers
from lightmatrix.shape.triangulation import triangulate
from lightmatrix.simulation import library
from lightmatrix.simulation.scenes import MIRROR_PLACE, MIRROR_TURN, Part, Scene, scene
from lightmatrix.simulation.shapes import Mesh, turn
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth, trace_surface
from lightmatrix.uses.separation import camera_pixels

Array = NDArray[np.floating]
# Each surface of a pixel that counts holds this share of its light.
_LEAST = 0.15
# A depth is right within this share of the distance, and a mirrored place within a projector pixel.
_RIGHT = 0.01
# Paths a pixel of the scenes: their rows of T have few entries.
_SAMPLES = 4096
_KEY = ("scene", "size", "method", "photographs")
_METRICS = ("both", "first", "second", "wrong")


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run measures the curtain once."""
    scenes = ("curtain",) if quick else ("curtain", "glass", "mirror")
    for side in (64,) if quick else (64, 128):
        yield from (Case(name, side, seed) for name in scenes for seed in range(1 if quick else 3))


@dataclass(frozen=True, eq=False)
class TwoSurfaces:
    """What P pixels see: depths (P, n) of the first and second surface, and which pixels count.

    `surfaces` (P, n) are all depths that are no error. `place` (P, 2) is what lights the second
    surface where that is mirrored, else None.
    """

    first: Array
    second: Array
    surfaces: Array
    both: NDArray[np.bool_]
    place: Array | None = None

    def judged(self, depth: Array, mirrored: NDArray[np.bool_], place: Array) -> Row:
        """Shares in per cent: pixels with both surfaces right, with each, and wrong depths."""
        first, second = (_near(depth, true).any(axis=1) for true in (self.first, self.second))
        if self.place is not None:
            apart = np.abs(place - self.place[:, None]).max(axis=-1)
            second = ((apart <= 1) & mirrored).any(axis=1)
        kept = np.isfinite(depth)
        wrong = kept & ~_near(depth, self.surfaces)
        shares = (np.asarray(first & second), np.asarray(first), np.asarray(second))
        values = [100 * float(each[self.both].mean()) for each in shares]
        values.append(100 * float(wrong.sum() / max(1, kept.sum())))
        return dict(zip(_METRICS, values, strict=True))


def _near(depth: Array, surfaces: Array) -> NDArray[np.bool_]:
    """Whether depths (P, n) are right for one of the surfaces (P, m) of their pixel."""
    apart = np.abs(depth[:, :, None] - surfaces[:, None]) - _RIGHT * surfaces[:, None]
    return np.asarray(np.fmin.reduce(apart, axis=-1) <= 0)


def two_surfaces(truth: Truth) -> TwoSurfaces:
    """The exact surfaces of one of the three scenes."""
    built, rig = scene(str(truth.metadata["scene"])), truth.geometry
    assert rig is not None
    pixels = np.repeat(np.arange(truth.matrix.shape[0]), np.diff(truth.matrix.indptr))
    total = np.asarray(truth.matrix.sum(axis=1), float).ravel()
    if built.name == "mirror":
        return _mirrored(truth, built, rig, pixels, total)
    *behind, before = built.parts
    first = _within(replace(built, parts=(before,)), rig, 8)
    second = _within(replace(built, parts=tuple(behind)), rig, 4)
    # Direct light belongs to the surface that it comes nearer to.
    lit = camera_pixels(truth.projector_shape)[truth.matrix.indices, ::-1]
    depth = rig.depth(rig.triangulate(camera_pixels(rig.camera_shape)[pixels, ::-1], lit))
    middle = [np.fmax.reduce(each, axis=1)[pixels] for each in (first, second)]
    is_first = np.abs(depth - middle[0]) < np.abs(depth - middle[1])
    shares = [
        np.bincount(pixels, truth.direct_data * part, len(total)) / total
        for part in (is_first, ~is_first)
    ]
    both = np.isfinite(first).any(axis=1) & (np.min(shares, axis=0) >= _LEAST)
    # A thread or a grain that a neighbouring pixel sees is no error: both are much finer than 1 %.
    grid = np.pad(first.reshape(*rig.camera_shape, -1), ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows, cols = rig.camera_shape
    around = [grid[i : i + rows, j : j + cols] for i, j in np.ndindex(3, 3)]
    near = np.concatenate([each.reshape(len(first), -1) for each in around], axis=1)
    return TwoSurfaces(first, second, np.concatenate([near, second], axis=1), both)


def _mirrored(
    truth: Truth, built: Scene, rig: RigGeometry, pixels: NDArray[np.int64], total: Array
) -> TwoSurfaces:
    """The dust on the mirror first, then what the mirror shows, whose place is exact."""
    first = _within(built, rig, 4)
    plate = _within(replace(built, parts=built.parts[1:2]), rig, 4)
    normal = turn("y", MIRROR_TURN)[:, 2]
    flip = np.eye(3) - 2 * np.outer(normal, normal)
    shift = 2 * normal * (normal @ MIRROR_PLACE)
    images = [
        Part(Mesh(part.mesh.vertices @ flip.T + shift, part.mesh.faces), part.material)
        for part in (built.parts[0], *built.parts[2:])
    ]
    depth = trace_surface(replace(built, parts=tuple(images)), rig)[0].ravel()
    rays = rig.camera_rays(camera_pixels(rig.camera_shape)[:, ::-1])
    seen = (rig.camera_centre + depth[:, None] * rays) @ flip.T + shift
    place = rig.project_projector(seen)[:, ::-1]
    apart = np.abs(camera_pixels(truth.projector_shape)[truth.matrix.indices] - place[pixels])
    near = (truth.matrix.data - truth.direct_data) * (apart.max(axis=1) <= 2)
    shares = [np.bincount(pixels, part, len(total)) / total for part in (truth.direct_data, near)]
    on_plate = (np.abs(plate - first) < 1e-6).all(axis=1)
    both = on_plate & (np.min(shares, axis=0) >= _LEAST)
    return TwoSurfaces(first, np.full_like(first, np.nan), first, both, place)


def _within(built: Scene, rig: RigGeometry, side: int) -> Array:
    """Exact depths (P, side^2) of a scene within each camera pixel."""
    rows, cols = rig.camera_shape
    matrix = binned_matrix(rig.camera_matrix, (1 / side, 1 / side))
    finer = replace(rig, camera_matrix=matrix, camera_shape=(rows * side, cols * side))
    blocks = trace_surface(built, finer)[0].reshape(rows, side, cols, side).swapaxes(1, 2)
    return blocks.reshape(rows * cols, -1)


def measure(case: Case) -> Measured:
    """The rows of all methods; a code tells one place a pixel."""
    truth = library.truth(case.scene, (case.side, case.side), samples=_SAMPLES)
    assert truth.geometry is not None
    exact, exposure, count = two_surfaces(truth), exposure_of(truth, case), case.side**2
    random = BernoulliPatterns(truth.projector_shape, case.patterns, seed=case.seed)
    settings = {"exposure": exposure, "noise": NOISE, "seed": case.seed}
    found = layers(estimate(simulate(truth, random, **settings)), truth.geometry)  # type: ignore[arg-type]
    places = found.place.reshape(count, 3, 2)
    judged = exact.judged(found.depth.reshape(count, 3), found.mirrored.reshape(count, 3), places)
    results = {("T", case.patterns): judged}
    for name, code in codes(truth.projector_shape).items():
        matches = decode(simulate(truth, code, **settings), check=False)  # type: ignore[arg-type]
        shape = triangulate(matches, truth.geometry)
        place = matches.place.reshape(count, 1, 2).astype(np.float64)
        off_line = shape.from_line.reshape(count, 1) > 1.5
        results[name, code.count] = exact.judged(shape.depth.reshape(count, 1), off_line, place)
    about = {"scene": case.scene, "size": case.side, "seed": case.seed}
    return Measured(
        [{**about, "method": name, "photographs": k, **row} for (name, k), row in results.items()]
    )


def _summary(rows: list[Row]) -> list[Row]:
    return means(rows, _KEY, _METRICS)


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """Bars of the pixels with both surfaces right, by scene and method."""
    rows = _summary(all_rows(results))
    places = list(dict.fromkeys(f"{row['scene']}\n{row['size']}" for row in rows))
    with figure(max(6.5, 1.2 * len(places)), 3.4) as drawing:
        axes = drawing.subplots()
        for number, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
            own = [row for row in rows if row["method"] == method]
            at = [places.index(f"{row['scene']}\n{row['size']}") + 0.2 * number for row in own]
            axes.bar(at, [row["both"] for row in own], 0.2, color=COLOURS[number], label=method)
        axes.set_ylabel("both surfaces right (% of pixels)")
        axes.set_xticks(np.arange(len(places)) + 0.3, places)
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4)
        save(drawing, out, "layers", ("png", "svg"))


LAYERS_EXPERIMENT = Experiment("layers", cases, measure, _draw, summary=_summary)
