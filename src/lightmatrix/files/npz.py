"""NumPy's archives (npz): what they announce is known before any of it is inflated."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.npy import Header, read_header, read_values
from lightmatrix.files.reading import regular_file
from lightmatrix.resources.memory import check_room

# As `numpy.savez` and `savez_compressed` write them.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# More than any npz of ours by far; each costs a header to be read.
_MOST_MEMBERS = 1000
_SUFFIX = ".npy"


def read_npz(
    path: str | Path, check: Callable[[Mapping[str, Header]], None] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of an npz file, each whole, with the checksums of the archive.

    Parameters
    ----------
    path : str or Path
        The file.
    check : callable, optional
        Is given the headers of all arrays by name, before any array is read, and may refuse them:
        where some arrays say how large the others have to be.

    Raises
    ------
    InputError
        If it is no regular file, no whole archive, has a member twice, Python objects, sizes that
        contradict each other, or announces more than fits into memory.
    """
    file = regular_file(path)
    with _explained(file), zipfile.ZipFile(file) as archive:
        members = _members(archive)
        headers = {name: _header(archive, member) for name, member in members.items()}
        if check is not None:
            check(headers)
        check_room(file, sum(header.bytes for header in headers.values()))
        found = {}
        for name, member in members.items():
            with archive.open(member) as stream:
                found[name] = read_values(stream, read_header(stream))
        return found


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    if len(entries) > _MOST_MEMBERS:
        raise ValueError(f"an archive of {len(entries)} members")
    members = {}
    for entry in entries:
        name = entry.filename.removesuffix(_SUFFIX)
        if name == entry.filename or entry.compress_type not in _METHODS or entry.flag_bits & 1:
            raise ValueError("a member that NumPy has not written")
        if name in members:
            raise ValueError(f"{name[:40]!r} stands there twice")
        members[name] = entry
    return members


def _header(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Header:
    with archive.open(member) as stream:
        header = read_header(stream)
        if header.bytes != member.file_size - stream.tell():
            raise ValueError(f"the size of {member.filename[:40]!r} does not fit its header")
        return header


@contextmanager
def _explained(file: Path) -> Iterator[None]:
    try:
        yield
    except (InputError, MemoryError):
        raise
    # Damaged archives raise nearly anything, among them NotImplementedError and zlib.error.
    except Exception as error:
        raise InputError(
            f"{file}: cannot be read as npz ({' '.join(str(error).split())[:120]})",
            hint="give a file from `lightmatrix export` or `render`, or write it again",
        ) from error
