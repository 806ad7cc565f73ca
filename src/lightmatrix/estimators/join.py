"""What all estimators share: tiles of rows joined to one light transport, kept as they come."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix._version import __version__
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.solvers import Solver
from lightmatrix.solvers.problem import Result
from lightmatrix.store import Checkpoint
from lightmatrix.transport.matrix import LightTransport

Progress = Callable[[int, int], None]
# Sparse rows (m, N), background (m, B) and diagnostics (m,) each.
Tile = tuple[csr_array, NDArray[np.float32], dict[str, NDArray[Any]]]

# Working memory of one tile of rows, well below the 4 GiB that any estimate may take.
TILE_BYTES = 512 << 20


def joined(
    capture: Capture,
    ranges: Iterable[tuple[int, int]],
    solve_tile: Callable[[int, int], Tile],
    provenance: Mapping[str, Any],
    *,
    checkpoint: Path | None,
    overwrite: bool,
    background_grid: tuple[int, int] = (1, 1),
    prepare: Callable[[Checkpoint | None], None] | None = None,
) -> LightTransport:
    """Solve tiles one after the other and join them.

    Parameters
    ----------
    ranges : iterable of (start, stop)
        Rows of each tile; together all rows of the capture, in order.
    solve_tile : callable
        Gives the tile of the rows start..stop.
    provenance : mapping
        What made the estimate, JSON-ready.
    checkpoint : Path or None
        The store to write. Finished tiles are kept beside it, so that an interrupted run goes on
        where it stopped.
    overwrite : bool
        Whether a complete store at `checkpoint` may be replaced.
    background_grid : (int, int)
        Blocks of the tiles' background.
    prepare : callable, optional
        What comes before the first tile, unless all are there; it may keep what it has found in
        the checkpoint it is given.

    Raises
    ------
    OutputError
        On outputs that cannot be written.
    """
    shapes: dict[str, Any] = {
        "camera_shape": capture.camera_shape,
        "projector_shape": capture.projector_shape,
        "background_grid": background_grid,
        "provenance": dict(provenance),
    }
    if checkpoint is None:
        if prepare is not None:
            prepare(None)
        parts = [solve_tile(start, stop) for start, stop in ranges]
        names = parts[0][2]
        return LightTransport(
            csr_array(vstack([part[0] for part in parts], format="csr")),
            np.concatenate([part[1] for part in parts]),
            diagnostics={n: np.concatenate([part[2][n] for part in parts]) for n in names},
            **shapes,
        )
    fingerprint = {**provenance, "capture": capture.digest}
    with Checkpoint.open(checkpoint, fingerprint, overwrite=overwrite) as running:
        missing = [(start, stop) for start, stop in ranges if not running.has(start, stop)]
        if missing and prepare is not None:
            prepare(running)
        for start, stop in missing:
            running.write(start, stop, *solve_tile(start, stop))
        return running.finish(**shapes)


def diagnostics(samples: Samples, result: Result) -> dict[str, NDArray[Any]]:
    """What is kept of every row beside its estimate, (m,) each."""
    return {
        "clipped_share": samples.clipped.mean(axis=1, dtype=np.float32),
        "iterations": result.iterations,
        "converged": result.converged,
        "gap": result.gap.astype(np.float32),
        "objective": result.objective,
    }


def solver_provenance(solver: Solver) -> dict[str, Any]:
    """Which solver with which parameters, JSON-ready."""
    parameters = {key: _plain(value) for key, value in asdict(cast(Any, solver)).items()}
    return {"solver": type(solver).__name__, "solver_parameters": parameters}


def capture_provenance(capture: Capture) -> dict[str, Any]:
    """What was estimated from, and with which versions, JSON-ready."""
    return {
        "patterns": capture.patterns.description,
        "pattern_digest": capture.patterns.digest,
        "capture_description": capture.description,
        "versions": {
            "lightmatrix": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
    }


def _plain(value: Any) -> Any:
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)
