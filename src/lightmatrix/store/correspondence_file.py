"""Correspondences as npz files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.files.numpy_files import NpyHeader, read_npz
from lightmatrix.outputs.kinds import CORRESPONDENCE, CORRESPONDENCE_MARK
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.transport.correspondence import Correspondence

# The version of the files. Those of a later one are refused.
VERSION = 1
# Arrays of each camera pixel: numbers after (rows, cols), type, and whether every file has them.
_ARRAYS = {
    "pixel": ((2,), np.dtype(np.int32), True),
    "place": ((2,), np.dtype(np.float32), True),
    "confidence": ((), np.dtype(np.float32), True),
    "uncertainty": ((2,), np.dtype(np.float32), False),
    "light": ((), np.dtype(np.float32), False),
}


def write_correspondence(
    path: str | Path, matches: Correspondence, *, overwrite: bool = False
) -> None:
    """Write a correspondence as an npz file.

    Parameters
    ----------
    path : str or Path
        The file, .npz.
    matches : Correspondence
        What to write.
    overwrite : bool
        Whether an existing correspondence may be replaced.

    Raises
    ------
    OutputError
        If the file exists, is another one, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> matches = lm.correspondence(lm.truth("metal").transport())
    >>> lm.write_correspondence("matches.npz", matches)
    """
    arrays = {name: getattr(matches, name) for name in _ARRAYS}
    content: dict[str, Any] = {CORRESPONDENCE_MARK: np.array(VERSION)}
    content |= {name: array for name, array in arrays.items() if array is not None}
    if matches.projector_shape is not None:
        content["projector_shape"] = np.array(matches.projector_shape)
    with (
        atomic_file(path, CORRESPONDENCE, overwrite=overwrite) as temporary,
        open(temporary, "wb") as stream,
    ):
        # Fractions of pixels hardly compress, and it takes longer than decoding.
        np.savez(stream, **content)


def read_correspondence(path: str | Path) -> Correspondence:
    """Read a correspondence that `decode` or `write_correspondence` wrote.

    Parameters
    ----------
    path : str or Path
        The npz file.

    Returns
    -------
    Correspondence

    Raises
    ------
    InputError
        If the file is missing, damaged, of a later version, or no correspondence.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> matches = lm.correspondence(lm.truth("metal").transport())
    >>> lm.write_correspondence("matches.npz", matches)
    >>> lm.read_correspondence("matches.npz").projector_shape
    (64, 64)
    """
    file = Path(path)
    content = read_npz(file, _check_headers)
    version = content[CORRESPONDENCE_MARK]
    if version.shape or int(version) != VERSION:
        raise InputError(
            f"{file}: has format version {version}, this lightmatrix reads {VERSION}",
            hint="update lightmatrix",
        )
    shape = content.get("projector_shape")
    return Correspondence(
        content["pixel"],
        content["place"],
        content["confidence"],
        content.get("uncertainty"),
        content.get("light"),
        None if shape is None else (int(shape[0]), int(shape[1])),
    )


def _check_headers(headers: Mapping[str, NpyHeader]) -> None:
    """Refuse arrays that no correspondence has, before any of them is read."""
    if CORRESPONDENCE_MARK not in headers:
        raise ValueError("no correspondence; `lightmatrix decode` writes one")
    if "confidence" not in headers or len(headers["confidence"].shape) != 2:
        raise ValueError("a correspondence without a confidence of each camera pixel")
    grid = headers["confidence"].shape
    for name, (numbers, kind, needed) in _ARRAYS.items():
        if name not in headers:
            if needed:
                raise ValueError(f"a correspondence without {name}")
            continue
        if headers[name].shape != (*grid, *numbers) or headers[name].dtype != kind:
            raise ValueError(f"{name} is {headers[name].dtype} of {headers[name].shape}")
    if "projector_shape" in headers and headers["projector_shape"].shape != (2,):
        raise ValueError("a projector shape that is not rows and columns")
