"""What all estimators share: tiles of rows joined to one light transport, kept as they come."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix._version import __version__
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.steps import InMemory, Work, complete
from lightmatrix.outputs.targets import final_target
from lightmatrix.resources.disk import check_disk_space
from lightmatrix.solvers import Solver
from lightmatrix.solvers.problem import Result, check_regularization
from lightmatrix.store import ROWS, Checkpoint
from lightmatrix.store.tiles import Span
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

# Working memory of one tile of rows, well below the 4 GiB that any estimate may take.
TILE_BYTES = 512 << 20
# Of a row; most have more.
_FEW_ENTRIES = 16


class Crew(Protocol):
    """Other processes that solve tiles, and write them where the checkpoint keeps them."""

    @property
    def parts(self) -> int:
        """Into how many tiles a step is cut at least, so that all have something to do."""

    def solve(self, work: Work, step: str, spans: list[Span], running: Checkpoint) -> None:
        """Solve tiles of a step, and count them as finished."""


@dataclass(frozen=True)
class Plan:
    """An estimate before it is made.

    Parameters
    ----------
    work : Work
    provenance : mapping
        What makes the estimate, JSON-ready; its regularization is checked before anything is made.
    background_grid : (int, int)
        Cells of the tiles' background.
    """

    work: Work
    provenance: Mapping[str, Any]
    background_grid: tuple[int, int] = (1, 1)

    @property
    def shapes(self) -> dict[str, Any]:
        """What a light transport has beside its rows."""
        return {
            "camera_shape": self.work.capture.camera_shape,
            "projector_shape": self.work.capture.projector_shape,
            "background_grid": self.background_grid,
            "provenance": dict(self.provenance),
        }

    @property
    def fingerprint(self) -> dict[str, Any]:
        """Everything that the result depends on."""
        return {**self.provenance, "capture": self.work.capture.digest}


def joined(
    plan: Plan, *, checkpoint: Path | None, overwrite: bool, crew: Crew | None = None
) -> LightTransport:
    """Solve the tiles of all steps and join those of the last.

    Parameters
    ----------
    plan : Plan
    checkpoint : Path or None
        The store to write. Finished tiles are kept beside it, so that an interrupted run goes on
        where it stopped.
    overwrite : bool
        Whether a complete store at `checkpoint` may be replaced.
    crew : Crew, optional
        Who solves the tiles; None: this process, one after the other.

    Raises
    ------
    InputError
        On a regularization that is none.
    OutputError
        On outputs that cannot be written.
    ClusterError
        If the crew cannot work.
    """
    check_regularization(plan.provenance["regularization"])
    if checkpoint is None and crew is not None:
        # What other processes find has to lie somewhere.
        with TemporaryDirectory(prefix="lightmatrix-") as folder:
            place = Path(folder) / "scene.zarr"
            return joined(plan, checkpoint=place, overwrite=False, crew=crew)
    if checkpoint is None:
        tiles = InMemory()
        complete(plan.work, tiles)
        rows = tiles.read(ROWS)
        return LightTransport(
            rows.coefficients, rows.background, diagnostics=rows.diagnostics, **plan.shapes
        )
    target = final_target(checkpoint)
    check_disk_space(target.parent, _least_bytes(plan), checkpoint, "at least about")
    with Checkpoint.open(checkpoint, plan.fingerprint, overwrite=overwrite) as running:
        complete_with(crew, plan.work, running)
        return running.finish(**plan.shapes)


def _least_bytes(plan: Plan) -> int:
    """Bytes that tiles and the output will take together, with few entries a row."""
    cells = plan.background_grid[0] * plan.background_grid[1]
    # Tiles are kept until the output is whole, which is compressed.
    row = 6 * cells + 8 * _FEW_ENTRIES + 40
    return row * plan.work.capture.rows


def complete_with(crew: Crew | None, work: Work, running: Checkpoint) -> None:
    """Solve what is missing of an estimate by a crew, or here; see `complete`."""
    if crew is None:
        complete(work, running)
        return

    def solve(work: Work, step: str, spans: list[Span]) -> None:
        crew.solve(work, step, spans, running)

    complete(work, running, parts=crew.parts, solve=solve)


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
