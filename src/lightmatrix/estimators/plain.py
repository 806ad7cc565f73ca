"""Row by row: every camera sample estimated for itself, in tiles of bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.common import (
    TILE_BYTES,
    Progress,
    plain_value,
    problem_of,
    provenance_of,
    row_diagnostics,
)
from lightmatrix.solvers import Solver, solve
from lightmatrix.store import Checkpoint
from lightmatrix.transport import LightTransport

# Of the clip level; nearly independent of the number of patterns, flat within a factor of two.
DEFAULT_REGULARIZATION = 0.32


@dataclass(frozen=True)
class PlainEstimator:
    """Estimates T row by row with one solver.

    Parameters
    ----------
    solver : Solver
        ADMM, SaturationADMM, ROMP or ActiveSet.
    regularization : float or None
        The paper's lambda in units of camera sample at exposure 1. None: 0.32 times the clip
        level of the longest exposure.
    nonnegative : bool
        Whether light is held to be not negative.
    background : bool
        Whether each camera sample has a coefficient of the patterns' means (diffuse light).
    tile_rows : int or None
        Rows solved at a time, rounded up to the solver's blocks. None: as many as fit half a
        gigabyte. Results do not depend on it.
    """

    solver: Solver
    regularization: float | None = None
    nonnegative: bool = True
    background: bool = True
    tile_rows: int | None = None

    def __post_init__(self) -> None:
        if self.tile_rows is not None and self.tile_rows < 1:
            raise InputError(f"tiles of {self.tile_rows} rows", hint="use at least 1")

    def estimate(
        self,
        capture: Capture,
        *,
        checkpoint: Path | None = None,
        overwrite: bool = False,
        progress: Progress | None = None,
    ) -> LightTransport:
        """From a capture to its light transport matrix.

        Parameters
        ----------
        capture : Capture
            M camera samples under K patterns of N projector pixels.
        checkpoint : Path, optional
            The store to write. Finished tiles are kept beside it, so that an interrupted run goes
            on where it stopped.
        overwrite : bool
            Whether a complete store at `checkpoint` may be replaced.
        progress : callable, optional
            Called with (done, total) rows.

        Returns
        -------
        LightTransport
            With the diagnostics clipped_share, iterations, converged, gap and objective per row.

        Raises
        ------
        InputError, SolverError, OutputError
            On unusable captures, problems the solver cannot treat, or outputs it cannot write.
        """
        tiles = _Tiles(self, capture, self._regularization(capture))
        shapes: dict[str, Any] = {
            "camera_shape": capture.camera_shape,
            "projector_shape": capture.projector_shape,
            "provenance": self.provenance(capture, tiles.regularization),
        }
        if checkpoint is None:
            parts = []
            for start, stop in tiles.ranges():
                parts.append(tiles.solve(start, stop, progress))
            names = parts[0][2]
            return LightTransport(
                csr_array(vstack([part[0] for part in parts], format="csr")),
                np.concatenate([part[1] for part in parts]),
                diagnostics={n: np.concatenate([part[2][n] for part in parts]) for n in names},
                **shapes,
            )
        fingerprint = {**shapes["provenance"], "capture": capture.digest}
        with Checkpoint.open(checkpoint, fingerprint, overwrite=overwrite) as running:
            for start, stop in tiles.ranges():
                if not running.has(start, stop):
                    running.write(start, stop, *tiles.solve(start, stop, progress))
            return running.finish(background_grid=(1, 1), **shapes)

    def provenance(self, capture: Capture, regularization: float) -> dict[str, Any]:
        """What made the estimate, JSON-ready."""
        return provenance_of(
            capture,
            estimator="plain",
            solver=type(self.solver).__name__,
            solver_parameters={
                k: plain_value(v) for k, v in asdict(cast(Any, self.solver)).items()
            },
            regularization=regularization,
            nonnegative=self.nonnegative,
            background=self.background,
        )

    def _regularization(self, capture: Capture) -> float:
        if self.regularization is not None:
            return self.regularization
        return DEFAULT_REGULARIZATION * capture.reference_level


@dataclass(frozen=True)
class _Tiles:
    """The rows of a capture, solved tile by tile."""

    estimator: PlainEstimator
    capture: Capture
    regularization: float

    def ranges(self) -> Iterator[tuple[int, int]]:
        rows = self.estimator.tile_rows or self._fitting_rows()
        # Some solvers start anew at every block of rows: tiles must not cut through one.
        block = getattr(self.estimator.solver, "row_block", 1)
        rows = -(-rows // block) * block
        for start in range(0, self.capture.rows, rows):
            yield start, min(start + rows, self.capture.rows)

    def solve(
        self, start: int, stop: int, progress: Progress | None
    ) -> tuple[csr_array, NDArray[np.float32], dict[str, NDArray[Any]]]:
        samples = self.capture.samples(start, stop)
        problem = problem_of(
            self.capture,
            samples,
            self.regularization,
            nonnegative=self.estimator.nonnegative,
            background=self.estimator.background,
        )
        total = self.capture.rows

        def report(done: int, _: int) -> None:
            if progress is not None:
                progress(start + done, total)

        result = solve(problem, self.estimator.solver, progress=report)
        return (
            csr_array(result.coefficients, dtype=np.float32),
            result.background.astype(np.float32)[:, None],
            row_diagnostics(samples, result),
        )

    def _fitting_rows(self) -> int:
        patterns = self.capture.patterns
        return max(
            1, TILE_BYTES // self.estimator.solver.row_bytes(patterns.count, patterns.pixels)
        )
