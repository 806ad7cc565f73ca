"""Files that are read: regular ones only, of a sane size, and none outside their folder.

A pipe hangs, a device never ends, and a link in a folder from elsewhere may lead anywhere.
"""

from __future__ import annotations

import stat
from pathlib import Path

from lightmatrix.errors import InputError

# No description, curve or header that we read comes near it.
MOST_TEXT = 16 << 20


def regular_file(path: str | Path) -> Path:
    """The path, if it names a regular file or a link to one.

    Raises
    ------
    InputError
        If nothing is there, or a folder, a pipe, a device, a socket or a link that leads nowhere.
    """
    file = Path(path)
    try:
        mode = file.stat().st_mode
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError) and file.is_symlink():
            raise InputError(
                f"{file}: is a link that leads nowhere", hint="restore what it led to, or remove it"
            ) from error
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            raise InputError(f"{file}: no such file", hint="check the name") from error
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be opened ({reason})", hint="check the name") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{file}: is a folder, not a file", hint="give a file")
    if not stat.S_ISREG(mode):
        raise InputError(
            f"{file}: is a pipe or device, not a file", hint="copy its content to a file"
        )
    return file


def read_bytes(path: str | Path, most: int = MOST_TEXT) -> bytes:
    """The content of a regular file of at most `most` bytes.

    Raises
    ------
    InputError
        If it is none, is larger, or cannot be read.
    """
    file = regular_file(path)
    try:
        with file.open("rb") as stream:
            content = stream.read(most + 1)
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror or error})", hint="check its permissions"
        ) from error
    if len(content) > most:
        raise InputError(
            f"{file}: is larger than {most / 2**20:g} MiB", hint="is it the file that was meant?"
        )
    return content


def read_text(path: str | Path, most: int = MOST_TEXT) -> str:
    """The text of a regular file, UTF-8 with or without byte order mark.

    Raises
    ------
    InputError
        As for `read_bytes`, and if it is no text. The message does not quote the content, which
        may be none of the caller's business.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: cannot be read as text (byte {error.start} is not UTF-8)",
            hint="save it as UTF-8",
        ) from error


def within(folder: Path, name: str, source: Path) -> Path:
    """A file that a description names, which must lie in the description's folder.

    Parameters
    ----------
    folder : Path
        Where it must lie, links followed to their ends.
    name : str
        As the description names it, relative to the folder.
    source : Path
        The description, for the message.

    Raises
    ------
    InputError
        If the name leads out of the folder.
    """
    try:
        target = (folder / name).resolve()
        inside = target.is_relative_to(folder.resolve())
    # A loop of links, or a name with a zero in it.
    except (OSError, RuntimeError, ValueError):
        inside = False
    if not name or Path(name).is_absolute() or not inside:
        raise InputError(
            f"{source}: names {name!r}, which lies outside its folder",
            hint="copy the file into the folder; in Python, allow_outside=True permits it",
        )
    return folder / name
