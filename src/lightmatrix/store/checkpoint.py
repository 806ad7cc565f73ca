"""Running results: finished tiles of rows beside the output, so that no work is lost.

While an estimate runs, `<output>.partial` holds each finished tile as one file, renamed into place
when whole, and the fingerprint of what is being computed. A run that was killed goes on there.
The output is locked meanwhile; tiles that are damaged, by their digests, are computed again.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, LightMatrixError, OutputError
from lightmatrix.files.npz import read_npz
from lightmatrix.outputs.kinds import PARTIAL, STORE
from lightmatrix.outputs.markers import read_object
from lightmatrix.outputs.running import RunningFolder
from lightmatrix.outputs.writing import claimed
from lightmatrix.store import zarr_file
from lightmatrix.store.zarr_file import save_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

_FINGERPRINT = "fingerprint.json"
# The array of a kept file that tells whether the others are those that were kept under its name.
_DIGEST = "digest"
# First row of a tile, and the row after its last.
_Span = tuple[int, int]


class Checkpoint:
    """Finished tiles of rows of a light transport matrix that is being computed.

    Made by `open`, used in a ``with`` statement, which holds the lock of the output. An exception
    leaves the tiles for the next run.
    """

    def __init__(self, path: Path, kept: RunningFolder, overwrite: bool, claim: ExitStack) -> None:
        self._path = path
        self._kept = kept
        self._overwrite = overwrite
        self._claim = claim
        self._used: set[_Span] = set()
        spans = [span for name in kept.names if (span := _span(name)) is not None]
        # Damaged tiles are solved again.
        self._found = {span for span in spans if _tile(kept, span) is not None}

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
            If the output exists, is being written by another run, there are tiles of other inputs,
            or the disk fails.
        """
        wanted = json.loads(json.dumps(dict(fingerprint), default=str))
        with ExitStack() as claim:
            target = claim.enter_context(claimed(path, STORE, overwrite=overwrite))
            kept = _begun(target, wanted, overwrite)
            return cls(Path(path), kept, overwrite, claim.pop_all())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._claim:
            tiles = any(_span(name) is not None for name in self._kept.names)
            # Settings that no tile could be computed with must not stand in the way of others.
            hopeless = isinstance(error, LightMatrixError) and not isinstance(error, OutputError)
            if not _results(self._kept) or (hopeless and not tiles):
                self._kept.discard()

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

    def write(self, start: int, stop: int, rows: SparseRows) -> None:
        """Keep a finished tile, the rows start..stop.

        Raises
        ------
        OutputError
            If the disk fails; tiles that were written remain.
        """
        self._keep(_name(start, stop), rows)
        self._used.add((start, stop))

    def remember(self, name: str, rows: SparseRows) -> None:
        """Keep what an estimator needs to go on, under a name that does not begin with rows.

        Raises
        ------
        OutputError
            If the disk fails; what was kept before remains.
        """
        self._keep(f"{name}.npz", rows)

    def recall(self, name: str) -> SparseRows | None:
        """What was kept under a name; None if nothing whole is there."""
        return _read(self._kept, f"{name}.npz")

    def forget(self, name: str) -> None:
        """Throw away what was kept under a name, if anything."""
        self._kept.forget(f"{name}.npz")

    def finish(
        self,
        *,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        background_grid: tuple[int, int] = (1, 1),
        provenance: Mapping[str, Any] | None = None,
    ) -> LightTransport:
        """Join the tiles that this run wrote or found into the output, then throw them away.

        They are joined on disk, so that the matrix is in memory once, when it is whole.

        Raises
        ------
        InputError
            If the tiles do not cover all rows.
        OutputError
            If the output cannot be written; the tiles remain.
        """
        spans = sorted(self._used)
        edges = [0, *(stop for _, stop in spans)]
        rows = int(np.prod(camera_shape))
        if [start for start, _ in spans] != edges[:-1] or edges[-1] != rows:
            raise InputError(f"{self._kept.path}: the tiles do not cover all {rows} rows once")
        told = dict(provenance or {})
        try:
            save_rows(
                self._path,
                self._tiles(spans),
                camera_shape=camera_shape,
                projector_shape=projector_shape,
                background_grid=background_grid,
                provenance=told,
                overwrite=self._overwrite,
            )
        except OutputError as error:
            raise OutputError(
                error.message,
                hint=f"the finished tiles are kept in {self._kept.path}: check the folder, its "
                "permissions and the free space, and run the same estimate again",
            ) from error
        self._kept.discard()
        return replace(zarr_file.open(self._path), provenance=told)

    def _tiles(self, spans: Sequence[_Span]) -> Iterator[SparseRows]:
        """Finished tiles one after the other, so that they are never all in memory."""
        for span in spans:
            tile = _tile(self._kept, span)
            if tile is None:
                raise InputError(
                    f"{self._kept.path}: the tile {_name(*span)} was damaged meanwhile",
                    hint="run the same estimate again; it computes that tile anew",
                )
            yield tile

    def _keep(self, name: str, rows: SparseRows) -> None:
        with self._kept.keep(name) as part:
            arrays: dict[str, Any] = rows.arrays()
            arrays[_DIGEST] = _digest(name, arrays)
            np.savez(part, **arrays)


def _begun(target: Path, wanted: Mapping[str, Any], overwrite: bool) -> RunningFolder:
    """The running results of an output under a fingerprint, those found or new ones."""
    kept = RunningFolder.open(target, PARTIAL)
    differing = _differing(kept, wanted)
    if differing is None:
        return kept
    if _results(kept):
        if not overwrite:
            raise OutputError(
                f"{kept.path}: holds an incomplete estimate with other settings ({differing})",
                hint="finish it with its own settings, or add --overwrite to discard it",
            )
        kept.discard()
        kept = RunningFolder.open(target, PARTIAL)
    try:
        with kept.keep(_FINGERPRINT) as part:
            part.write_text(json.dumps(wanted, indent=2))
    except OutputError:
        kept.discard()
        raise
    return kept


def _results(kept: RunningFolder) -> bool:
    return any(name != _FINGERPRINT for name in kept.names)


def _name(start: int, stop: int) -> str:
    return f"rows-{start}-{stop}.npz"


def _span(name: str) -> _Span | None:
    """The rows of a tile by its file's name; None if it is no tile's."""
    match = re.fullmatch(r"rows-([0-9]{1,18})-([0-9]{1,18})\.npz", name)
    return None if match is None else (int(match[1]), int(match[2]))


def _tile(kept: RunningFolder, span: _Span) -> SparseRows | None:
    """A finished tile; None if it is damaged."""
    rows = _read(kept, _name(*span))
    return rows if rows is not None and rows.count == span[1] - span[0] else None


def _read(kept: RunningFolder, name: str) -> SparseRows | None:
    """Rows that were kept under a file name; None if there are none, or not whole."""
    if not kept.has(name):
        return None
    try:
        arrays = read_npz(kept.file(name))
        digest = arrays.pop(_DIGEST, None)
        return SparseRows.from_arrays(arrays) if _same(digest, _digest(name, arrays)) else None
    except InputError:
        return None


def _digest(name: str, arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Hash of arrays and of the name that they are kept under, 32 bytes."""
    hasher = hashlib.sha256(name.encode())
    for key in sorted(arrays):
        values = arrays[key]
        hasher.update(repr((key, values.shape, values.dtype.str)).encode())
        hasher.update(values.tobytes())
    return np.frombuffer(hasher.digest(), np.uint8)


def _same(found: NDArray[Any] | None, wanted: NDArray[np.uint8]) -> bool:
    return found is not None and found.dtype == wanted.dtype and np.array_equal(found, wanted)


def _differing(kept: RunningFolder, wanted: Mapping[str, Any]) -> str | None:
    """Which keys of a stored fingerprint differ, in words; None if none does."""
    found = read_object(kept.file(_FINGERPRINT)) if kept.has(_FINGERPRINT) else None
    if found is None:
        return "unknown ones"
    if found == wanted:
        return None
    keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
    return ", ".join(sorted(keys))
