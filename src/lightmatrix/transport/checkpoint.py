"""Checkpoints of estimates: finished tiles of rows beside the output, so that no work is lost.

While an estimate runs, `<output>.partial` holds each finished tile of each of its steps as one
file, renamed into place when whole, and the fingerprint of what is being computed. A run that was
killed continues there. The output is locked meanwhile.

A tile states its file's name and the fingerprint, and the archive has checksums. So a tile that was
damaged or renamed, or belongs to other settings, is computed again.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from lightmatrix.errors import ClusterError, InputError, LightMatrixError, OutputError
from lightmatrix.files.kinds import PARTIAL, PROJECTOR_STORES, STORE, FolderKind
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.files.running import RunningResults
from lightmatrix.files.writing import claimed
from lightmatrix.resources.threads import work_ahead
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows
from lightmatrix.transport.store import open as open_store
from lightmatrix.transport.store import save_projectors, save_rows

# First row of a tile, and the row after its last.
Span = tuple[int, int]
# The array of a tile's file that says which tile it is, and of what.
_MARK = "mark"
_FINGERPRINT = "fingerprint.json"
# The step whose tiles are the result.
ROWS = "rows"


class Checkpoint:
    """Finished tiles of a matrix that is being computed, and the lock of the output.

    An exception leaves the tiles for the next run. Those of the step `ROWS` are the result, those
    of others are what an estimator needs to continue.
    """

    def __init__(
        self, path: Path, kind: FolderKind, kept: RunningResults, token: str, overwrite: bool,
        claim: ExitStack,
    ) -> None:  # fmt: skip
        self._path, self._kind, self._kept, self._token = path, kind, kept, token
        self._overwrite, self._claim = overwrite, claim
        # The undamaged tiles of each step that was asked for.
        self._spans: dict[str, list[Span]] = {}

    @classmethod
    def open(
        cls, path: str | Path, fingerprint: Mapping[str, Any], *, kind: FolderKind = STORE,
        overwrite: bool = False,
    ) -> Checkpoint:  # fmt: skip
        """Begin, or continue, the running results of an output, in scene.zarr.partial.

        The output is a store, or of the kind PROJECTOR_STORES a folder of them. The `fingerprint`
        is everything the result depends on, JSON-ready. An OutputError refuses an output that
        exists or that another run writes, and tiles of another fingerprint; with `overwrite` both
        are replaced.
        """
        wanted = json.loads(json.dumps(dict(fingerprint), default=str))
        with ExitStack() as claim:
            target = claim.enter_context(claimed(path, kind, overwrite=overwrite))
            kept = RunningResults.resume(
                target, PARTIAL, wanted, file=_FINGERPRINT,
                contents="an incomplete estimate with other settings", overwrite=overwrite,
            )  # fmt: skip
            if not kept.has(_FINGERPRINT):
                try:
                    with kept.keep(_FINGERPRINT) as part:
                        part.write_text(json.dumps(wanted, indent=2))
                except OutputError:
                    kept.discard()
                    raise
            return cls(Path(path), kind, kept, _token(wanted), overwrite, claim.pop_all())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._claim:
            # Settings that no tile could be computed with must not stand in the way of others.
            refused = isinstance(error, LightMatrixError) and not isinstance(
                error, OutputError | ClusterError
            )
            steps = {step for _, step, _ in self._files()}
            if not steps or (refused and ROWS not in steps):
                self._kept.discard()
            elif error is not None:
                error.add_note("finished tiles are kept, run again to continue")

    def spans(self, step: str = ROWS) -> list[Span]:
        """Rows of the finished, undamaged tiles of a step, in order and without overlap."""
        if step not in self._spans:
            spans = list[Span]()
            for _, other, span in self._files():
                if other == step:
                    with suppress(InputError):
                        self._tile(step, span)
                        spans.append(span)
            self._spans[step] = _without_overlap(spans)
        return list(self._spans[step])

    def write(self, start: int, stop: int, rows: SparseRows, step: str = ROWS) -> None:
        """Keep a finished tile, the rows start..stop of a step."""
        name, arrays = tile_name(step, (start, stop)), rows.arrays()
        arrays[_MARK] = np.array(f"{name} of {self._token}")
        with self._kept.keep(name) as part:
            np.savez(part, **arrays)  # type: ignore[arg-type]
        self._spans[step] = _without_overlap([*self.spans(step), (start, stop)])

    def read(self, step: str) -> SparseRows:
        """All tiles of a step, joined."""
        spans, size = self.spans(step), 0
        for span in spans:
            # Reading a tile says what is wrong with its file.
            with suppress(OSError):
                size += self._kept.file(tile_name(step, span)).stat().st_size
        # An entry takes eight bytes of a file or more.
        return SparseRows.joined(self._tiles(step), (spans[-1][1], size // 8))

    def forget(self, step: str) -> None:
        """Throw away the tiles of a step."""
        for name, other, _ in self._files():
            if other == step:
                self._kept.forget(name)
        self._spans[step] = []

    def finish(
        self, *, camera_shape: tuple[int, ...], projector_shape: tuple[int, int],
        background_grid: tuple[int, int] = (1, 1), provenance: Mapping[str, Any] | None = None,
        step: str = ROWS,
    ) -> LightTransport:  # fmt: skip
        """Join the tiles on disk into the output, so that T is in memory once, and remove them."""
        spans = self.spans(step)
        edges = [0, *(stop for _, stop in spans)]
        rows = int(np.prod(camera_shape))
        if [start for start, _ in spans] != edges[:-1] or edges[-1] != rows:
            raise InputError(f"{self._kept.path}: the tiles do not cover all {rows} rows once")
        provenance = dict(provenance or {})
        shapes = camera_shape, projector_shape, background_grid
        several: LightTransport | None = None
        try:
            if self._kind is PROJECTOR_STORES:
                parts = self.read(step)
                several = LightTransport(
                    parts.coefficients, parts.background, *shapes, parts.diagnostics, provenance
                )
                save_projectors(self._path, several, overwrite=self._overwrite)
            else:
                save_rows(self._path, self._tiles(step), *shapes, provenance, self._overwrite)
        except OutputError as error:
            raise OutputError(
                error.message,
                hint=f"the finished tiles are kept in {self._kept.path}: check the folder, its "
                "permissions and the free space, and run the same estimate again",
            ) from error
        self._kept.discard()
        if several is not None:
            return several
        return replace(open_store(self._path), provenance=provenance)

    def _files(self) -> list[tuple[str, str, Span]]:
        """Name, step and rows of each tile's file that is kept."""
        form = re.compile(r"([a-z0-9-]+)-([0-9]{1,18})-([0-9]{1,18})\.npz")
        found = [match for name in self._kept.names if (match := form.fullmatch(name))]
        return [(match[0], match[1], (int(match[2]), int(match[3]))) for match in found]

    def _tile(self, step: str, span: Span) -> SparseRows:
        """A finished tile; an InputError says that it is missing, damaged, or of another token."""
        name = tile_name(step, span)
        arrays = read_npz(self._kept.file(name))
        if str(arrays.pop(_MARK, "")) != f"{name} of {self._token}":
            raise InputError(f"{name}: belongs to another estimate")
        rows = SparseRows.from_arrays(arrays)
        if rows.count != span[1] - span[0]:
            raise InputError(f"{name}: holds {rows.count} rows")
        return rows

    def _tiles(self, step: str) -> Iterator[SparseRows]:
        """Finished tiles one after the other, so that they are never all in memory."""

        def whole(span: Span) -> SparseRows:
            try:
                return self._tile(step, span)
            except InputError as error:
                raise InputError(
                    f"{self._kept.path}: the tile {tile_name(step, span)} was damaged meanwhile "
                    f"({error.message})",
                    hint="run the same estimate again; it computes that tile anew",
                ) from error

        return work_ahead(whole, self.spans(step))


def tile_name(step: str, span: Span) -> str:
    """The name of the file that keeps a tile of a step."""
    return f"{step}-{span[0]}-{span[1]}.npz"


def _without_overlap(spans: Iterable[Span]) -> list[Span]:
    """Spans of rows in order, of which a longer one excludes those that overlap it."""
    chosen: list[Span] = []
    for start, stop in sorted(spans, key=lambda span: span[0] - span[1]):
        if start < stop and all(stop <= other[0] or start >= other[1] for other in chosen):
            chosen.append((start, stop))
    return sorted(chosen)


def unfinished_spans(wanted: Iterable[Span], finished: Iterable[Span]) -> list[Span]:
    """The unfinished parts of the wanted spans; both are in order and without overlap."""
    finished, missing = list(finished), []
    for start, stop in wanted:
        for first, last in finished:
            if last > start and first < stop:
                if first > start:
                    missing.append((start, first))
                start = max(start, last)
        if start < stop:
            missing.append((start, stop))
    return missing


def _token(fingerprint: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(fingerprint, sort_keys=True).encode()).hexdigest()
