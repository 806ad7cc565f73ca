"""The settings of an estimate, which check themselves."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import COHERENT_UP_TO
from lightmatrix.errors import InputError
from lightmatrix.ranges import check_at_least_one, check_number, check_whole
from lightmatrix.resources.memory import memory_bytes
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, Fidelity, SaturationADMM, Solver
from lightmatrix.solvers.total_variation import TotalVariation

# The solvers by name, each with the fidelity that it has unless the user asks for another, and with
# the parameter that limits its iterations.
SOLVERS: dict[str, tuple[Callable[..., Solver], Fidelity, str]] = {
    "active-set": (ActiveSet, Fidelity.ONE_SIDED, "max_passes"),
    "saturation-admm": (SaturationADMM, Fidelity.ONE_SIDED, "max_iterations"),
    "admm": (ADMM, Fidelity.LINEAR, "max_iterations"),
    "romp": (ROMP, Fidelity.REJECTION, "max_iterations"),
    "total-variation": (TotalVariation, Fidelity.ONE_SIDED, "max_iterations"),
}
# The largest number of iterations that an estimate accepts. It is beyond what anybody can wait for
# and fits into 32 bits.
MOST_ITERATIONS = 1_000_000_000
# The range of regularizations that an estimate accepts, in units of camera sample. Chosen by hand:
# float32 samples in any unit lie well within it.
LEAST_REGULARIZATION, MOST_REGULARIZATION = 1e-20, 1e20


@dataclass(frozen=True)
class EstimateSettings:
    """How T is estimated; the parameters are those of `estimate`, which explains them.

    Raises
    ------
    InputError, SolverError
        If a parameter is out of range or two of them exclude each other.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.EstimateSettings(solver="romp").fidelity is None
    True
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
            hint = f"use one of {', '.join(SOLVERS)}"
            raise InputError(f"there is no solver {self.solver!r}", hint=hint)
        if self.fidelity is not None and self.fidelity not in list(Fidelity):
            hint = f"use one of {', '.join(Fidelity)}"
            raise InputError(f"there is no fidelity {self.fidelity!r}", hint=hint)
        if self.iterations is not None:
            hint = f"use 1 to {MOST_ITERATIONS}"
            check_whole("iterations", self.iterations, most=MOST_ITERATIONS, hint=hint)
        check_at_least_one(tile_rows=self.tile_rows)
        given = {"tile rows": self.tile_rows, "a memory limit": self.memory}
        # The multi-scale estimate solves strips of camera blocks.
        given["the multi-scale estimate"] = self.multi_scale or None
        names = [name for name, value in given.items() if value is not None]
        if len(names) > 1:
            raise InputError(" and ".join(names), hint="leave out one of the two")
        limit = self.memory_limit
        if limit is not None and limit < 1:
            raise InputError(f"a memory limit of {limit} bytes", hint="give one such as 4GiB")
        if self.workers is not None and self.cluster is not None:
            raise InputError("workers here and a cluster", hint="leave out one of the two")
        check_at_least_one(workers=self.workers)
        value = self.regularization
        if not isinstance(value, str):
            check_number(
                "a regularization", value, least=LEAST_REGULARIZATION, most=MOST_REGULARIZATION,
                hint="use auto or a positive number in units of camera sample, such as 0.3",
            )  # fmt: skip
        elif value != "auto":
            hint = "use auto or a number such as 0.3"
            raise InputError(f"a regularization of {value!r}", hint=hint)
        reason = self._reason_against_coherent
        if self.coherent and reason is not None:
            raise InputError(f"the coherent estimate {reason}", hint="leave out one of the two")
        if self.multi_scale and self.solver == "total-variation":
            hint = "leave out one of the two"
            raise InputError(
                "total variation cannot be estimated in blocks (multi-scale)", hint=hint
            )
        _ = self.row_solver  # Checks that solver and fidelity fit each other.

    @cached_property
    def row_solver(self) -> Solver:
        """The solver with its fidelity and iteration limit."""
        solver, usual, limit = SOLVERS[self.solver]
        fidelity = usual if self.fidelity is None else Fidelity(self.fidelity)
        limits = {} if self.iterations is None else {limit: self.iterations}
        if solver not in (ADMM, TotalVariation):
            return solver(fidelity=fidelity, **limits)
        if fidelity is not usual:
            other = ", or the solver saturation-admm" if solver is ADMM else ""
            hint = f"use the fidelity {usual}{other}"
            message = f"the solver {self.solver} cannot use the fidelity {fidelity}"
            raise InputError(message, hint=hint)
        return solver(**limits)

    @property
    def memory_limit(self) -> int | None:
        """Bytes of memory that the estimate may take; None: no limit."""
        return memory_bytes(self.memory) if isinstance(self.memory, str) else self.memory

    def is_coherent(self, capture: Capture) -> bool:
        """Whether the camera pixels of a capture learn from their neighbours."""
        if self.coherent is not None:
            return self.coherent
        return self._reason_against_coherent is None and capture.count <= COHERENT_UP_TO

    @property
    def may_be_direct(self) -> bool:
        """Whether T may be read from patterns that determine it, if nothing else is asked for."""
        left_open = self.coherent is None and self.fidelity is None and self.iterations is None
        return left_open and self.regularization == "auto" and not (self.signed or self.multi_scale)

    @property
    def _reason_against_coherent(self) -> str | None:
        """Why these settings exclude the coherent estimate; None if they do not."""
        if self.multi_scale:
            return "looks for light in its own way, not by multi-scale"
        if self.solver != "active-set":
            return f"needs the solver active-set, not {self.solver}"
        if self.signed:
            return "needs light that is not negative, not signed"
        if not self.background:
            return "needs the background, which was turned off"
        return None
