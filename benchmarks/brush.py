"""Measures how long the light of a brush stroke takes on a stored matrix.

The matrix needs an index of its columns (`lm.index_columns`). First, some strokes are compared with
relighting the whole matrix, whose first image reads it. Then a new index, which has read nothing
yet, computes the light of squares of projector pixels anywhere, and of a square that moves by one
pixel each time, as a painting hand does.

    python -m benchmarks.brush scene.zarr [--side 21] [--strokes 120]
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm
from experiments.harness import options as options_of

# Both ways agree within this share of the brightest sample: they add float32 values in different
# orders.
_TOLERANCE = 1e-5
# Strokes that are compared with relighting.
_COMPARED = 4


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a line of JSON: milliseconds."""
    parser = options_of("benchmarks.brush", __doc__)
    parser.add_argument("matrix", help="a .zarr folder with an index of its columns")
    parser.add_argument("--side", type=int, default=21)
    parser.add_argument("--strokes", type=int, default=120)
    options = parser.parse_args(arguments)
    matrix = lm.StoredTransport.open(options.matrix)
    corners = random_corners(matrix.projector_shape, options.side, options.strokes)
    relit = relighting_times(matrix, lm.ColumnIndex.open(options.matrix), corners, options.side)
    index = lm.ColumnIndex.open(options.matrix)
    strokes = stroke_times(index, corners, options.side)
    # The hand paints through the middle of the projector, where four background cells meet.
    row, col = ((n - options.side) // 2 for n in matrix.projector_shape)
    painted = stroke_times(index, [(row, col + k) for k in range(options.side // 2)], options.side)
    milliseconds = {
        "relit": {"first": relit[0], "further": float(np.median(relit[1:]))},
        "stroke_anywhere": summary(strokes),
        "stroke_moved_by_a_pixel": summary(painted),
    }
    print(json.dumps({**vars(options), "entries": matrix.entries, **milliseconds}))


def random_corners(shape: tuple[int, int], side: int, count: int) -> list[tuple[int, int]]:
    """Upper left corners of random squares within a projector."""
    generator = np.random.default_rng(0)
    rows, cols = (generator.integers(0, n - side + 1, count).tolist() for n in shape)
    return list(zip(rows, cols, strict=True))


def relighting_times(
    matrix: lm.StoredTransport, index: lm.ColumnIndex, corners: list[tuple[int, int]], side: int
) -> list[float]:
    """Milliseconds of relighting under some squares, whose light the index must give too."""
    took = []
    for corner in corners[:_COMPARED]:
        pixels = square(matrix.projector_shape, corner, side)
        shown = np.zeros(matrix.shape[1], np.float32)
        shown[pixels] = 1
        started = time.perf_counter()
        whole = matrix.relight(shown.reshape(matrix.projector_shape))
        took.append(1e3 * (time.perf_counter() - started))
        light = index.light(pixels, np.ones(len(pixels)))
        if np.abs(light - whole).max() > _TOLERANCE * np.abs(whole).max():
            raise SystemExit(f"the index and relighting differ in the light of {corner}")
    return took


def stroke_times(
    index: lm.ColumnIndex, corners: Iterable[tuple[int, int]], side: int
) -> list[float]:
    """Milliseconds of each stroke, one after the other."""
    took = []
    for corner in corners:
        pixels = square(index.matrix.projector_shape, corner, side)
        started = time.perf_counter()
        index.light(pixels, np.ones(len(pixels)))
        took.append(1e3 * (time.perf_counter() - started))
    return took


def square(shape: tuple[int, int], corner: tuple[int, int], side: int) -> NDArray[np.int64]:
    """The projector pixels of a square."""
    rows, cols = (first + np.arange(side) for first in corner)
    return (rows[:, None] * shape[1] + cols).ravel()


def summary(took: list[float]) -> dict[str, float]:
    """The first, the median, the 0.9 quantile and the longest of some times."""
    return {
        "first": took[0],
        "median": float(np.median(took)),
        "quantile_90": float(np.quantile(took, 0.9)),
        "longest": max(took),
    }


if __name__ == "__main__":
    main()
