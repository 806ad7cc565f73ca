"""Writes outputs that are either whole or absent, and that replace only what lightmatrix wrote.

An output is written in a temporary folder beside it, ``.NAME.part``, and renamed when it is whole.
An old output stays until then. A file is replaced in one step. A folder changes places with the new
one in one step, or is moved into the temporary folder first where the file system cannot do that.
Meanwhile the output is locked (`locks.py`). The next run that writes the same output removes what a
killed run left in ``.NAME.part``, and puts an old folder back that was moved there.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lightmatrix.errors import OutputError
from lightmatrix.outputs.locks import check_unlocked, locked
from lightmatrix.outputs.markers import MARKER, FolderKind, OutputKind, read_object
from lightmatrix.outputs.running import check_running
from lightmatrix.outputs.swap import put_in_place
from lightmatrix.outputs.targets import as_output_error, disk_failure, final_target

TEMPORARY = "lightmatrix-temporary"
# The name that a replaced folder gets inside the temporary one, where two folders cannot be
# exchanged in one step.
_OLD = "old"


def check_output(path: str | Path, kind: OutputKind, *, overwrite: bool = False) -> Path:
    """Check that an output may be written, make nothing, and return where its links lead.

    An empty folder may always be replaced, other outputs of this kind with `overwrite`. An
    OutputError refuses a wrong ending, anything else there, a locked output, and a folder without
    write access.
    """
    output = Path(path)
    if kind.suffixes and output.suffix.lower() not in kind.suffixes:
        raise OutputError(
            f"{output}: the name of the output ends in {output.suffix or 'nothing'}",
            hint=f"end it in {' or '.join(kind.suffixes)}",
        )
    target = final_target(output)
    with as_output_error(output):
        check_unlocked(target)
        if os.path.lexists(target) and kind.check_replaceable(output, target) and not overwrite:
            raise OutputError(
                f"{output}: exists already",
                hint="add --overwrite to replace it, or choose a new name",
            )
        if kind.running:
            check_running(target, kind.running)
        _check_parent(output, target)
    return target


@contextmanager
def claimed(path: str | Path, kind: OutputKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Hold an output for this thread: checked, its parent folders made, locked.

    What killed runs left of it is put back or removed, and new parent folders that stay empty too.
    """
    target = check_output(path, kind, overwrite=overwrite)
    made: list[Path] = []
    try:
        with as_output_error(path):
            _make_parents(target.parent, made)
        with locked(target) as is_new:
            if is_new:
                with as_output_error(path):
                    _restore_leftovers(target)
                # Another run may have written it between the check and the lock.
                check_output(path, kind, overwrite=overwrite)
            yield target
    finally:
        for folder in reversed(made):
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def atomic_file(path: str | Path, kind: OutputKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Write a file at a temporary path with the same ending, which becomes `path` on success."""
    with claimed(path, kind, overwrite=overwrite) as target, _temporary(path, target) as place:
        # In lower case, for writers that choose the format by it or append their own.
        part = place / f"new{Path(path).suffix.lower()}"
        yield part
        with part.open("rb+") as written:
            os.fsync(written.fileno())
        check_output(path, kind, overwrite=overwrite)
        os.replace(part, target)


@contextmanager
def atomic_folder(path: str | Path, kind: FolderKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Fill and mark a temporary folder, which replaces the folder at `path` once it is whole."""
    with claimed(path, kind, overwrite=overwrite) as target, _temporary(path, target) as place:
        part = place / "new"
        part.mkdir()
        yield part
        kind.mark(part)
        # Somebody may have put a file into the old folder meanwhile.
        check_output(path, kind, overwrite=overwrite)
        put_in_place(part, target, place / _OLD)


@contextmanager
def _temporary(shown: str | Path, target: Path) -> Iterator[Path]:
    """The temporary folder of an output, marked as such and removed in any case."""
    place = _temporary_folder(target)
    # One that exists belongs to a claim around this one, so making it fails.
    ours = not os.path.lexists(place)
    try:
        with as_output_error(shown):
            place.mkdir()
        content = {"format": TEMPORARY, "version": 1, "output": target.name}
        (place / MARKER).write_text(json.dumps(content) + "\n")
        yield place
    except OSError as error:
        raise disk_failure(shown, error, _remove_temporary(place)) from error
    finally:
        if ours:
            _remove_temporary(place)


def _remove_temporary(place: Path) -> str:
    """Remove a temporary folder and say whether that went well."""
    with suppress(OSError):
        # The marker goes last, so that what is left of a temporary folder is recognized as one.
        for name in set(os.listdir(place)) - {MARKER}:
            path = place / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        (place / MARKER).unlink(missing_ok=True)
        place.rmdir()
    if os.path.lexists(place):
        return f"{place} could not be removed, the next run of this output will try again; "
    return "nothing was left behind; "


def _restore_leftovers(target: Path) -> None:
    """Put back or remove what a killed run left beside an output whose lock is ours."""
    place = _temporary_folder(target)
    if not os.path.lexists(place):
        return
    if not _is_temporary(place):
        raise OutputError(
            f"{place}: is in the way and was not made by lightmatrix",
            hint="move it elsewhere, or choose another name for the output",
        )
    if os.path.lexists(place / _OLD) and not os.path.lexists(target):
        os.rename(place / _OLD, target)
    _remove_temporary(place)


def _is_temporary(place: Path) -> bool:
    if place.is_symlink() or not place.is_dir():
        return False
    content = read_object(place / MARKER)
    if content is None:
        # A run that was killed before it had written the marker had written nothing else.
        inside = list(place.iterdir())
        return not inside or (inside == [place / MARKER] and not inside[0].stat().st_size)
    return content.get("format") == TEMPORARY


def _temporary_folder(target: Path) -> Path:
    return target.with_name(f".{target.name}.part")


def _check_parent(output: Path, target: Path) -> None:
    """Check that the first folder that exists above an output can be written to."""
    parent = next(folder for folder in target.parents if os.path.lexists(folder))
    if not parent.is_dir():
        raise OutputError(f"{output}: cannot be written ({parent} is not a folder)")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"{output}: cannot be written (no permission to write in {parent})",
            hint="choose another folder, or change its permissions",
        )


def _make_parents(folder: Path, made: list[Path]) -> None:
    """Make the folders that are missing above an output, and note those that were made here."""
    missing = []
    while not os.path.lexists(folder):
        missing.append(folder)
        folder = folder.parent
    for place in reversed(missing):
        try:
            place.mkdir()
        except FileExistsError:
            continue  # Another run has just made it.
        made.append(place)
