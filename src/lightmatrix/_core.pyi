"""The compiled core: pattern products on packed bits, a fast transform, the active-set solver."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

def bits_forward(packed: NDArray[np.uint8], pixels: int, x: NDArray[Any]) -> NDArray[Any]: ...
def bits_adjoint(packed: NDArray[np.uint8], pixels: int, e: NDArray[Any]) -> NDArray[Any]: ...
def bits_columns(
    packed: NDArray[np.uint8], pixels: int, index: NDArray[np.int64]
) -> NDArray[np.float32]: ...
def hadamard(x: NDArray[Any]) -> NDArray[Any]: ...
def likely_pixels(
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    values: NDArray[np.float32],
    camera: tuple[int, int, int],
    projector: tuple[int, int],
    reach: tuple[int, int],
    most: int,
    range: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]: ...
def expected_samples(
    shown: PreparedPatterns,
    unseen: PreparedPatterns,
    samples: NDArray[Any],
    clipped: NDArray[np.bool_],
    weights: NDArray[np.float64] | None,
    matrix: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]],
    camera: tuple[int, int, int],
    projector: tuple[int, int],
    reach: int,
    movement: NDArray[np.float32],
    background: NDArray[np.float32],
    first: int,
    start: int,
    level: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def solve_weighted(
    prepared: PreparedPatterns,
    samples: NDArray[Any],
    clipped: NDArray[np.bool_],
    weights: NDArray[np.float64] | None,
    candidates: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]],
    further: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32] | None],
    expected: tuple[PreparedPatterns, NDArray[np.float32], NDArray[np.float32]] | None,
    row_background: NDArray[np.float32] | None,
    start: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]
    | None,
    regularization: float,
    fidelity_name: str,
    nonnegative: bool,
    background: bool,
    tolerance: float,
    max_passes: int,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Solved, NDArray[np.float64]]: ...

class PreparedPatterns:
    """Patterns prepared for the solver: packed columns and what the correlation pass needs."""

    instructions: str

    @staticmethod
    def from_bits(
        packed: NDArray[np.uint8],
        pixels: int,
        means: NDArray[np.float64],
        transform: tuple[int, NDArray[np.int64], NDArray[np.int64]] | None = None,
        instructions: str | None = None,
    ) -> PreparedPatterns: ...
    @staticmethod
    def from_dense(
        matrix: NDArray[np.float32],
        means: NDArray[np.float64],
        instructions: str | None = None,
    ) -> PreparedPatterns: ...
    def scores(self, e: NDArray[np.float64]) -> tuple[NDArray[np.int16], NDArray[np.float64]]:
        """One correlation pass over rows of (M, K).

        Returns
        -------
        scores : (M, N) int16
        bounds : (4 M,) float64
            unit, offset, up and down of each row: a_j . e lies within
            unit * (score + offset - down ... score + offset + up).
        """

    def pass_only(self, e: NDArray[np.float64]) -> None:
        """One correlation pass on one thread whose scores are thrown away: for timing."""

    def solve(
        self,
        samples: NDArray[Any],
        clipped: NDArray[np.bool_],
        weights: NDArray[np.float64] | None,
        start: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]
        | None,
        regularization: float,
        fidelity: str,
        nonnegative: bool,
        background: bool,
        tolerance: float,
        max_passes: int,
        threads: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Solved: ...

class Solved:
    """Rows as the parts of a CSR matrix, and what is known of each."""

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    values: NDArray[np.float64]
    background: NDArray[np.float64]
    objective: NDArray[np.float64]
    gap: NDArray[np.float64]
    passes: NDArray[np.int32]
    converged: NDArray[np.bool_]
