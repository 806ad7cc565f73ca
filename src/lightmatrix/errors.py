"""The errors and warnings that lightmatrix raises, each with a hint at what would work."""

import sys
import warnings
from typing import Any

_PACKAGE = __name__.split(".")[0]


class LightMatrixError(Exception):
    """Base of every error that lightmatrix raises on purpose.

    Parameters
    ----------
    message : str
        What was wrong and where (file, frame, row).
    hint : str, optional
        What would work. Shown on its own line by the command line.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> try:
    ...     lm.BernoulliPatterns((8, 8), count=0)
    ... except lm.InputError as error:
    ...     print(error.message, "-", error.hint)
    0 patterns - ask for at least 1, and at most 1000000
    """

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message if hint is None else f"{message}\n  {hint}")
        self.message = message
        self.hint = hint

    def __reduce__(self) -> tuple[Any, ...]:
        # A worker process returns errors in a pickle, which passes no keywords.
        return _rebuild, (type(self), self.message, self.hint)


class InputError(LightMatrixError):
    """The input is unusable: wrong shape, wrong range, unreadable or contradictory."""


class OutputError(LightMatrixError):
    """The output cannot be written: it exists, is not writable, or the disk is full."""


class MissingExtraError(LightMatrixError):
    """An optional part is not installed; the hint names the extra that brings it."""


class ClusterError(LightMatrixError):
    """Worker processes cannot be reached, do not match this process, or keep dying."""


class SolverError(LightMatrixError):
    """A solver cannot solve this problem, or its numbers became infinite."""


class DeviceError(LightMatrixError):
    """A projector or a camera is missing, in use, disconnected, or does not do what it should."""


class FrameTimeoutError(DeviceError):
    """The camera delivered no frame in time."""


class LightMatrixWarning(UserWarning):
    """The input is usable but probably not what the user meant; the message says what to check."""


def warn(message: str) -> None:
    """Warn by a `LightMatrixWarning` that points to the user's line, not to one of this package."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, LightMatrixWarning, stacklevel=level)


def lacks_memory(error: BaseException) -> bool:
    """Whether memory ran out: for objects, a thread, a decoder, or a library that is loaded."""
    words = str(error)
    # What Linux says of a library that finds no room in memory.
    signs = ("failed to map segment", "annot allocate memory", "cannot map zero-fill")
    loading = isinstance(error, ImportError) and any(sign in words for sign in signs)
    # The words of Python for threads, and of the decoders of images.
    said = "can't start new thread" in words or "out of memory" in words
    return isinstance(error, MemoryError) or loading or said


def _rebuild(kind: type[LightMatrixError], message: str, hint: str | None) -> LightMatrixError:
    return kind(message, hint=hint)
