"""Headers of our own files: JSON that says its format and version."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError


def read_json(file: Path, kind: str, version: int) -> dict[str, Any]:
    """Read one of our JSON files and check its format and version.

    Raises
    ------
    InputError
        If it cannot be read, is of another format, or of a later version.
    """
    try:
        content = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            f"{file}: cannot be read ({error})", hint="restore it, or remove it"
        ) from error
    if not isinstance(content, dict) or content.get("format") != kind:
        raise InputError(f"{file}: is not a {kind} file", hint=f'its "format" must be "{kind}"')
    found = content.get("version")
    if found != version:
        raise InputError(
            f"{file}: has format version {found}, this lightmatrix reads {version}",
            hint="update lightmatrix, or write the file again",
        )
    return content
