"""Row by row: every camera sample estimated for itself, in tiles of bounded memory."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

import lightmatrix
from lightmatrix.capture import Capture, Samples
from lightmatrix.errors import InputError
from lightmatrix.solvers import Solver, solve
from lightmatrix.solvers.problem import Problem, Result
from lightmatrix.store import Checkpoint
from lightmatrix.transport import LightTransport

Progress = Callable[[int, int], None]

# Of the clip level; nearly independent of the number of patterns, flat within a factor of two.
DEFAULT_REGULARIZATION = 0.32
# Working memory of one tile of rows, well below the 4 GiB that any estimate may take.
_TILE_BYTES = 512 << 20


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
        return {
            "estimator": "plain",
            "solver": type(self.solver).__name__,
            "solver_parameters": {k: _plain(v) for k, v in asdict(cast(Any, self.solver)).items()},
            "regularization": regularization,
            "nonnegative": self.nonnegative,
            "background": self.background,
            "patterns": capture.patterns.description,
            "pattern_digest": capture.patterns.digest,
            "capture_description": capture.description,
            "versions": {
                "lightmatrix": lightmatrix.__version__,
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "python": platform.python_version(),
            },
        }

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
        problem = Problem(
            self.capture.patterns,
            samples.values,
            samples.clipped,
            samples.clip_level,
            self.regularization,
            samples.weights,
            self.estimator.nonnegative,
            self.estimator.background,
        )
        total = self.capture.rows

        def report(done: int, _: int) -> None:
            if progress is not None:
                progress(start + done, total)

        result = solve(problem, self.estimator.solver, progress=report)
        return (
            csr_array(result.coefficients, dtype=np.float32),
            result.background.astype(np.float32)[:, None],
            _diagnostics(samples, result),
        )

    def _fitting_rows(self) -> int:
        patterns = self.capture.patterns
        return max(
            1, _TILE_BYTES // self.estimator.solver.row_bytes(patterns.count, patterns.pixels)
        )


def _diagnostics(samples: Samples, result: Result) -> dict[str, NDArray[Any]]:
    return {
        "clipped_share": samples.clipped.mean(axis=1, dtype=np.float32),
        "iterations": result.iterations,
        "converged": result.converged,
        "gap": result.gap.astype(np.float32),
        "objective": result.objective,
    }


def _plain(value: Any) -> Any:
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)
