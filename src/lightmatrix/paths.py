"""Paths that a caller gives. This file needs no NumPy, as the help of commands does not."""

from os import PathLike
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError


def as_path(value: Any) -> Path:
    """A path; anything else than text or a path is refused."""
    if isinstance(value, str | PathLike):
        return Path(value)
    hint = "give a str or a pathlib.Path"
    raise InputError(f"{type(value).__name__} in place of a file or folder", hint=hint)
