"""The compiled core: pattern products, the active-set solver and the coherent estimate."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

def bits_forward(packed: NDArray[np.uint8], pixels: int, x: NDArray[Any]) -> NDArray[Any]: ...
def bits_adjoint(packed: NDArray[np.uint8], pixels: int, e: NDArray[Any]) -> NDArray[Any]: ...
def bits_columns(
    packed: NDArray[np.uint8], pixels: int, index: NDArray[np.int64]
) -> NDArray[np.float32]: ...
def hadamard(x: NDArray[Any]) -> NDArray[Any]: ...
def rows_times(rows: NDArray[np.float32], matrix: NDArray[np.float32]) -> NDArray[np.float32]: ...
def light_at_places(
    starts: NDArray[np.integer],
    pixels: NDArray[np.integer],
    columns: NDArray[np.float32],
    light: NDArray[np.float32],
) -> NDArray[np.float32]: ...
def gathered_at_places(
    starts: NDArray[np.integer],
    pixels: NDArray[np.integer],
    columns: NDArray[np.float32],
    samples: NDArray[np.float32],
) -> NDArray[np.float32]: ...
def blurred_moments(
    images: NDArray[np.float32], shape: tuple[int, int], kernel: NDArray[np.float32]
) -> tuple[float, float]: ...
def frame_patterns(
    rows: SparseRows,
    columns: SparseRows,
    background: NDArray[np.float32],
    cells: NDArray[np.integer],
    samples: NDArray[np.float32],
    pixels: NDArray[np.float32],
    wanted: list[NDArray[np.float32]],
    last_pattern: NDArray[np.float32],
    last_wanted: NDArray[np.float32],
    out: NDArray[np.float32],
    room: NDArray[np.float32],
    *,
    ridge: float,
    tolerance: float,
    steps: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def likely_pixels(
    rows: SparseRows,
    camera: tuple[int, int, int],
    projector: tuple[int, int, int],
    jacobian: NDArray[np.float32],
    spots: list[NDArray[np.float32]],
    within: float,
    wider: NDArray[np.float32],
    singles: NDArray[np.float32],
    reach: tuple[int, int],
    most: int,
    doubts: NDArray[np.float64],
    range: tuple[int, int],
    index: NDArray[np.integer] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]: ...
def expected_samples(
    shown: PreparedPatterns,
    unseen: PreparedPatterns,
    samples: Samples,
    neighbourhood: Neighbourhood,
    background: NDArray[np.float32],
    *,
    reach: int,
    start: int,
    level: float,
    index: NDArray[np.integer] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def solve_weighted(
    prepared: PreparedPatterns,
    samples: Samples,
    settings: Settings,
    candidates: SparseRows,
    *,
    cells: Cells | None = None,
    expected: tuple[PreparedPatterns, PseudoSamples] | None = None,
    background: NDArray[np.float32] | None = None,
    start: Start | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Solved, NDArray[np.float64]]: ...

# The attributes that the core reads from its arguments. Arrays that are not in C order are copied.
# A TypeError or ValueError names the attribute that does not fit.

class Samples(Protocol):
    """Values (M, K), clipped (M, K) bool, weights None, (K,) or (M, K); float32 or float64."""

    @property
    def values(self) -> NDArray[Any]: ...
    @property
    def clipped(self) -> NDArray[np.bool_]: ...
    @property
    def weights(self) -> NDArray[Any] | None: ...

class SparseRows(Protocol):
    """The parts of a CSR matrix: int32 or int64 indices, float32 or float64 data."""

    @property
    def indptr(self) -> Any: ...
    @property
    def indices(self) -> Any: ...
    @property
    def data(self) -> Any: ...

class Start(Protocol):
    """Sparse rows (M, N), no pixel twice in a row; background and cells (M, 1 + C)."""

    @property
    def coefficients(self) -> SparseRows: ...
    @property
    def background(self) -> NDArray[Any]: ...

class Cells(Protocol):
    """Means (C, K + E) in [0, 1], penalties (C,) > 0."""

    @property
    def means(self) -> NDArray[np.float32]: ...
    @property
    def penalties(self) -> NDArray[np.float32]: ...

class PseudoSamples(Protocol):
    """Pseudo-samples (M, K + E) and their weights (M, K + E) >= 0."""

    @property
    def values(self) -> NDArray[np.float32]: ...
    @property
    def weights(self) -> NDArray[np.float32]: ...

class Neighbourhood(Protocol):
    """Rows with (M, N) coefficients, the two grids, and the Jacobian (M, 4)."""

    @property
    def rows(self) -> Start: ...
    @property
    def camera(self) -> tuple[int, int, int]: ...
    @property
    def projector(self) -> tuple[int, int, int]: ...
    @property
    def jacobian(self) -> NDArray[np.float32]: ...

class Settings:
    """Settings of the solver. A message names the value that is out of range."""

    regularization: float
    fidelity: str
    nonnegative: bool
    background: bool
    tolerance: float
    max_passes: int
    threads: int | None

    def __init__(
        self,
        *,
        regularization: float,
        fidelity: str,
        nonnegative: bool,
        background: bool,
        tolerance: float,
        max_passes: int,
        threads: int | None = None,
    ) -> None: ...

class PreparedPatterns:
    """Patterns prepared for the solver: columns, and the tables of the correlation pass."""

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
        matrix: NDArray[np.float32], means: NDArray[np.float64], instructions: str | None = None
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

    def atoms(
        self,
        shape: tuple[int, int],
        planes: list[tuple[NDArray[np.float32], float]],
        narrow: bool = False,
        wanted: NDArray[np.integer] | None = None,
    ) -> PreparedPatterns:
        """Atoms with a (kernel, gain) for each plane; `narrow` stores columns to within 1e-5.

        The columns of atoms that are not `wanted` are zero. None: all are wanted.
        """

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        """The columns of the pixels or atoms `index`, (m, K)."""

    def pass_only(self, e: NDArray[np.float64]) -> None:
        """One correlation pass on one thread that discards the scores, for timing."""

    def solve(
        self,
        samples: Samples,
        settings: Settings,
        *,
        start: Start | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Solved: ...

class Solved:
    """Solved rows: the parts of a CSR matrix, and the diagnostics of each row."""

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]
    values: NDArray[np.float64]
    background: NDArray[np.float64]
    objective: NDArray[np.float64]
    gap: NDArray[np.float64]
    passes: NDArray[np.int32]
    converged: NDArray[np.bool_]
