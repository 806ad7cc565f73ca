"""JSON files of our own, each with its format and version, and strict parsing of any JSON."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.files.reading import read_text


def read_json(file: Path, kind: str, version: int) -> dict[str, Any]:
    """Read one of our JSON files and check its format and version."""
    content = parse_json(read_text(file), str(file))
    if not isinstance(content, dict) or content.get("format") != kind:
        raise InputError(f"{file}: is not a {kind} file", hint=f'its "format" must be "{kind}"')
    stored = content.get("version")
    # True equals 1, but is no version.
    if type(stored) is not int or stored != version:
        raise InputError(
            f"{file}: has format version {str(stored)[:20]}, this lightmatrix reads {version}",
            hint="update lightmatrix, or write the file again",
        )
    return content


def parse_json(text: str, name: str, *, finite: bool = True) -> Any:
    """Parse JSON strictly: no key twice, no endless nesting, only finite numbers if `finite`."""
    try:
        return json.loads(
            text,
            parse_constant=_refuse_constant if finite else None,
            parse_float=_finite if finite else None,
            object_pairs_hook=_distinct,
        )
    except RecursionError as error:
        raise InputError(
            f"{name}: cannot be read (nested too deeply)", hint="restore it, or remove it"
        ) from error
    except ValueError as error:
        raise InputError(
            f"{name}: cannot be read ({str(error)[:120]})", hint="restore it, or remove it"
        ) from error


@contextmanager
def errors_naming(file: Path) -> Iterator[None]:
    """Put the name of a file before messages about its values, unless they name a file already."""
    try:
        yield
    except InputError as error:
        if os.path.exists(error.message.partition(": ")[0]):
            raise
        raise InputError(f"{file}: {error.message}", hint=error.hint) from error


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is not a number in JSON")


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError("a number is too large")
    return value


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key appears twice")
    return content
