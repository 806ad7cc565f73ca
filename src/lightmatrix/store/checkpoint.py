"""Running results: finished tiles of rows beside the output, so that no work is lost.

While an estimate runs, `<output>.partial` holds each finished tile as one file, renamed into place
when whole, and the fingerprint of what is being computed. A run that was killed goes on there.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.headers import parse_json
from lightmatrix.files.npz import read_npz
from lightmatrix.files.outputs import atomic_file, check_output, explained
from lightmatrix.files.reading import read_text
from lightmatrix.store.checked import checked_diagnostics, checked_matrix, finite, shape_of
from lightmatrix.store.zarr_file import PARTIAL, SUFFIX, save
from lightmatrix.transport.matrix import LightTransport

_FINGERPRINT = "fingerprint.json"
_DIAGNOSTIC = "diagnostic_"
_NAME = re.compile(r"rows-([0-9]{1,18})-([0-9]{1,18})\.npz")


class Checkpoint:
    """Finished tiles of rows of a light transport matrix that is being computed.

    Made by `open`, used in a ``with`` statement. An exception leaves the tiles for the next run.
    """

    def __init__(self, path: Path, folder: Path, overwrite: bool) -> None:
        self._path = path
        self._overwrite = overwrite
        self._folder = folder
        self._used: set[tuple[int, int]] = set()
        self._found = {
            tile for file in folder.glob("rows-*.npz") if (tile := _whole(file)) is not None
        }

    @classmethod
    def open(
        cls, path: str | Path, fingerprint: Mapping[str, Any], *, overwrite: bool = False
    ) -> Checkpoint:
        """Begin, or go on with, the running results of an output.

        Parameters
        ----------
        path : str or Path
            The output, such as scene.zarr; the tiles are kept in scene.zarr.partial.
        fingerprint : mapping
            Everything the result depends on, JSON-ready: digest of the input, parameters.
        overwrite : bool
            Whether an existing output may be replaced, and tiles of other inputs thrown away.

        Raises
        ------
        OutputError
            If the output exists, there are tiles of other inputs, or the disk fails.
        """
        target = check_output(path, overwrite=overwrite, suffixes=(SUFFIX,))
        folder = target.with_name(target.name + PARTIAL)
        wanted = json.loads(json.dumps(dict(fingerprint), default=str))
        with explained(target):
            if folder.exists():
                differing = _differing(folder / _FINGERPRINT, wanted)
                if differing is None:
                    return cls(target, folder, overwrite)
                if not overwrite and any(folder.glob("*.npz")):
                    raise OutputError(
                        f"{folder}: holds an incomplete estimate with other settings ({differing})",
                        hint="finish it with its own settings, or add --overwrite to discard it",
                    )
                shutil.rmtree(folder)
            folder.mkdir()
        try:
            with atomic_file(folder / _FINGERPRINT) as part:
                part.write_text(json.dumps(wanted, indent=2))
        except OutputError:
            folder.rmdir()
            raise
        return cls(target, folder, overwrite)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not any(self._folder.glob("*.npz")):
            shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def resumed_rows(self) -> int:
        """How many rows an earlier run had finished."""
        return sum(stop - start for start, stop in self._found)

    def has(self, start: int, stop: int) -> bool:
        """Whether an earlier run finished the tile of the rows start..stop."""
        if (start, stop) not in self._found:
            return False
        self._used.add((start, stop))
        return True

    def write(
        self,
        start: int,
        stop: int,
        sparse: csr_array,
        background: NDArray[Any],
        diagnostics: Mapping[str, NDArray[Any]],
    ) -> None:
        """Keep a finished tile.

        Parameters
        ----------
        start, stop : int
            Its rows; m = stop - start.
        sparse : (m, N) csr_array
        background : (m, B)
        diagnostics : mapping of str to (m,) array

        Raises
        ------
        OutputError
            If the disk fails; tiles that were written remain.
        """
        named: dict[str, Any] = {_DIAGNOSTIC + name: v for name, v in diagnostics.items()}
        with atomic_file(self._file(start, stop), overwrite=True) as part:
            np.savez(
                part,
                data=sparse.data.astype(np.float32, copy=False),
                indices=sparse.indices.astype(np.int32, copy=False),
                indptr=sparse.indptr.astype(np.int64, copy=False),
                shape=np.array(sparse.shape),
                background=background.astype(np.float32, copy=False),
                **named,
            )
        self._used.add((start, stop))

    def remember(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep what an estimator needs to go on, under a name that does not begin with rows.

        Raises
        ------
        OutputError
            If the disk fails; what was kept before remains.
        """
        with atomic_file(self._folder / f"{name}.npz", overwrite=True) as part:
            np.savez(part, **dict(arrays))  # type: ignore[arg-type]

    def recall(self, name: str) -> dict[str, NDArray[Any]] | None:
        """What was kept under a name; None if nothing whole is there."""
        try:
            return read_npz(self._folder / f"{name}.npz")
        except InputError:
            return None

    def forget(self, name: str) -> None:
        """Throw away what was kept under a name, if anything."""
        (self._folder / f"{name}.npz").unlink(missing_ok=True)

    def finish(
        self,
        *,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        background_grid: tuple[int, int] = (1, 1),
        provenance: Mapping[str, Any] | None = None,
    ) -> LightTransport:
        """Join the tiles that this run wrote or found into the output, then throw them away.

        Raises
        ------
        InputError
            If the tiles do not cover all rows.
        OutputError
            If the output cannot be written; the tiles remain.
        """
        tiles = sorted(self._used)
        edges = [0, *(stop for _, stop in tiles)]
        rows = int(np.prod(camera_shape))
        if [start for start, _ in tiles] != edges[:-1] or edges[-1] != rows:
            raise InputError(f"{self._folder}: the tiles do not cover all {rows} rows once")
        sparse, background = [], []
        diagnostics: dict[str, list[NDArray[Any]]] = {}
        for start, stop in tiles:
            found = _read_tile(self._file(start, stop))
            sparse.append(found.sparse)
            background.append(found.background)
            for name, values in found.diagnostics.items():
                diagnostics.setdefault(name, []).append(values)
        transport = LightTransport(
            csr_array(vstack(sparse, format="csr")),
            np.concatenate(background),
            camera_shape,
            projector_shape,
            background_grid,
            {name: np.concatenate(parts) for name, parts in diagnostics.items()},
            dict(provenance or {}),
        )
        save(self._path, transport, overwrite=self._overwrite)
        shutil.rmtree(self._folder, ignore_errors=True)
        return transport

    def _file(self, start: int, stop: int) -> Path:
        return self._folder / f"rows-{start}-{stop}.npz"


@dataclass(frozen=True, eq=False)
class _Tile:
    """A finished tile as it was written."""

    sparse: csr_array
    background: NDArray[np.float32]
    diagnostics: Mapping[str, NDArray[Any]]


def _whole(file: Path) -> tuple[int, int] | None:
    """The rows of a tile's file; None if it is damaged, so that it is solved again."""
    rows = _rows(file)
    if rows is None:
        return None
    try:
        _read_tile(file)
    except InputError:
        return None
    return rows


def _rows(file: Path) -> tuple[int, int] | None:
    """The rows that a tile's name tells."""
    named = _NAME.fullmatch(file.name)
    if named is None or int(named[2]) <= int(named[1]):
        return None
    return int(named[1]), int(named[2])


def _read_tile(file: Path) -> _Tile:
    """A finished tile, checked whole.

    Raises
    ------
    InputError
        If it is damaged.
    """
    content = read_npz(file)
    start, stop = _rows(file) or (0, 0)
    try:
        rows, cols = shape_of(content["shape"], (2,), "the tile")
        if rows != stop - start:
            raise ValueError(f"{rows} rows")
        matrix = checked_matrix(
            content["data"], content["indices"], content["indptr"], (rows, cols)
        )
        background = finite(content["background"], "the background")
        if background.ndim != 2 or len(background) != rows:
            raise ValueError(f"a background of {background.shape}")
        named = {
            name.removeprefix(_DIAGNOSTIC): values
            for name, values in content.items()
            if name.startswith(_DIAGNOSTIC)
        }
        return _Tile(matrix, background, checked_diagnostics(named, rows))
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{file}: is damaged ({error})", hint="remove it; its rows are then solved again"
        ) from error


def _differing(file: Path, wanted: Mapping[str, Any]) -> str | None:
    """Which keys of a stored fingerprint differ, in words; None if none does."""
    try:
        found = parse_json(read_text(file), str(file), finite=False)
    except InputError:
        return "unknown ones"
    if not isinstance(found, dict):
        return "unknown ones"
    if found == wanted:
        return None
    keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
    return ", ".join(sorted(keys))
