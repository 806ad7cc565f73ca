"""Relighting with a logo that no pattern resembles (the paper's Section 4.3, Fig. 7).

All camera pixels, 256 Bernoulli patterns, the exposure and camera of Fig. 6. Each method's T is
multiplied with the logo; under the image stands its difference from the true one. Two more columns
show the coherent estimate from 64 frames: of the same kind, and with some coarse patterns and
half of the frames shorter, as `lightmatrix plan` advises for highlights.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lightmatrix.capture.capture import Capture
from lightmatrix.experiments.fig6 import SCENES, captured, measured_scene
from lightmatrix.experiments.measured_scene import Exposures
from lightmatrix.experiments.methods import BY_NAME, REGULARIZATION
from lightmatrix.files.running import RunningFolder
from lightmatrix.patterns.mix import MixedPatterns, default_mix
from lightmatrix.pictures.style import display, figure, panel, save

OBSERVATIONS = 256
EXPOSURES: Exposures = ((1.0, 0.5), (0.25, 0.25), (0.0625, 0.25))
METHODS = (
    "romp-multi-scale",
    "admm-multi-scale",
    "saturation-admm",
    "saturation-admm-multi-scale",
    "coherent",
)
# Frames of the last columns.
FEW = 64
# Errors are drawn up to this share of the image's white.
ERROR_RANGE = 0.25
# Rows of the letters L and M, a pixel each 1/16 of the projector.
LOGO = (
    "................",
    "................",
    "..##............",
    "..##....##...##.",
    "..##....###.###.",
    "..##....#######.",
    "..##....##.#.##.",
    "..##....##...##.",
    "..##....##...##.",
    "..##....##...##.",
    "..##.........##.",
    "..#######....##.",
    "..#######.......",
    "................",
    ".##############.",
    "................",
)


@dataclass(frozen=True)
class Column:
    """A method and the frames it is given: fine patterns at one exposure, or both mixed."""

    method: str
    observations: int
    mixed: bool = False

    @property
    def label(self) -> str:
        """What stands above the images."""
        name = BY_NAME[self.method].label.replace(" (", "\n(").replace(" multi", "\nmulti")
        frames = f"K = {self.observations}"
        return f"{name}\n{frames}, mixed" if self.mixed else f"{name}\n{frames}"

    def capture(self, scene: str, size: int) -> Capture:
        """Its frames."""
        if not self.mixed:
            return captured(scene, size, self.observations)
        shape = (size, size)
        mix = default_mix(shape, self.observations)
        patterns = MixedPatterns(shape, self.observations, mix)
        return measured_scene(scene, size).capture(patterns, 0, EXPOSURES)


def run(
    out: Path,
    *,
    quick: bool = False,
    progress: Callable[[int, int], None] | None = None,
    kept: RunningFolder | None = None,
) -> dict[str, Any]:
    """Relight all scenes with all methods and write fig7.png, .svg, .csv and .json.

    Parameters
    ----------
    out : Path
        An existing folder.
    quick : bool
        64 x 64 and 64 patterns.
    kept : RunningFolder, optional
        Where finished images are kept, for a run that goes on.
    """
    size, count = (64, 64) if quick else (128, OBSERVATIONS)
    columns = [Column(name, count) for name in METHODS]
    columns += [Column("coherent", FEW)] * (not quick) + [Column("coherent", FEW, mixed=True)]
    report = progress or (lambda done, total: None)
    images: dict[tuple[str, Column], NDArray[np.float32]] = {}
    rows = []
    for scene in SCENES:
        truth = measured_scene(scene, size)
        expected = truth.known.relight(logo(size))
        for column in columns:
            image, seconds = _relit(scene, size, column, kept)
            images[scene, column] = image
            rows.append(
                {
                    "scene": scene,
                    **asdict(column),
                    **quality(image, expected),
                    "seconds": round(seconds, 1),
                }
            )
            report(len(rows), len(SCENES) * len(columns))
    result: dict[str, Any] = {
        "parameters": {
            "size": size,
            "lambda": REGULARIZATION,
            "seed": 0,
            "mixed exposures and shares": EXPOSURES,
        },
        "rows": rows,
    }
    (out / "fig7.json").write_text(json.dumps(result, indent=1) + "\n")
    with open(out / "fig7.csv", "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    _draw(out, size, columns, images, rows)
    return result


def logo(size: int) -> NDArray[np.float32]:
    """A binary image of letters, (size, size), 1 where lit."""
    small = np.array([[mark == "#" for mark in line] for line in LOGO], np.float32)
    place = np.arange(size) * len(LOGO) // size
    return small[np.ix_(place, place)]


def quality(image: NDArray[Any], expected: NDArray[Any]) -> dict[str, float]:
    """Peak signal-to-noise ratios in dB, structural similarity and relative L2 error.

    The peak is the 99th percentile of the expected image, so that a few highlights do not set the
    scale. `psnr` and `relative_error` count them as they are; for `psnr_shown` and `ssim` (Wang et
    al. 2004, windows of 7 x 7 pixels, uniform) both images are clipped at the peak, as a screen
    shows them.
    """
    peak = max(float(np.quantile(expected, 0.99)), 1e-12)
    error = np.asarray(image, np.float64) - expected
    mean_square = max(float(np.mean(error**2)), 1e-20)
    a, b = (np.clip(np.asarray(part, np.float64) / peak, 0, 1) for part in (image, expected))
    mean_a, mean_b = uniform_filter(a, 7), uniform_filter(b, 7)
    spread_a = uniform_filter(a * a, 7) - mean_a**2
    spread_b = uniform_filter(b * b, 7) - mean_b**2
    common = uniform_filter(a * b, 7) - mean_a * mean_b
    low, high = 0.01**2, 0.03**2
    similarity = (2 * mean_a * mean_b + low) * (2 * common + high)
    similarity /= (mean_a**2 + mean_b**2 + low) * (spread_a + spread_b + high)
    norm = max(float(np.linalg.norm(expected)), 1e-12)
    shown = max(float(np.mean((a - b) ** 2)), 1e-20)
    return {
        "psnr": float(20 * np.log10(peak) - 10 * np.log10(mean_square)),
        "psnr_shown": float(-10 * np.log10(shown)),
        "ssim": float(similarity.mean()),
        "relative_error": float(np.linalg.norm(error) / norm),
    }


def _relit(
    scene: str, size: int, column: Column, kept: RunningFolder | None
) -> tuple[NDArray[np.float32], float]:
    name = f"{scene}-{size}-{column.method}-k{column.observations}{'-mixed' * column.mixed}.npz"
    if kept is not None and kept.has(name):
        with np.load(kept.file(name)) as found:
            return found["image"], float(found["seconds"])
    measured = measured_scene(scene, size)
    capture = column.capture(scene, size)
    started = time.perf_counter()
    estimate = BY_NAME[column.method].estimate(capture, 1 / measured.exposure)
    seconds = time.perf_counter() - started
    image = estimate.relight(logo(size))
    if kept is not None:
        with kept.keep(name) as part:
            np.savez(part, image=image, seconds=seconds)
    return image, seconds


def _draw(
    out: Path,
    size: int,
    columns: list[Column],
    images: dict[tuple[str, Column], NDArray[np.float32]],
    rows: list[dict[str, Any]],
) -> None:
    """Two lines a scene: relit images, and their errors under them."""
    measures = {
        (row["scene"], Column(row["method"], row["observations"], row["mixed"])): row
        for row in rows
    }
    width = len(columns) + 1
    with figure(1.25 * width, 2.85 * len(SCENES)) as drawing:
        panels = drawing.subplots(2 * len(SCENES), width)
        for line, (scene, title) in enumerate(SCENES.items()):
            expected = measured_scene(scene, size).known.relight(logo(size))
            white = float(np.quantile(expected, 0.98))
            upper, lower = panels[2 * line], panels[2 * line + 1]
            panel(upper[0], display(expected, white))
            if line == 0:
                upper[0].set_title("truth", fontsize=7)
            upper[0].set_ylabel(title)
            panel(lower[0], logo(size))
            lower[0].set_xlabel("projected", fontsize=7)
            for place, column in enumerate(columns, start=1):
                image = images[scene, column]
                panel(upper[place], display(image, white))
                if line == 0:
                    upper[place].set_title(column.label, fontsize=7)
                limits: dict[str, Any] = {"vmin": -ERROR_RANGE, "vmax": ERROR_RANGE}
                shown = panel(lower[place], (image - expected) / white, cmap="RdBu_r", **limits)
                made = measures[scene, column]
                text = f"{made['psnr_shown']:.1f} dB, {made['ssim']:.2f}"
                lower[place].set_xlabel(text, fontsize=7)
        drawing.colorbar(
            shown,
            ax=panels.ravel().tolist(),
            location="bottom",
            shrink=0.4,
            aspect=40,
            label="error / white (98th percentile of the truth); PSNR, SSIM as on a screen",
        )
        save(drawing, out, "fig7", ("png", "svg"))
