"""Outputs that are either whole or absent: write to a temporary sibling, then rename."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lightmatrix.errors import OutputError

# A folder that holds one of these was written by us and may be replaced by us.
MARKERS = frozenset(
    {
        "capture.json",
        "patterns.json",
        "zarr.json",
        "scenes.json",
        "demo.json",
        "fig4.json",
        "fig5.json",
        "fig6.json",
        "fig7.json",
    }
)


def check_output(
    path: str | Path,
    *,
    overwrite: bool = False,
    suffixes: tuple[str, ...] | None = None,
) -> Path:
    """Whether an output may be written, asked before any work is done.

    Parameters
    ----------
    path : str or Path
        The output, a file or a folder. Missing parent folders are created.
    overwrite : bool
        Whether an existing output may be replaced. Of folders only our own are (and empty ones,
        in any case), so that no slip of the pen deletes a folder of photographs.
    suffixes : tuple of str, optional
        Permitted endings, such as (".npz", ".mat").

    Returns
    -------
    Path
        The output.

    Raises
    ------
    OutputError
        If it ends otherwise, exists, or its folder cannot be written to.
    """
    target = Path(path)
    if suffixes is not None and target.suffix.lower() not in suffixes:
        raise OutputError(
            f"{target}: the name of the output ends in {target.suffix or 'nothing'}",
            hint=f"end it in {' or '.join(suffixes)}",
        )
    with explained(target):
        _check_existing(target, overwrite)
        target.parent.mkdir(parents=True, exist_ok=True)
        # Only trying tells: permissions, read-only disks and quotas differ between systems.
        probe = _sibling(target)
        probe.mkdir()
        probe.rmdir()
    return target


@contextmanager
def atomic_file(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Write a file at a temporary sibling path, which becomes `path` on success.

    Raises
    ------
    OutputError
        If the output exists without `overwrite`, or on any failure of the disk.
    """
    target = check_output(path, overwrite=overwrite)
    # The suffix stays last, for writers that choose the format by it.
    part = _sibling(target)
    try:
        with explained(target):
            yield part
            with part.open("rb") as written:
                os.fsync(written.fileno())
            os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Fill a temporary sibling folder, which becomes `path` on success.

    A folder that is replaced stays in place until the new one is whole.

    Raises
    ------
    OutputError
        If the output exists without `overwrite`, or on any failure of the disk.
    """
    target = check_output(path, overwrite=overwrite)
    part = _sibling(target)
    try:
        with explained(target):
            part.mkdir()
            yield part
            _replace_folder(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


@contextmanager
def explained(target: Path) -> Iterator[None]:
    """Turn the failures of the disk into an OutputError that names the output."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{target}: cannot be written ({error.strerror or error})",
            hint="nothing was left behind; check the folder, its permissions and the free space",
        ) from error


def _replace_folder(part: Path, target: Path) -> None:
    if not target.exists():
        os.rename(part, target)
        return
    old = _sibling(target)
    os.rename(target, old)
    try:
        os.rename(part, target)
    except OSError:
        os.rename(old, target)
        raise
    if old.is_dir():
        shutil.rmtree(old, ignore_errors=True)
    else:
        old.unlink()


def _check_existing(target: Path, overwrite: bool) -> None:
    if not target.exists():
        return
    if target.is_dir():
        content = {entry.name for entry in target.iterdir()}
        if not content:
            return
        if not content & MARKERS:
            raise OutputError(
                f"{target}: is a folder that was not written by lightmatrix",
                hint="choose another name for the output",
            )
    if not overwrite:
        raise OutputError(
            f"{target}: exists already", hint="add --overwrite to replace it, or choose a new name"
        )


def _sibling(target: Path) -> Path:
    return target.with_name(f".{target.stem}.{secrets.token_hex(4)}.part{target.suffix}")
