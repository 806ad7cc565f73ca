"""What all estimators share: tiles of rows joined to one light transport, kept as they come."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix._version import __version__
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.solvers import Solver
from lightmatrix.solvers.problem import Result, check_regularization
from lightmatrix.store import Checkpoint
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

Progress = Callable[[int, int], None]
# Solves the rows start..stop.
SolveTile = Callable[[int, int], SparseRows]

# Working memory of one tile of rows, well below the 4 GiB that any estimate may take.
TILE_BYTES = 512 << 20


def joined(
    capture: Capture,
    ranges: Iterable[tuple[int, int]],
    begin: Callable[[Checkpoint | None], SolveTile],
    provenance: Mapping[str, Any],
    *,
    checkpoint: Path | None,
    overwrite: bool,
    background_grid: tuple[int, int] = (1, 1),
) -> LightTransport:
    """Solve tiles one after the other and join them.

    Parameters
    ----------
    ranges : iterable of (start, stop)
        Rows of each tile; together all rows of the capture, in order.
    begin : callable
        Does what comes before the first tile, and gives what solves the rows start..stop. It may
        keep what it has found in the checkpoint it is given, and is not called if all tiles are
        there.
    provenance : mapping
        What made the estimate, JSON-ready; its regularization is checked before anything is made.
    checkpoint : Path or None
        The store to write. Finished tiles are kept beside it, so that an interrupted run goes on
        where it stopped.
    overwrite : bool
        Whether a complete store at `checkpoint` may be replaced.
    background_grid : (int, int)
        Cells of the tiles' background.

    Raises
    ------
    InputError
        On a regularization that is none.
    OutputError
        On outputs that cannot be written.
    """
    check_regularization(provenance["regularization"])
    shapes: dict[str, Any] = {
        "camera_shape": capture.camera_shape,
        "projector_shape": capture.projector_shape,
        "background_grid": background_grid,
        "provenance": dict(provenance),
    }
    if checkpoint is None:
        solve_tile = begin(None)
        rows = SparseRows.joined([solve_tile(start, stop) for start, stop in ranges])
        return LightTransport(
            rows.coefficients, rows.background, diagnostics=rows.diagnostics, **shapes
        )
    fingerprint = {**provenance, "capture": capture.digest}
    with Checkpoint.open(checkpoint, fingerprint, overwrite=overwrite) as running:
        missing = [(start, stop) for start, stop in ranges if not running.has(start, stop)]
        if missing:
            solve_tile = begin(running)
        for start, stop in missing:
            running.write(start, stop, solve_tile(start, stop))
        return running.finish(**shapes)


def kept(samples: Samples, result: Result, **more: NDArray[Any]) -> SparseRows:
    """What is kept of solved rows: in single precision, and with the share of clipped samples.

    Parameters
    ----------
    more : (m,) arrays
        Further diagnostics.
    """
    diagnostics = {
        "clipped_share": samples.clipped.mean(axis=1, dtype=np.float32),
        **result.rows.diagnostics,
        "gap": result.gap.astype(np.float32),
        **more,
    }
    return replace(result.rows.single(), diagnostics=diagnostics)


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
    # Names from enumerations become strings like any other.
    return value if isinstance(value, (bool, int, float, type(None))) else str(value)
