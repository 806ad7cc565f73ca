"""Fig. 5: the scenes; Figs. 1 and 2: what clipping does to a capture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import Experiment, Measured
from experiments.measured_scene import LETTERED, SCENES
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import MissingExtraError
from lightmatrix.judgement.metrics import diffuse_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.pictures.maps import display
from lightmatrix.pictures.style import figure, mark_clipped, panel, save
from lightmatrix.simulation import library
from lightmatrix.simulation.renderer import load_mitsuba, mitsuba_scene
from lightmatrix.simulation.scenes import scene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.thinning import ascending_in_rows
from lightmatrix.simulation.truth import Truth

# The table states the clipped share of samples under random patterns at these exposures.
EXPOSURES = (0.1, 0.2, 0.4, 0.8, 1.0)
FORMATS = ("png", "svg")


@dataclass(frozen=True)
class Case:
    """A bundled scene."""

    scene: str
    # Pixels per side of its photograph.
    size: int

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.scene}-{self.size}"


def cases(quick: bool) -> Iterator[Case]:
    """All bundled scenes."""
    for name in library.BUNDLED:
        yield Case(name, 128 if quick else 512)


def parameters(quick: bool) -> dict[str, Any]:
    """The exposures of the clipped shares."""
    return {"exposures": EXPOSURES}


def measure(case: Case) -> Measured:
    """A scene's row of the table, and its photograph if the figure shows it."""
    truth = library.truth(case.scene)
    photos = {"photograph": _photograph(case, truth)} if case.scene in SCENES else {}
    return Measured([statistics(case.scene, truth)], photos)


def _photograph(case: Case, truth: Truth) -> NDArray[np.float32]:
    try:
        mi: Any = load_mitsuba()
    except MissingExtraError:
        return _white(truth)
    shape = (case.size, case.size)
    image = mi.render(mitsuba_scene(mi, scene(case.scene), shape, shape), spp=256, seed=0)
    return np.asarray(image, np.float32).mean(axis=2)


def statistics(name: str, truth: Truth) -> dict[str, Any]:
    """One row of the table of scenes."""
    return {
        "scene": name,
        "size": list(truth.camera_shape),
        "direct_share": direct_share(truth),
        "entries_90": float(np.median(entries_for_energy(truth, 0.90))),
        "entries_99": float(np.median(entries_for_energy(truth, 0.99))),
        "diffuse_rows": float(diffuse_rows(truth.matrix, truth.projector_shape).mean()),
        "clipped_share": clipped_share(truth, EXPOSURES),
    }


def _white(truth: Truth) -> NDArray[np.float32]:
    return np.asarray(truth.matrix.sum(axis=1), np.float32).reshape(truth.camera_shape)


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    truth = library.truth("l_objects")
    _draw_scenes(out, {case.scene: measured.arrays for case, measured in results})
    _draw_capture(out, truth)
    _draw_formulation(out, truth)


def _draw_scenes(out: Path, images: dict[str, Mapping[str, NDArray[Any]]]) -> None:
    with figure(6.6, 2.4) as drawing:
        for axes, (name, title) in zip(drawing.subplots(1, 3), LETTERED.items(), strict=True):
            image = images[name]["photograph"]
            panel(axes, display(image, float(1.1 * np.quantile(image, 0.97))))
            axes.set_xlabel(title)
        save(drawing, out, "fig5", FORMATS)


def _draw_capture(out: Path, truth: Truth) -> None:
    """Draw patterns and what a clipping camera sees under them, clipped pixels in red (Fig. 1)."""
    patterns = BernoulliPatterns(truth.projector_shape, 3, seed=1)
    light = irradiance(truth.matrix, patterns)
    with figure(6.4, 6.6) as drawing:
        panels = drawing.subplots(3, 3)
        for k, (left, middle, right) in enumerate(panels):
            frame = light[:, k].reshape(truth.camera_shape)
            panel(left, patterns.images(k, k + 1)[0], "projection pattern" if k == 0 else "")
            panel(middle, display(frame, 1.0), "camera image" if k == 0 else "")
            red = mark_clipped(display(frame, 1.0), frame >= 1)
            share = 100 * float((frame >= 1).mean())
            panel(right, red, "clipped pixels in red" if k == 0 else "")
            right.set_xlabel(f"{share:.0f} % clipped")
        save(drawing, out, "fig1", FORMATS)


def _draw_formulation(out: Path, truth: Truth) -> None:
    """Draw C = C_Y(T P') as matrices, for a row of camera pixels in the middle (Fig. 2)."""
    patterns = BernoulliPatterns(truth.projector_shape, 24, seed=1)
    side = truth.camera_shape[1]
    rows = (side // 2) * side + np.arange(side)
    matrix = truth.matrix[rows]
    frames = Sensor(bits=8).expose(irradiance(matrix, patterns)) / 255
    columns = np.sort(np.unique(matrix.indices[matrix.data > 0.1]))[:64]
    with figure(6.8, 2.9) as drawing:
        left, middle, right = drawing.subplots(1, 3, width_ratios=[24, 64, 24])
        panel(left, mark_clipped(display(frames, 1.0), frames >= 1), r"$C$, clipped in red")
        part = matrix[:, columns].toarray()
        panel(middle, display(part, float(part.max())), "$T$", aspect="auto")
        lit = patterns.columns(columns).T
        panel(right, lit, "$P'$")
        left.set_ylabel("64 camera pixels")
        left.set_xlabel("24 patterns")
        shown, pixels = len(columns), matrix.shape[1]
        middle.set_ylabel("64 camera pixels")
        middle.set_xlabel(f"{shown} of {pixels:,} projector pixels, the others not shown")
        right.set_ylabel(f"the same {shown} projector pixels")
        right.set_xlabel("24 patterns")
        drawing.suptitle(r"$C = C_Y(T P')$: a clipped sample is only a lower bound", fontsize=9)
        save(drawing, out, "fig2", FORMATS)


FIG5 = Experiment("fig5", cases, measure, _draw, parameters)


def direct_share(truth: Truth) -> float:
    """Share of all light that met one surface only."""
    return float(truth.direct_data.sum(dtype=np.float64) / truth.matrix.sum())


def entries_for_energy(truth: Truth, share: float) -> NDArray[np.int64]:
    """For each row, how many of its largest entries hold the given share of its sum, (M,) int."""
    matrix = truth.matrix
    lengths = np.diff(matrix.indptr)
    row = np.repeat(np.arange(len(lengths)), lengths)
    sums = np.cumsum(ascending_in_rows(matrix), dtype=np.float64)
    ends = np.concatenate([[0.0], sums])[matrix.indptr]
    # Count the smallest entries that together hold less than the rest of the share.
    total = np.diff(ends)
    spare = sums - ends[row] <= (total - share * total)[row]
    return np.where(total > 0, lengths - np.bincount(row[spare], minlength=len(lengths)), 0)


def clipped_share(truth: Truth, exposures: tuple[float, ...], count: int = 32) -> list[float]:
    """Share of samples that clip under Bernoulli(0.5) patterns, for each exposure."""
    light = irradiance(truth.matrix, BernoulliPatterns(truth.projector_shape, count))
    return [float((exposure * light >= 1).mean()) for exposure in exposures]
