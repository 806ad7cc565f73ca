"""Fig. 7: relighting with a logo that no pattern resembles (the paper's Section 4.3).

All camera pixels are estimated from 256 Bernoulli patterns with the exposure and camera of Fig. 6.
Each method relights the scene with the logo; below stands the error of the image. Two more columns
show the coherent estimate from 64 frames: of the same kind, and with some coarse patterns and half
of the frames at shorter exposures, as `lightmatrix plan` advises for highlights.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from experiments.harness import Experiment, Measured
from experiments.measured_scene import (
    LETTERED,
    SCENES,
    THREE_EXPOSURES,
    bernoulli_capture,
    measured_scene,
)
from experiments.methods import BY_NAME, REGULARIZATION
from lightmatrix.capture.capture import Capture
from lightmatrix.patterns.mix import MixedPatterns, default_mix
from lightmatrix.pictures.maps import display
from lightmatrix.pictures.style import figure, panel, save

OBSERVATIONS = 256
METHODS = (
    "romp-multi-scale",
    "admm-multi-scale",
    "saturation-admm",
    "saturation-admm-multi-scale",
    "coherent",
)
# The last columns have this many frames.
FEW = 64
# The colours of errors end at this share of the image's white.
ERROR_RANGE = 0.25
# The letters L and M; each character is 1/16 of the projector.
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
class Case:
    """A method, and fine patterns at one exposure or mixed patterns at three."""

    scene: str
    method: str
    observations: int
    size: int
    mixed: bool = False

    @property
    def name(self) -> str:
        """A file name."""
        kind = "-mixed" * self.mixed
        return f"{self.scene}-{self.size}-{self.method}-k{self.observations}{kind}"

    @property
    def label(self) -> str:
        """The title of the column."""
        name = BY_NAME[self.method].label.replace(" (", "\n(").replace(" multi", "\nmulti")
        frames = f"K = {self.observations}"
        return f"{name}\n{frames}, mixed" if self.mixed else f"{name}\n{frames}"

    def capture(self) -> Capture:
        """The capture of this case."""
        if not self.mixed:
            return bernoulli_capture(self.scene, self.size, self.observations)
        shape = (self.size, self.size)
        mix = default_mix(shape, self.observations)
        patterns = MixedPatterns(shape, self.observations, mix)
        return measured_scene(self.scene, self.size).capture(patterns, 0, THREE_EXPOSURES)


def cases(quick: bool) -> Iterator[Case]:
    """All columns of every scene."""
    size, count = (64, 64) if quick else (128, OBSERVATIONS)
    for scene in SCENES:
        for method in METHODS:
            yield Case(scene, method, count, size)
        if not quick:
            yield Case(scene, "coherent", FEW, size)
        yield Case(scene, "coherent", FEW, size, mixed=True)


def parameters(quick: bool) -> dict[str, Any]:
    """The parameters of the table."""
    return {
        "size": 64 if quick else 128,
        "lambda": REGULARIZATION,
        "seed": 0,
        "mixed exposures and shares": THREE_EXPOSURES,
    }


def measure(case: Case) -> Measured:
    """The relit image of a case and its quality."""
    scene, capture = measured_scene(case.scene, case.size), case.capture()
    started = time.perf_counter()
    estimate = BY_NAME[case.method].estimate(capture, 1 / scene.exposure)
    seconds = time.perf_counter() - started
    image = estimate.relight(logo(case.size))
    row = {
        "scene": case.scene,
        "method": case.method,
        "observations": case.observations,
        "mixed": case.mixed,
        **quality(image, scene.known.relight(logo(case.size))),
        "seconds": round(seconds, 1),
    }
    return Measured([row], {"image": image})


def logo(size: int) -> NDArray[np.float32]:
    """A binary image of letters, (size, size), 1 where lit."""
    small = np.array([[mark == "#" for mark in line] for line in LOGO], np.float32)
    place = np.arange(size) * len(LOGO) // size
    return small[np.ix_(place, place)]


def quality(image: NDArray[Any], expected: NDArray[Any]) -> dict[str, float]:
    """Peak signal-to-noise ratios in dB, structural similarity and relative L2 error.

    The peak is the 99th percentile of the expected image, so that a few highlights do not set the
    scale. `psnr` and `relative_error` include highlights. For `psnr_shown` and `ssim` (Wang et al.
    2004, uniform windows of 7 x 7 pixels) both images are clipped at the peak, as on a screen.
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


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """Draw two lines of panels per scene: relit images, and their errors."""
    size, width = results[0][0].size, 1 + len(results) // len(SCENES)
    with figure(1.25 * width, 2.85 * len(SCENES)) as drawing:
        panels = drawing.subplots(2 * len(SCENES), width)
        for line, scene in enumerate(SCENES):
            expected = measured_scene(scene, size).known.relight(logo(size))
            white = float(np.quantile(expected, 0.98))
            upper, lower = panels[2 * line], panels[2 * line + 1]
            panel(upper[0], display(expected, white))
            if line == 0:
                upper[0].set_title("truth", fontsize=7)
            upper[0].set_ylabel(LETTERED[scene])
            panel(lower[0], logo(size))
            lower[0].set_xlabel("projected", fontsize=7)
            columns = [(case, measured) for case, measured in results if case.scene == scene]
            for place, (case, measured) in enumerate(columns, start=1):
                image, row = measured.arrays["image"], measured.rows[0]
                panel(upper[place], display(image, white))
                if line == 0:
                    upper[place].set_title(case.label, fontsize=7)
                limits: dict[str, Any] = {"vmin": -ERROR_RANGE, "vmax": ERROR_RANGE}
                errors = panel(lower[place], (image - expected) / white, cmap="RdBu_r", **limits)
                text = f"{row['psnr_shown']:.1f} dB, {row['ssim']:.2f}"
                lower[place].set_xlabel(text, fontsize=7)
        drawing.colorbar(
            errors,
            ax=panels.ravel().tolist(),
            location="bottom",
            shrink=0.4,
            aspect=40,
            label="error / white (98th percentile of the truth); PSNR, SSIM as on a screen",
        )
        save(drawing, out, "fig7", ("png", "svg"))


FIG7 = Experiment("fig7", cases, measure, _draw, parameters)
