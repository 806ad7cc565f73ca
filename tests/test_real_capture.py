"""A real capture: estimates against classical Gray decoding, and frames held out.

42 photographs of a planar board under Gray code stripes (kamino410/procam-calibration, MIT): a
window of them, or the folder that the environment variable LIGHTMATRIX_BOARD names.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.regularization import automatic_regularization
from lightmatrix.files.stack import ImageStack
from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.problem import Problem, Result

WINDOW = Path(__file__).parent / "data" / "graycode-board"
BOARD = Path(os.environ.get("LIGHTMATRIX_BOARD", WINDOW))

# Frames 0-19: ten column bits, most significant first, each with its inverse; 20-39: ten row bits.
WHITE, BLACK, CLIP, BIN = 40, 41, 255, 8


@pytest.fixture(scope="module")
def capture() -> Capture:
    """The capture binned 8 x 8 on both sides; frame 41 is also the black frame."""
    return Capture.from_folders(
        BOARD / "graycode_pattern",
        BOARD / "capture_0",
        black=BOARD / "capture_0" / f"graycode_{BLACK}.png",
        clip=CLIP,
        bin_projector=BIN,
        bin_camera=BIN,
    )


@pytest.fixture(scope="module")
def photographs() -> NDArray[np.float32]:
    return np.stack(list(ImageStack.open(BOARD / "capture_0"))).astype(np.float32)


def bins(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Blocks of 8 x 8 camera pixels: (camera bins, 64)."""
    rows, cols = image.shape
    blocks = image.reshape(rows // BIN, BIN, cols // BIN, BIN)
    return blocks.transpose(0, 2, 1, 3).reshape(-1, BIN * BIN)


def lit(photographs: NDArray[np.float32]) -> NDArray[np.int64]:
    """Camera bins whose white - black is above 10 % of the clip level."""
    light = bins(photographs[WHITE] - photographs[BLACK]).mean(axis=1)
    return np.flatnonzero(light > 0.1 * CLIP)


def gray_decoded(photographs: NDArray[np.float32], first: int) -> NDArray[np.float32]:
    """Projector coordinate that each camera pixel sees, from the ten bits from frame `first`."""
    code = photographs[first : first + 20 : 2] > photographs[first + 1 : first + 20 : 2]
    bit = np.zeros(code.shape[1:], bool)
    value = np.zeros(code.shape[1:], np.int64)
    for plane in code:
        bit = bit ^ plane
        value = 2 * value + bit
    return value.astype(np.float32)


def estimate(capture: Capture, rows: NDArray[np.int64], regularization: float = 0.32) -> Result:
    samples = capture.samples()
    level = np.broadcast_to(samples.clip_level, samples.values.shape)
    problem = Problem(
        capture.patterns,
        Samples(samples.values[rows], samples.clipped[rows], level[rows]),
        regularization * capture.reference_level,
    )
    return ActiveSet().solve(problem)


@pytest.mark.parametrize("coherent", [False, True])
def test_the_strongest_entry_is_where_gray_decoding_says(
    capture: Capture, photographs: NDArray[np.float32], coherent: bool
) -> None:
    assert capture.projector_shape == (96, 128)
    rows = lit(photographs)
    assert len(rows) > 2 / 3 * capture.rows
    assert capture.samples().clipped[rows].any()
    if coherent:
        matrix = CoherentEstimator().estimate(capture).sparse[rows]
    else:
        matrix = estimate(capture, rows).coefficients
    strongest = np.array(
        [
            matrix.indices[a:b][matrix.data[a:b].argmax()] if b > a else -1
            for a, b in zip(matrix.indptr[:-1], matrix.indptr[1:], strict=True)
        ]
    )
    found_row, found_col = np.divmod(strongest, capture.projector_shape[1])
    bright = bins(photographs[WHITE] - photographs[BLACK])[rows] > 0.1 * CLIP
    near = strongest >= 0
    for found, first in ((found_col, 0), (found_row, 20)):
        decoded = np.where(bright, bins(gray_decoded(photographs, first))[rows], np.nan)
        near &= np.abs(found - np.nanmedian(decoded, axis=1) // BIN) <= 1
    print(f"strongest entry within one bin of Gray decoding: {100 * near.mean():.2f} %")
    assert near.mean() >= 0.98


@pytest.mark.parametrize("held", [2, 26])
def test_a_frame_held_out_is_predicted_by_the_coherent_estimate(
    capture: Capture, photographs: NDArray[np.float32], held: int
) -> None:
    rest = np.delete(np.arange(capture.count), held)
    found = CoherentEstimator().estimate(capture.select(rest))
    predicted = found.relight(capture.patterns.images(held, held + 1)).reshape(-1)
    samples = capture.samples()
    rows = lit(photographs)
    rows = rows[~samples.clipped[rows, held]]
    lit_range = samples.values[rows, WHITE].mean()
    error = np.sqrt(np.mean((predicted - samples.values[:, held])[rows] ** 2)) / lit_range
    print(f"frame {held} predicted to {100 * error:.2f} % RMS of the mean lit level")
    assert error < 0.03


@pytest.mark.parametrize("held", [2, 6, 26])
def test_a_frame_held_out_is_predicted(
    capture: Capture, photographs: NDArray[np.float32], held: int
) -> None:
    """Its inverse, the next frame, is kept."""
    rows = lit(photographs)
    rows = rows[:: -(-len(rows) // 2000)]
    rest = np.delete(np.arange(capture.count), held)
    # The board stays well below the clip level, whose 0.32 would shrink it by 7 to 10 %.
    kept = capture.select(rest)
    result = estimate(kept, rows, automatic_regularization(kept))
    shown = capture.patterns.rows(held, held + 1)[0]
    predicted = result.coefficients @ shown + result.background * shown.mean()
    samples = capture.samples()
    observed, unclipped = samples.values[rows, held], ~samples.clipped[rows, held]
    # Of the mean light of the lit pixels, which is stricter than of their whole range.
    lit_range = samples.values[rows, WHITE].mean()
    error = np.sqrt(np.mean((predicted - observed)[unclipped] ** 2)) / lit_range
    print(f"frame {held} predicted to {100 * error:.2f} % RMS of the mean lit level")
    assert observed.std() > 0.3 * lit_range
    assert error < 0.06


def test_stripes_finer_than_a_bin_become_constant_without_error(capture: Capture) -> None:
    spread = np.ptp(capture.patterns.dense(), axis=1)
    assert (spread[:WHITE] < 1e-6).any()
    assert (spread == 1).sum() > 20
    capture.check()


def test_swapped_stripes_are_refused() -> None:
    stack = ImageStack.open(BOARD / "capture_0")
    order = np.arange(42)
    order[[4, 24]] = 24, 4
    good = Capture.from_folders(
        BOARD / "graycode_pattern",
        BOARD / "capture_0",
        bin_projector=BIN,
        bin_camera=BIN,
        check=False,
    )
    mixed = Capture(
        good.patterns, stack.select(list(order)), good.decoder, bin_camera=good.bin_camera
    )
    with pytest.raises(InputError, match="look swapped"):
        mixed.check()
