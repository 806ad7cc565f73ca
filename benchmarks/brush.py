"""How long the light of a brush stroke takes on a stored matrix.

The matrix needs an index of its columns (`lm.index_columns`). First the light of some strokes is
held against relighting the whole. Then an index that has read nothing yet gives that of squares of
projector pixels anywhere, one after the other, and of a square that moves by a pixel each time, as
a hand paints. Relighting stands beside, whose first image reads the matrix.

    python -m benchmarks.brush scene.zarr [--side 21] [--strokes 120]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm

# Of the brightest sample: both are sums of float32 values, in another order.
_AGREE = 1e-5
_COMPARED = 4


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a line of JSON: milliseconds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.brush", description=__doc__)
    parser.add_argument("matrix", help="a .zarr folder with an index of its columns")
    parser.add_argument("--side", type=int, default=21)
    parser.add_argument("--strokes", type=int, default=120)
    options = parser.parse_args(arguments)
    matrix = lm.StoredTransport.open(options.matrix)
    corners = anywhere(matrix.projector_shape, options.side, options.strokes)
    relit = compared(matrix, lm.ColumnIndex.open(options.matrix), corners, options.side)
    index = lm.ColumnIndex.open(options.matrix)
    strokes = timed(index, corners, options.side)
    # Through the middle of the projector, where four cells of the background meet.
    row, col = ((n - options.side) // 2 for n in matrix.projector_shape)
    painted = timed(index, [(row, col + k) for k in range(options.side // 2)], options.side)
    found = {
        "relit": {"first": relit[0], "further": float(np.median(relit[1:]))},
        "stroke_anywhere": told(strokes),
        "stroke_moved_by_a_pixel": told(painted),
    }
    print(json.dumps({**vars(options), "entries": matrix.entries, **found}))


def anywhere(shape: tuple[int, int], side: int, count: int) -> list[tuple[int, int]]:
    """Upper left corners of squares within a projector, drawn at random."""
    generator = np.random.default_rng(0)
    rows, cols = (generator.integers(0, n - side + 1, count).tolist() for n in shape)
    return list(zip(rows, cols, strict=True))


def compared(
    matrix: lm.StoredTransport, index: lm.ColumnIndex, corners: list[tuple[int, int]], side: int
) -> list[float]:
    """Milliseconds of relighting under some squares, of which the index must give the same."""
    took = []
    for corner in corners[:_COMPARED]:
        pixels = square(matrix.projector_shape, corner, side)
        shown = np.zeros(matrix.shape[1], np.float32)
        shown[pixels] = 1
        started = time.perf_counter()
        whole = matrix.relight(shown.reshape(matrix.projector_shape))
        took.append(1e3 * (time.perf_counter() - started))
        light = index.light(pixels, np.ones(len(pixels)))
        if np.abs(light - whole).max() > _AGREE * np.abs(whole).max():
            raise SystemExit(f"the index and relighting differ in the light of {corner}")
    return took


def timed(index: lm.ColumnIndex, corners: Iterable[tuple[int, int]], side: int) -> list[float]:
    """Milliseconds of each stroke, one after the other."""
    took = []
    for corner in corners:
        pixels = square(index.matrix.projector_shape, corner, side)
        started = time.perf_counter()
        index.light(pixels, np.ones(len(pixels)))
        took.append(1e3 * (time.perf_counter() - started))
    return took


def square(shape: tuple[int, int], corner: tuple[int, int], side: int) -> NDArray[np.int64]:
    """The pixels of a square."""
    rows, cols = (first + np.arange(side) for first in corner)
    return (rows[:, None] * shape[1] + cols).ravel()


def told(took: list[float]) -> dict[str, float]:
    """What there is to say of some times."""
    return {
        "first": took[0],
        "median": float(np.median(took)),
        "of_ten_nine_within": float(np.quantile(took, 0.9)),
        "longest": max(took),
    }


if __name__ == "__main__":
    main()
