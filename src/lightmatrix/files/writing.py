"""Writes outputs that are either whole or absent, and that replace only what lightmatrix wrote.

An output is written in a temporary folder beside it, ``.NAME.part``, and renamed when it is whole.
An old output stays until then. A file is replaced in one step. A folder takes two: the old one is
moved into the temporary folder, and the new one takes its place. The next run that writes the same
output removes what a killed run left in ``.NAME.part``, and puts an old folder back that a run was
killed beside.

Meanwhile the output is locked, so that one thread of one process writes it at a time. The operating
system holds the lock on ``.NAME.lock``, so that it ends with its owner, however that ends.
"""

import errno
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from lightmatrix.errors import OutputError, warn
from lightmatrix.files.kinds import ANOTHER_NAME, MARKER, FolderKind, OutputKind
from lightmatrix.paths import as_path

# The first line of the marker of a folder of running results (`running.py`).
RUNNING = "lightmatrix running results"
# The errors of file systems without locks, some network file systems among them.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}


def check_output(path: str | Path | None, kind: OutputKind, *, overwrite: bool = False) -> None:
    """Check that an output may be written, if there is one, and make nothing.

    An empty folder may always be replaced, other outputs of this kind with `overwrite`. An
    OutputError refuses a wrong ending, anything else there, and a folder without write access.
    """
    if path is None:
        return
    output = as_path(path)
    if kind.suffixes and output.suffix.lower() not in kind.suffixes:
        raise OutputError(
            f"{output}: the name of the output ends in {output.suffix or 'nothing'}",
            hint=f"end it in {' or '.join(kind.suffixes)}",
        )
    target = final_target(output)
    with as_output_error(output):
        if os.path.lexists(target) and kind.check_replaceable(output, target) and not overwrite:
            hint = "pass overwrite=True to replace it, or choose a new name"
            raise OutputError(f"{output}: exists already", hint=hint)
        if kind.running:
            check_running(target, kind.running)
        parent = next(folder for folder in target.parents if os.path.lexists(folder))
        if not parent.is_dir():
            hint = "choose another folder"
            raise OutputError(f"{output}: cannot be written ({parent} is not a folder)", hint=hint)
        if not os.access(parent, os.W_OK | os.X_OK):
            raise OutputError(
                f"{output}: cannot be written (no permission to write in {parent})",
                hint="choose another folder, or change its permissions",
            )


def final_target(path: str | Path) -> Path:
    """Follow an output's links to the absolute path that would be written, without making it.

    An OutputError says if a link leads nowhere, or there is a device, pipe, socket, mount point, or
    a folder that holds the home or current folder.
    """
    output = as_path(path)
    with as_output_error(output):
        for part in (output, *output.parents):
            if part.is_symlink() and not part.exists():
                raise OutputError(
                    f"{part}: is a link that leads nowhere ({os.readlink(part)})",
                    hint="mend or remove the link, or choose another name for the output",
                )
        target = Path(os.path.realpath(output))
        problem = ""
        if output.exists() and not (output.is_file() or output.is_dir()):
            problem = "is a device, a pipe or a socket"
        elif os.path.ismount(target):
            problem = "is a place where a disk is mounted"
        for words, place in (("current", "."), ("home", os.path.expanduser("~"))):
            if target in (real := Path(os.path.realpath(place)), *real.parents):
                problem = f"{'is' if target == real else 'holds'} the {words} folder"
        if problem:
            raise OutputError(f"{output}: {problem}, which is never replaced", hint=ANOTHER_NAME)
    return target


def check_running(target: Path, ending: str) -> Path:
    """The folder of an output's running results, not made; an OutputError if it is not ours."""
    folder = target.with_name(target.name + ending)
    with as_output_error(folder):
        if not os.path.lexists(folder):
            return folder
        if folder.is_dir() and not folder.is_symlink():
            marker = folder / MARKER
            # A run that was killed before it had written its marker has kept nothing.
            if all(entry == marker and not marker.lstat().st_size for entry in folder.iterdir()):
                return folder
            if marker.is_file() and not marker.is_symlink():
                with marker.open("rb") as opened:
                    if opened.readline().strip() == RUNNING.encode():
                        return folder
    raise OutputError(
        f"{folder}: stands where the running results would go, and was not written by lightmatrix",
        hint="move it elsewhere, or choose another name for the output",
    )


@contextmanager
def locked(target: Path) -> Iterator[bool]:
    """Hold the lock of an output, not a link; a thread that holds it may take it again.

    Yields whether the lock is new and works, so that what lies half-written beside the output
    belongs to no living process. An OutputError says that another process or thread holds it.
    """
    file = target.with_name(f".{target.name}.lock")
    # filelock keeps one object for each path while it is held, which counts for each thread. It
    # tries for 0.2 s, since a process that has just been killed may hold the lock for a moment.
    lock = FileLock(
        file, timeout=0.2, poll_interval=0.01, is_singleton=True, fallback_to_soft=False
    )
    with as_output_error(target):
        if os.path.lexists(file) and (
            file.is_symlink() or not file.is_file() or file.stat().st_size
        ):
            raise OutputError(
                f"{file}: is in the way of a lock and was not written by lightmatrix",
                hint="move it elsewhere, or choose another name for the output",
            )
        # Where no file can be made, such as in /proc, filelock would wait in vain.
        file.touch()
        try:
            lock.acquire()
        except Timeout:
            hint = "wait for it to end, or choose another name for the output"
            raise OutputError(f"{target}: is being written by another process", hint=hint) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            file.unlink(missing_ok=True)
            warn(f"{target}: its file system has no locks; make sure that nothing else writes it")
    try:
        yield lock.lock_counter == 1
    finally:
        # On Windows filelock removes the file; elsewhere it must be removed while it is locked, or
        # a process that has just locked it would lose it. A forked child does not hold the lock.
        if sys.platform != "win32" and lock.is_locked and lock.lock_counter == 1:
            file.unlink(missing_ok=True)
        lock.release()


@contextmanager
def claimed(path: str | Path, kind: OutputKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Hold an output for this thread: checked, its parent folders made, locked.

    What killed runs left of it is put back or removed, and new parent folders that stay empty too.
    """
    check_output(path, kind, overwrite=overwrite)
    target = final_target(path)
    made = [folder for folder in target.parents if not os.path.lexists(folder)]
    try:
        with as_output_error(path):
            target.parent.mkdir(parents=True, exist_ok=True)
        with locked(target) as is_new:
            if is_new:
                with as_output_error(path):
                    _restore_leftovers(target)
                # Another run may have written it between the check and the lock.
                check_output(path, kind, overwrite=overwrite)
            yield target
    finally:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def atomic_file(path: str | Path, kind: OutputKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Write a file at a temporary path with the same ending, which becomes `path` on success."""
    with atomic_files({path: kind}, overwrite=overwrite) as (part,):
        yield part


@contextmanager
def atomic_files(
    kinds: Mapping[Any, OutputKind], *, overwrite: bool = False
) -> Iterator[list[Path]]:
    """Write files at temporary paths; all take their places, or none, which would be in the way."""
    with ExitStack() as stack:
        targets, parts = [], []
        for path, kind in kinds.items():
            target = stack.enter_context(claimed(path, kind, overwrite=overwrite))
            place = stack.enter_context(temporary(path, target))
            targets.append(target)
            # In lower case, for writers that choose the format by it or append their own.
            parts.append(place / f"new{Path(path).suffix.lower()}")
        yield parts
        for part in parts:
            with part.open("rb+") as written:
                os.fsync(written.fileno())
        for path, kind in kinds.items():
            check_output(path, kind, overwrite=overwrite)
        placed: list[Path] = []
        try:
            for target, part in zip(targets, parts, strict=True):
                # If this is stopped, the old files come back; see `_remove_temporary`.
                if len(parts) > 1:
                    if os.path.lexists(target):
                        os.rename(target, part.with_name("old"))
                    placed.append(target)
                os.replace(part, target)
        except BaseException:
            for target in placed:
                target.unlink(missing_ok=True)
            raise


@contextmanager
def atomic_folder(path: str | Path, kind: FolderKind, *, overwrite: bool = False) -> Iterator[Path]:
    """Fill and mark a temporary folder, which replaces the folder at `path` once it is whole."""
    with claimed(path, kind, overwrite=overwrite) as target, temporary(path, target) as place:
        part = place / "new"
        part.mkdir()
        yield part
        kind.mark(part)
        # Somebody may have put a file into the old folder meanwhile.
        check_output(path, kind, overwrite=overwrite)
        if os.path.lexists(target):
            os.rename(target, place / "old")
        os.rename(part, target)


@contextmanager
def as_output_error(output: str | Path) -> Iterator[None]:
    """Turn failures of the disk into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{output}: cannot be written ({error.strerror or error})",
            hint="check the folder, its permissions and the free space",
        ) from error


@contextmanager
def temporary(shown: str | Path, target: Path) -> Iterator[Path]:
    """The temporary folder of an output, removed in any case."""
    place = _temporary_folder(target)
    with as_output_error(shown):
        # One that exists belongs to a claim around this one, so making it fails.
        place.mkdir()
        try:
            yield place
        except KeyboardInterrupt:
            # A thread of Zarr may still write a file, for which it would make the folder again.
            time.sleep(0.1)
            raise
        finally:
            with suppress(OSError):
                _remove_temporary(target)


def _restore_leftovers(target: Path) -> None:
    """Put back or remove what a killed run left beside an output whose lock is ours."""
    place = _temporary_folder(target)
    if not os.path.lexists(place):
        return
    ours = place.is_dir() and not place.is_symlink()
    if not ours or {entry.stem for entry in place.iterdir()} - {"new", "old"}:
        hint = "move it elsewhere, or choose another name for the output"
        raise OutputError(f"{place}: is in the way and was not made by lightmatrix", hint=hint)
    _remove_temporary(target)


def _remove_temporary(target: Path) -> None:
    """Remove the temporary folder, but put back an old folder that has no successor yet."""
    place = _temporary_folder(target)
    if os.path.lexists(place / "old") and not os.path.lexists(target):
        os.rename(place / "old", target)
    shutil.rmtree(place, ignore_errors=True)


def _temporary_folder(target: Path) -> Path:
    return target.with_name(f".{target.name}.part")
