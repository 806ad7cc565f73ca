"""Where an output would land, and what is never replaced, whoever wrote it."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lightmatrix.errors import OutputError

_MOUNTS = Path("/proc/self/mountinfo")
_NAMES = {
    stat.S_IFBLK: "a device",
    stat.S_IFCHR: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}
ANOTHER_NAME = "choose another name for the output"


def final_target(path: str | Path) -> Path:
    """Follow links to their end; refuse what no output may replace.

    Parameters
    ----------
    path : str or Path
        The output as it was given. Nothing is made or changed.

    Returns
    -------
    Path
        The absolute path that would be written, itself no link; nothing need exist there.

    Raises
    ------
    OutputError
        If a link leads nowhere, or there is a device, pipe, socket, mount point, the root, the home
        folder, the current folder, or a folder that holds one of these.
    """
    given = Path(path)
    with as_output_error(given):
        for part in (given, *given.parents):
            if part.is_symlink() and not part.exists():
                raise OutputError(
                    f"{part}: is a link that leads nowhere ({os.readlink(part)})",
                    hint="mend or remove the link, or choose another name for the output",
                )
        target = Path(os.path.realpath(given))
        try:
            found = os.stat(given)
        except FileNotFoundError:
            # Of new/.. too, which is there once new has been made.
            if not os.path.lexists(target):
                return target
            found = os.lstat(target)
        _check_kind(given, target, found)
        _check_place(given, target)
    return target


@contextmanager
def as_output_error(output: str | Path) -> Iterator[None]:
    """Turn the failures of the disk into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise failure(output, error) from error


def failure(output: str | Path, error: OSError, left: str = "") -> OutputError:
    """The failure of the disk in words; `left` tells what could not be cleaned up."""
    return OutputError(
        f"{output}: cannot be written ({error.strerror or error})",
        hint=f"{left}check the folder, its permissions and the free space",
    )


def mount_points() -> list[Path]:
    """The places where file systems are mounted, single files among them; as far as is known."""
    try:
        lines = _MOUNTS.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
    # Blanks in these names are written as octal numbers.
    escapes = {"\\040": " ", "\\011": "\t", "\\012": "\n", "\\134": "\\"}
    found = []
    for line in lines:
        name = line.split(" ")[4]
        for code, character in escapes.items():
            name = name.replace(code, character)
        found.append(Path(name))
    return found


def _check_kind(given: Path, target: Path, found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind not in (stat.S_IFREG, stat.S_IFDIR):
        what = _NAMES.get(kind, "no file or folder")
        raise OutputError(f"{given}: is {what}, which is never replaced", hint=ANOTHER_NAME)
    # Links of /proc lead to what has no name, such as a file that was deleted.
    if not (os.path.lexists(target) and os.path.samestat(os.lstat(target), found)):
        raise OutputError(f"{given}: leads to a file without a name", hint=ANOTHER_NAME)


def _check_place(given: Path, target: Path) -> None:
    never = [
        ("the current folder", Path(os.path.realpath(Path.cwd()))),
        ("the home folder", Path(os.path.realpath(os.path.expanduser("~")))),
        *(("a place where a disk is mounted", mounted) for mounted in mount_points()),
    ]
    if os.path.ismount(target):
        never.append(("a place where a disk is mounted", target))
    for words, place in never:
        if target == place or target in place.parents:
            verb = "is" if target == place else "holds"
            raise OutputError(
                f"{given}: {verb} {words}, which is never replaced", hint=ANOTHER_NAME
            )
