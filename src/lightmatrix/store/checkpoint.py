"""Running results: finished tiles of rows beside the output, so that no work is lost.

While an estimate runs, `<output>.partial` holds each finished tile of each of its steps as one
file, renamed into place when whole, and the fingerprint of what is being computed. A run that was
killed goes on there. The output is locked meanwhile; tiles that are damaged, by their digests, are
computed again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from lightmatrix.errors import ClusterError, InputError, LightMatrixError, OutputError
from lightmatrix.outputs.kinds import PARTIAL, STORE
from lightmatrix.outputs.markers import read_object
from lightmatrix.outputs.running import RunningFolder
from lightmatrix.outputs.writing import claimed
from lightmatrix.store import zarr_file
from lightmatrix.store.tiles import Span, apart, read_tile, tile_name, tile_of, write_tile
from lightmatrix.store.zarr_file import save_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

_FINGERPRINT = "fingerprint.json"
# The step whose tiles are the result.
ROWS = "rows"


class Checkpoint:
    """Finished tiles of rows of a light transport matrix that is being computed.

    Made by `open`, used in a ``with`` statement, which holds the lock of the output. An exception
    leaves the tiles for the next run. Tiles belong to steps: those of the step `ROWS` are the
    result, those of others are what an estimator needs to go on.
    """

    def __init__(
        self, path: Path, kept: RunningFolder, token: str, overwrite: bool, claim: ExitStack
    ) -> None:
        self._path = path
        self._kept = kept
        self._overwrite = overwrite
        self._claim = claim
        self.token = token
        # Whole tiles of the steps that were asked for.
        self._spans: dict[str, list[Span]] = {}

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
            return cls(Path(path), kept, _token(wanted), overwrite, claim.pop_all())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._claim:
            tiles = any(_span(name, ROWS) is not None for name in self._kept.names)
            # Settings that no tile could be computed with must not stand in the way of others.
            hopeless = isinstance(error, LightMatrixError) and not isinstance(
                error, OutputError | ClusterError
            )
            if not _results(self._kept) or (hopeless and not tiles):
                self._kept.discard()

    @property
    def folder(self) -> Path:
        """Where the tiles are kept, as an absolute path."""
        return self._kept.path

    @property
    def resumed_rows(self) -> int:
        """How many rows of the result are finished."""
        return sum(stop - start for start, stop in self.spans(ROWS))

    def spans(self, step: str = ROWS) -> list[Span]:
        """Rows of the tiles of a step that are finished and whole, in order; none overlap."""
        if step not in self._spans:
            named = [span for name in self._kept.names if (span := _span(name, step)) is not None]
            # Damaged tiles are solved again.
            whole = [span for span in named if self._tile(step, span) is not None]
            self._spans[step] = apart(whole)
        return list(self._spans[step])

    def write(self, start: int, stop: int, rows: SparseRows, step: str = ROWS) -> None:
        """Keep a finished tile, the rows start..stop of a step.

        Raises
        ------
        OutputError
            If the disk fails; tiles that were written remain.
        """
        write_tile(self.place(start, stop, step), self.token, rows)
        self.add(start, stop, step)

    def place(self, start: int, stop: int, step: str = ROWS) -> Path:
        """Where another process may write a tile, with `write_tile` and the `token`.

        Raises
        ------
        OutputError
            If the disk fails, or a file of others has its name.
        """
        return self._kept.place(tile_name(step, (start, stop)))

    def add(self, start: int, stop: int, step: str = ROWS) -> None:
        """Count a tile that was written as finished."""
        self._spans[step] = apart([*self.spans(step), (start, stop)])

    def read(self, step: str) -> SparseRows:
        """All tiles of a step, joined.

        Raises
        ------
        InputError
            If one was damaged since it was finished.
        """
        return SparseRows.joined(list(self._tiles(step)))

    def keep(self, name: str, data: bytes) -> None:
        """Keep a file of another kind until the output is whole.

        Raises
        ------
        OutputError
            If the disk fails.
        """
        with self._kept.keep(name) as part:
            part.write_bytes(data)

    def forget(self, step: str) -> None:
        """Throw away the tiles of a step."""
        for name in self._kept.names:
            if _span(name, step) is not None:
                self._kept.forget(name)
        self._spans[step] = []

    def finish(
        self,
        *,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        background_grid: tuple[int, int] = (1, 1),
        provenance: Mapping[str, Any] | None = None,
    ) -> LightTransport:
        """Join the tiles of the result into the output, then throw them away.

        They are joined on disk, so that the matrix is in memory once, when it is whole.

        Raises
        ------
        InputError
            If the tiles do not cover all rows.
        OutputError
            If the output cannot be written; the tiles remain.
        """
        spans = self.spans(ROWS)
        edges = [0, *(stop for _, stop in spans)]
        rows = int(np.prod(camera_shape))
        if [start for start, _ in spans] != edges[:-1] or edges[-1] != rows:
            raise InputError(f"{self._kept.path}: the tiles do not cover all {rows} rows once")
        told = dict(provenance or {})
        try:
            save_rows(
                self._path,
                self._tiles(ROWS),
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

    def _tiles(self, step: str) -> Iterator[SparseRows]:
        """Finished tiles one after the other, so that they are never all in memory."""
        for span in self.spans(step):
            yield self._whole(step, span)

    def _whole(self, step: str, span: Span) -> SparseRows:
        tile = self._tile(step, span)
        if tile is None:
            raise InputError(
                f"{self._kept.path}: the tile {tile_name(step, span)} was damaged meanwhile",
                hint="run the same estimate again; it computes that tile anew",
            )
        return tile

    def _tile(self, step: str, span: Span) -> SparseRows | None:
        """A finished tile; None if it is damaged."""
        file = self._kept.file(tile_name(step, span))
        return read_tile(file, self.token, span[1] - span[0])


def fingerprint_token(folder: Path) -> str | None:
    """What the tiles of a folder of running results are marked with; None if there are none."""
    found = read_object(folder / _FINGERPRINT)
    return None if found is None else _token(found)


def _token(fingerprint: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(fingerprint, sort_keys=True).encode()).hexdigest()


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
    return any(tile_of(name) is not None for name in kept.names)


def _span(name: str, step: str) -> Span | None:
    """The rows of a tile by its file's name; None if it is none of the step."""
    found = tile_of(name)
    return found[1] if found is not None and found[0] == step else None


def _differing(kept: RunningFolder, wanted: Mapping[str, Any]) -> str | None:
    """Which keys of a stored fingerprint differ, in words; None if none does."""
    found = read_object(kept.file(_FINGERPRINT)) if kept.has(_FINGERPRINT) else None
    if found is None:
        return "unknown ones"
    if found == wanted:
        return None
    keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
    return ", ".join(sorted(keys))
