"""The base class of all estimators: it plans an estimate, solves its tiles and joins them."""

import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.check.finding import FINDINGS
from lightmatrix.estimators.work import TilesInMemory, Work, WorkerPool, complete
from lightmatrix.files.kinds import PROJECTOR_STORES, STORE
from lightmatrix.files.writing import final_target
from lightmatrix.progress import Progress
from lightmatrix.resources.memory import check_disk_space
from lightmatrix.resources.threads import one_blas_thread
from lightmatrix.solvers import Solver
from lightmatrix.solvers.problem import Result, check_regularization
from lightmatrix.transport.checkpoint import ROWS, Checkpoint
from lightmatrix.transport.matrix import PROJECTORS, LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

# The step of a T that takes the place of the one that was estimated.
_REVIEWED = "reviewed"


@dataclass(frozen=True)
class Plan:
    """An estimate before it is made. The provenance is JSON-ready and has every parameter."""

    work: Work
    provenance: Mapping[str, Any]
    background_grid: tuple[int, int] = (1, 1)

    @property
    def shapes(self) -> dict[str, Any]:
        """Everything that a light transport has besides its rows."""
        capture = self.work.capture
        sizes = {"camera_shape": capture.camera_shape, "projector_shape": capture.projector_shape}
        made = {"background_grid": self.background_grid, "provenance": dict(self.provenance)}
        return sizes | made

    @property
    def fingerprint(self) -> dict[str, Any]:
        """Everything that the result depends on."""
        return {**self.provenance, "capture": self.work.capture.digest}


class Estimator(ABC):
    """From a capture to its light transport matrix, in one way."""

    @abstractmethod
    def plan(self, capture: Capture) -> Plan:
        """The estimate before it is made."""

    def estimate(
        self,
        capture: Capture,
        *,
        output: Path | None = None,
        overwrite: bool = False,
        remarks: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
        pool: WorkerPool | None = None,
        review: Callable[[LightTransport], LightTransport | None] | None = None,
    ) -> LightTransport:
        """Estimate T of a capture, as `lm.estimate` describes it.

        `remarks` join the provenance, JSON-ready, such as what `check` found. `review` is called
        with T before it is written, and may return another one to write in its place. Rows have
        the diagnostics clipped_share, iterations, converged, gap and objective, and those that the
        class documents.
        """
        plan = self.plan(capture)
        shapes = plan.shapes
        shapes["provenance"] |= {FINDINGS: []} | dict(remarks or {})
        check_regularization(plan.provenance["regularization"])
        with ExitStack() as stack:
            if plan.work.together > 1:
                # Tiles side by side keep all cores busy. More threads of a product would only wait.
                stack.enter_context(one_blas_thread())
            if output is None:
                tiles = TilesInMemory()
                complete(plan.work, tiles, progress, pool)
                transport = _joined(tiles, shapes)
                return (review and review(transport)) or transport
            # The tiles are kept until the compressed output is complete. Most rows of T have more
            # than 16 entries, so the check refuses only what cannot fit.
            cells = plan.background_grid[0] * plan.background_grid[1]
            least = (6 * cells + 8 * 16 + 40) * plan.work.capture.rows
            kind = PROJECTOR_STORES if capture.projectors else STORE
            check_disk_space(final_target(output).parent, least, output, "at least about")
            checkpoint = stack.enter_context(
                Checkpoint.open(output, plan.fingerprint, kind=kind, overwrite=overwrite)
            )
            complete(plan.work, checkpoint, progress, pool)
            better = review and review(_joined(checkpoint, shapes))
            if not better:
                return checkpoint.finish(**shapes)
            # The tiles of the first T stay until the output is whole: a run that is killed now
            # continues from them.
            checkpoint.forget(_REVIEWED)
            rows = SparseRows(better.sparse, better.background, dict(better.diagnostics))
            checkpoint.write(0, plan.work.capture.rows, rows, _REVIEWED)
            shapes["provenance"] = dict(better.provenance)
            return checkpoint.finish(**shapes, step=_REVIEWED)


def _joined(tiles: TilesInMemory | Checkpoint, shapes: Mapping[str, Any]) -> LightTransport:
    rows = tiles.read(ROWS)
    return LightTransport(
        rows.coefficients, rows.background, diagnostics=rows.diagnostics, **shapes
    )


def rows_with_diagnostics(
    samples: Samples, result: Result, **diagnostics: NDArray[Any]
) -> SparseRows:
    """Solved rows in single precision with their diagnostics, (m,) each, and further ones."""
    shares = {"clipped_share": samples.clipped.mean(axis=1, dtype=np.float32)}
    solved = {**result.rows.diagnostics, "gap": result.gap.astype(np.float32)}
    return replace(result.rows.single(), diagnostics={**shares, **solved, **diagnostics})


def solver_provenance(solver: Solver) -> dict[str, Any]:
    """The solver and its parameters, JSON-ready."""

    def plain(value: Any) -> Any:
        # Members of enumerations become strings.
        return value if isinstance(value, (bool, int, float, type(None))) else str(value)

    parameters = {key: plain(value) for key, value in asdict(cast(Any, solver)).items()}
    return {"solver": type(solver).__name__, "solver_parameters": parameters}


def capture_provenance(capture: Capture) -> dict[str, Any]:
    """The patterns, the capture and the versions of everything, JSON-ready."""
    sizes = {PROJECTORS: list(map(list, capture.projectors))} if capture.projectors else {}
    versions = {"lightmatrix": __version__, "numpy": np.__version__, "scipy": scipy.__version__}
    patterns = capture.patterns
    return {
        **sizes, "patterns": patterns.description, "pattern_digest": patterns.digest,
        "capture_description": capture.description,
        "versions": {**versions, "python": platform.python_version()},
    }  # fmt: skip
