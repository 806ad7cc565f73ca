"""Where an output would be written, and the places that no output ever replaces."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lightmatrix.errors import OutputError

_MOUNTS = Path("/proc/self/mountinfo")
# How the kernel writes blanks, tabs, line breaks and backslashes in names of mount points.
_ESCAPES = {"\\040": " ", "\\011": "\t", "\\012": "\n", "\\134": "\\"}
_SPECIAL_FILES = {
    stat.S_IFBLK: "a device",
    stat.S_IFCHR: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}
ANOTHER_NAME = "choose another name for the output"


def final_target(path: str | Path) -> Path:
    """Follow an output's links to the absolute path that would be written, without making it.

    An OutputError says if a link leads nowhere, or there is a device, pipe, socket, mount point, or
    a folder that holds the home or current folder.
    """
    output = Path(path)
    with as_output_error(output):
        for part in (output, *output.parents):
            if part.is_symlink() and not part.exists():
                raise OutputError(
                    f"{part}: is a link that leads nowhere ({os.readlink(part)})",
                    hint="mend or remove the link, or choose another name for the output",
                )
        target = Path(os.path.realpath(output))
        try:
            status = os.stat(output)
        except FileNotFoundError:
            # A path such as new/.. exists once new has been made.
            if not os.path.lexists(target):
                return target
            status = os.lstat(target)
        _check_kind(output, target, status)
        _check_place(output, target)
    return target


@contextmanager
def as_output_error(output: str | Path) -> Iterator[None]:
    """Turn failures of the disk into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise disk_failure(output, error) from error


def disk_failure(output: str | Path, error: OSError, left: str = "") -> OutputError:
    """The error for a failure of the disk; `left` says what could not be cleaned up."""
    return OutputError(
        f"{output}: cannot be written ({error.strerror or error})",
        hint=f"{left}check the folder, its permissions and the free space",
    )


def mount_points() -> list[Path]:
    """The places where file systems are mounted, as far as known; some are single files."""
    try:
        lines = _MOUNTS.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
    places = []
    for line in lines:
        name = line.split(" ")[4]
        for code, character in _ESCAPES.items():
            name = name.replace(code, character)
        places.append(Path(name))
    return places


def _check_kind(output: Path, target: Path, status: os.stat_result) -> None:
    kind = stat.S_IFMT(status.st_mode)
    if kind not in (stat.S_IFREG, stat.S_IFDIR):
        what = _SPECIAL_FILES.get(kind, "no file or folder")
        raise OutputError(f"{output}: is {what}, which is never replaced", hint=ANOTHER_NAME)
    # Links of /proc lead to files without a name, such as those that were deleted.
    if not (os.path.lexists(target) and os.path.samestat(os.lstat(target), status)):
        raise OutputError(f"{output}: leads to a file without a name", hint=ANOTHER_NAME)


def _check_place(output: Path, target: Path) -> None:
    protected = [
        ("the current folder", Path(os.path.realpath(Path.cwd()))),
        ("the home folder", Path(os.path.realpath(os.path.expanduser("~")))),
        *(("a place where a disk is mounted", mounted) for mounted in mount_points()),
    ]
    if os.path.ismount(target):
        protected.append(("a place where a disk is mounted", target))
    for words, place in protected:
        if target == place or target in place.parents:
            verb = "is" if target == place else "holds"
            raise OutputError(
                f"{output}: {verb} {words}, which is never replaced", hint=ANOTHER_NAME
            )
