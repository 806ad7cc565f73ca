"""Small pattern sets, and photographs of a random scene under them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.files.images import write_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

SHAPE = (6, 8)
COUNT = 9

SETS = [
    BernoulliPatterns(SHAPE, COUNT, 0.4, seed=7),
    HadamardPatterns(SHAPE, COUNT, "random", True, seed=3),
    BlockPatterns(SHAPE, (3, 3)),
    ImagePatterns(
        np.random.default_rng(0).integers(0, 256, (COUNT, *SHAPE)).astype(np.float32)
        / np.float32(255)
    ),
]


def light(
    patterns: PatternSet, camera: tuple[int, ...] = (5, 7), seed: int = 0
) -> NDArray[np.float64]:
    """T p for a random sparse T, (M, K), up to about 1.5."""
    generator = np.random.default_rng(seed)
    rows = int(np.prod(camera))
    matrix = generator.random((rows, patterns.pixels)) * (
        generator.random((rows, patterns.pixels)) < 4 / patterns.pixels
    )
    return patterns.forward(0.6 * matrix)


def photographs(
    patterns: PatternSet, sensor: Sensor, camera: tuple[int, ...] = (5, 7), seed: int = 0
) -> NDArray[Any]:
    raw = sensor.expose(light(patterns, camera, seed), seed=seed)
    return np.ascontiguousarray(raw.T).reshape(patterns.count, *camera)


def write_folders(place: Path, patterns: PatternSet, frames: NDArray[Any]) -> tuple[Path, Path]:
    for k, frame in enumerate(frames):
        write_image(place / "photos" / f"IMG_{k + 98}.png", frame)
    for k, image in enumerate(patterns.images()):
        write_image(place / "shown" / f"p{k + 5}.png", image)
    return place / "shown", place / "photos"


def write_plain(place: Path) -> Path:
    sensor = Sensor()
    write_capture(place / "c", SETS[0], photographs(SETS[0], sensor), sensor=sensor)
    return place / "c"
