"""Reading files that may come from anywhere: bytes, text, and JSON of ours with its version.

Checked before a file is read: it is a regular one, not too large, and not outside its folder. A
pipe hangs, a device never ends, and a link in a folder from elsewhere may lead anywhere.
"""

import json
import math
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.paths import as_path

# Bytes of the longest text that is read, far more than any description or curve of ours takes.
MOST_TEXT = 16 << 20
# Values of the largest image that is read: twice those of the largest cameras. A stack of such
# frames fits into no memory.
MOST_VALUES = 1 << 28


def regular_file(path: str | Path) -> Path:
    """The path, if it names a regular file or a link to one."""
    file = as_path(path)
    try:
        mode = file.stat().st_mode
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError) and file.is_symlink():
            hint = "restore what it led to, or remove it"
            raise InputError(f"{file}: is a link that leads nowhere", hint=hint) from error
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            raise InputError(f"{file}: no such file", hint="check the name") from error
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be opened ({reason})", hint="check the name") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{file}: is a folder, not a file", hint="give a file")
    if not stat.S_ISREG(mode):
        hint = "copy its content to a file"
        raise InputError(f"{file}: is a pipe or device, not a file", hint=hint)
    return file


def read_bytes(path: str | Path, most: int = MOST_TEXT) -> bytes:
    """The content of a regular file of at most `most` bytes."""
    file = regular_file(path)
    try:
        size = file.stat().st_size
        with file.open("rb") as stream:
            # Python takes all the memory at once. Files of the system have a size of 0.
            content = stream.read(min(size or MOST_TEXT, most) + 1)
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror or error})", hint="check its permissions"
        ) from error
    if max(size, len(content)) > most:
        hint = "check that it is the right file"
        raise InputError(f"{file}: is larger than {most / 2**20:g} MiB", hint=hint)
    return content


def read_text(path: str | Path) -> str:
    """The UTF-8 text of a regular file, which errors do not quote: the caller may not see it."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: cannot be read as text (byte {error.start} is not UTF-8)",
            hint="save it as UTF-8",
        ) from error


def within(folder: Path, name: str, source: Path) -> Path:
    """The file that the description `source` names, refused if it lies outside its folder."""
    try:
        target = (folder / name).resolve()
        inside = target.is_relative_to(folder.resolve())
    # A loop of links, or a name that holds a zero byte.
    except (OSError, RuntimeError, ValueError):
        inside = False
    if not name or Path(name).is_absolute() or not inside:
        hint = "copy the file into the folder; in Python, allow_outside=True permits it"
        raise InputError(f"{source}: names {name!r}, which lies outside its folder", hint=hint)
    return folder / name


def check_image_size(file: Path, shape: Sequence[int]) -> None:
    """Refuse an image that is empty or too large, by the shape in its header."""
    if not 1 <= math.prod(shape) <= MOST_VALUES:
        hint = f"an image has at most {MOST_VALUES} values; is the file damaged?"
        raise InputError(f"{file}: announces {' x '.join(map(str, shape))} values", hint=hint)


def read_json(file: Path, kind: str, version: int) -> dict[str, Any]:
    """Read one of our JSON files and check its format and version."""
    content = parse_json(read_text(file), str(file))
    if not isinstance(content, dict) or content.get("format") != kind:
        raise InputError(f"{file}: is not a {kind} file", hint=f'its "format" must be "{kind}"')
    check_version(file, content.get("version"), version)
    return content


def check_version(file: str | Path, stored: Any, version: int) -> None:
    """Refuse a format of another version than ours."""
    # True and 1.0 equal 1, but are no versions.
    if type(stored) is not int or stored != version:
        raise InputError(
            f"{file}: has format version {str(stored)[:20]}, this lightmatrix reads {version}",
            hint="update lightmatrix, or write it again",
        )


def parse_json(text: str, name: str, *, finite: bool = True) -> Any:
    """Parse JSON; no key twice and, if `finite`, no NaN and Infinity."""
    try:
        return json.loads(
            text, parse_constant=_refuse_constant if finite else None, object_pairs_hook=_distinct
        )
    except (RecursionError, ValueError) as error:
        why = "nested too deeply" if isinstance(error, RecursionError) else str(error)[:120]
        hint = "restore it, or remove it"
        raise InputError(f"{name}: cannot be read ({why})", hint=hint) from error


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


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key appears twice")
    return content
