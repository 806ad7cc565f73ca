"""The estimator that suits a capture, and what can be said of it: solver, fidelity, ..."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent.estimator import WORTH_IT_UP_TO, CoherentEstimator
from lightmatrix.estimators.join import Crew
from lightmatrix.estimators.multiscale.estimator import MultiScaleEstimator
from lightmatrix.estimators.needs import Needs, needs_of
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.regularization import held_out_path
from lightmatrix.estimators.steps import Progress
from lightmatrix.estimators.workers.opening import opened
from lightmatrix.ranges import check_at_least_one, check_number
from lightmatrix.resources.memory import memory_bytes
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, Fidelity, SaturationADMM, Solver
from lightmatrix.transport.matrix import LightTransport

# Solvers by name, each with the fidelity that it has unless another is asked for.
SOLVERS = {
    "active-set": Fidelity.ONE_SIDED,
    "saturation-admm": Fidelity.ONE_SIDED,
    "admm": Fidelity.LINEAR,
    "romp": Fidelity.REJECTION,
}
MOST_ITERATIONS = 1_000_000_000
# Float32 samples of any unit lie well within.
LEAST_REGULARIZATION, MOST_REGULARIZATION = 1e-20, 1e20


@dataclass(frozen=True)
class AutoEstimator:
    """Estimates T in the way that suits the capture; its parameters are those of `estimate`.

    Raises
    ------
    InputError, SolverError
        On parameters out of range or that do not go together, before any capture is read.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> type(lm.AutoEstimator().estimator(capture)).__name__
    'CoherentEstimator'
    >>> type(lm.AutoEstimator(solver="romp").estimator(capture)).__name__
    'PlainEstimator'
    """

    solver: str = "active-set"
    fidelity: str | None = None
    regularization: str | float = "auto"
    coherent: bool | None = None
    multi_scale: bool = False
    background: bool = True
    signed: bool = False
    iterations: int | None = None
    tile_rows: int | None = None
    memory: int | str | None = None
    workers: int | None = None
    cluster: str | None = None

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(
                f"there is no solver {self.solver!r}", hint=f"use one of {', '.join(SOLVERS)}"
            )
        if self.fidelity is not None and self.fidelity not in list(Fidelity):
            raise InputError(
                f"there is no fidelity {self.fidelity!r}", hint=f"use one of {', '.join(Fidelity)}"
            )
        limit = self.iterations
        if limit is not None and not 1 <= limit <= MOST_ITERATIONS:
            raise InputError(f"{limit} iterations", hint=f"use 1 to {MOST_ITERATIONS}")
        if self.tile_rows is not None and self.tile_rows < 1:
            raise InputError(f"tiles of {self.tile_rows} rows", hint="use at least 1")
        given = {"tile rows": self.tile_rows, "a bound of memory": self.memory}
        both = [name for name, value in given.items() if value is not None]
        if len(both) > 1:
            raise InputError(" and ".join(both), hint="leave out one of the two")
        if self.multi_scale and both:
            raise InputError(
                f"{both[0]} with the multi-scale estimate, which solves strips of camera blocks",
                hint="leave out one of the two",
            )
        most = self._most
        if most is not None and most < 1:
            raise InputError(f"a bound of {most} bytes of memory", hint="give one such as 4GiB")
        if self.workers is not None and self.cluster is not None:
            raise InputError("workers here and a cluster", hint="leave out one of the two")
        check_at_least_one(workers=self.workers)
        self._check_regularization()
        fitting = self._why_not_coherent()
        if self.coherent and fitting is not None:
            raise InputError(f"the coherent estimate {fitting}", hint="leave out one of the two")
        self._solver()  # Checks that solver and fidelity go together.

    def estimator(
        self, capture: Capture
    ) -> PlainEstimator | CoherentEstimator | MultiScaleEstimator:
        """The estimator that `estimate` uses for a capture; with "path" it solves some rows first.

        Raises
        ------
        InputError
            If there are too few patterns or rows for a path of regularizations.
        """
        chosen, value = self._solver(), self._value(capture)
        tile_rows = self.tile_rows
        if self._most is not None:
            tile_rows = self.needs(capture).size.tile_rows
        if self.multi_scale:
            return MultiScaleEstimator(chosen, value, not self.signed, self.background)
        if self._is_coherent(capture) and isinstance(chosen, ActiveSet):
            return CoherentEstimator(
                value,
                fidelity=chosen.fidelity,
                max_passes=chosen.max_passes,
                tile_rows=tile_rows,
            )
        return PlainEstimator(chosen, value, not self.signed, self.background, tile_rows)

    def needs(self, capture: Capture) -> Needs:
        """What `estimate` will take of memory and time; reads no frame.

        Parameters
        ----------
        capture : Capture
        """
        method, row_bytes = "other", 0
        if self._is_coherent(capture):
            method = "coherent"
        elif self.solver == "active-set" and not self.multi_scale:
            method = "plain"
        else:
            row_bytes = self._solver().row_bytes(capture.count, capture.patterns.pixels)
        return needs_of(
            capture,
            method,
            windows=CoherentEstimator.windows,
            row_bytes=row_bytes,
            most=self._most,
            workers=self.workers or 1,
            elsewhere=self.cluster is not None,
        )

    def check_shared(self, output: str | Path | None) -> None:
        """Refuse a cluster without an output.

        Raises
        ------
        InputError
            As workers have nowhere to write what they find.
        """
        if self.cluster is not None and output is None:
            raise InputError(
                "workers of a cluster, and no output where they write what they find",
                hint="give an output on a file system that all of them share",
            )

    def crew(self, capture: Capture) -> AbstractContextManager[Crew | None]:
        """The workers that were asked for, started or found and checked; None: this process.

        Parameters
        ----------
        capture : Capture
            What they are to estimate from; no frame is read.

        Raises
        ------
        MissingExtraError
            Without Dask.
        ClusterError
            If workers cannot be started or reached, or are not what they should be.
        """
        if self.workers is None and self.cluster is None:
            return nullcontext(None)
        return opened(self.workers, self.cluster, self.needs(capture).size.memory)

    def estimate(
        self,
        capture: Capture,
        *,
        checkpoint: Path | None = None,
        overwrite: bool = False,
        progress: Progress | None = None,
        crew: Crew | None = None,
    ) -> LightTransport:
        """From a capture to its light transport matrix, as every estimator does.

        Parameters
        ----------
        capture : Capture
        checkpoint : Path, optional
            The store to write. Finished tiles are kept beside it, so that an interrupted run goes
            on where it stopped.
        overwrite : bool
            Whether a complete store at `checkpoint` may be replaced.
        progress : callable, optional
            Called with (done, total) rows.
        crew : Crew, optional
            What `crew` opened; None: it is opened for this estimate.

        Raises
        ------
        InputError, SolverError, OutputError
            On unusable captures or outputs that cannot be written.
        ClusterError
            On workers that cannot be reached or do not see the capture or the output, or all die.
        """
        self.check_shared(checkpoint)
        with nullcontext(crew) if crew is not None else self.crew(capture) as found:
            return self.estimator(capture).estimate(
                capture,
                checkpoint=checkpoint,
                overwrite=overwrite,
                progress=progress,
                crew=found,
            )

    @property
    def _most(self) -> int | None:
        """Bytes of memory that an estimate may take."""
        return memory_bytes(self.memory) if isinstance(self.memory, str) else self.memory

    def _is_coherent(self, capture: Capture) -> bool:
        if self.coherent is not None:
            return self.coherent
        suits = self._why_not_coherent() is None and self.regularization != "path"
        return suits and capture.count <= WORTH_IT_UP_TO

    def _why_not_coherent(self) -> str | None:
        """What the coherent estimate does not go with, if anything."""
        if self.multi_scale:
            return "looks for light in a way of its own, not by multi-scale"
        if self.solver != "active-set":
            return f"needs the solver active-set, not {self.solver}"
        if self.signed:
            return "needs light that is not negative, not signed"
        if not self.background:
            return "needs the background, which was turned off"
        return None

    def _check_regularization(self) -> None:
        value = self.regularization
        if value == "path" and self.coherent:
            raise InputError(
                "the regularization path is for rows by themselves, not for the coherent estimate",
                hint="leave out one of the two",
            )
        if not isinstance(value, str):
            check_number(
                "a regularization",
                value,
                least=LEAST_REGULARIZATION,
                most=MOST_REGULARIZATION,
                hint="use auto, path or a positive number in units of camera sample, such as 0.3",
            )
        elif value not in ("auto", "path"):
            raise InputError(
                f"a regularization of {value!r}", hint="use auto, path or a number such as 0.3"
            )

    def _value(self, capture: Capture) -> float | None:
        if self.regularization == "path":
            return held_out_path(capture).best
        return None if isinstance(self.regularization, str) else float(self.regularization)

    def _solver(self) -> Solver:
        wanted = SOLVERS[self.solver] if self.fidelity is None else Fidelity(self.fidelity)
        limit = {} if self.iterations is None else {"max_iterations": self.iterations}
        if self.solver == "active-set":
            passes = ActiveSet.max_passes if self.iterations is None else self.iterations
            return ActiveSet(wanted, max_passes=passes)
        if self.solver == "romp":
            return ROMP(fidelity=wanted, **limit)
        if self.solver == "saturation-admm":
            return SaturationADMM(fidelity=wanted, **limit)
        if wanted is not Fidelity.LINEAR:
            raise InputError(
                f"the solver admm cannot use the fidelity {wanted}",
                hint="use the solver saturation-admm, or the fidelity linear",
            )
        return ADMM(**limit)
