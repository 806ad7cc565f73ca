"""An estimate as bytes that other processes make it from: parameters, and where the frames lie."""

from __future__ import annotations

import io
import os
import pickle
from collections.abc import Callable
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.estimators.steps import Work

_OURS = "lightmatrix."


def packed(work: Work) -> bytes:
    """An estimate as bytes.

    Frames in files are named by their absolute paths; those in memory go along. What was worked out
    already (decoded samples, prepared patterns) stays behind: the other process does so for itself.

    Raises
    ------
    InputError
        If it holds what only exists in this process.
    """
    stream = io.BytesIO()
    try:
        _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(work.silent())
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"the estimate cannot be sent to workers ({error})",
            hint="solvers of your own must be in a module that workers can import",
        ) from error
    return stream.getvalue()


def unpacked(data: bytes) -> Work:
    """The estimate of `packed`; of nobody else, for a pickle may be any program."""
    work: Work = pickle.loads(data)
    return work


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Path):
            return Path, (os.path.abspath(obj),)
        if is_dataclass(obj) and not isinstance(obj, type):
            kind = type(obj)
            if kind.__module__.startswith(_OURS):
                return _made, (kind, {part.name: _value(obj, part) for part in fields(obj)})
        return NotImplemented


def _value(obj: Any, part: Field[Any]) -> Any:
    """A field; one that keeps what was worked out, by its underscore, begins anew."""
    factory: Callable[[], Any] | Any = part.default_factory
    if part.name.startswith("_") and factory is not MISSING:
        return factory()
    return getattr(obj, part.name)


def _made(kind: type, values: dict[str, Any]) -> Any:
    made: Any = object.__new__(kind)
    # As it was: what its constructor would check or convert was so already.
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made
