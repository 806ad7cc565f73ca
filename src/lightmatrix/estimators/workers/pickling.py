"""An estimate as bytes for other processes: its parameters, and where the frames lie."""

from __future__ import annotations

import io
import os
import pickle
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.estimators.work import Work


def pack_work(work: Work) -> bytes:
    """An estimate as bytes: absolute paths of frames in files, frames in memory, no caches."""
    stream = io.BytesIO()
    try:
        _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(work)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            f"the estimate cannot be sent to workers ({error})",
            hint="put your own solver into a module that workers can import",
        ) from error
    return stream.getvalue()


def unpack_work(data: bytes) -> Work:
    """The estimate that `pack_work` packed. Bytes from elsewhere may run any program."""
    work: Work = pickle.loads(data)
    return work


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Path):
            return Path, (os.path.abspath(obj),)
        if is_dataclass(obj) and not isinstance(obj, type):
            kind = type(obj)
            if kind.__module__.startswith("lightmatrix."):
                return _rebuild, (kind, {part.name: _value(obj, part) for part in fields(obj)})
        return NotImplemented


def _value(obj: Any, part: Field[Any]) -> Any:
    """The value of a field. A private field with a default factory is a cache and starts empty."""
    if part.name.startswith("_") and part.default_factory is not MISSING:
        return part.default_factory()
    return getattr(obj, part.name)


def _rebuild(kind: type, values: dict[str, Any]) -> Any:
    # The constructor is not called: what it checks or converts was checked in the first process.
    instance: Any = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance
