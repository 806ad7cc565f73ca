"""Damaged chunks of stored matrices: which they are, whose rows lie in them, and new ones for them.

Rows that were solved again are compared with whatever of them is not damaged, and a chunk takes the
place of a damaged one in one step. So a repair gives what there was, or nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.storage import MemoryStore

from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import StoredArray, create_array
from lightmatrix.outputs.kinds import STORE
from lightmatrix.store.checkpoint import Checkpoint
from lightmatrix.store.tiles import Span
from lightmatrix.store.zarr_file import Stored, look
from lightmatrix.transport.sparse_rows import SparseRows

# The arrays whose chunks hold entries; those of others hold rows.
_ENTRIES = ("indices", "data")
_ROW_ENDS = "indptr"


@dataclass(frozen=True, eq=False)
class Damage:
    """What of a store is damaged.

    Parameters
    ----------
    stored : Stored
        What it announces.
    chunks : mapping of str to list of int
        Numbers of the damaged chunks of each array that has some.
    """

    stored: Stored
    chunks: Mapping[str, list[int]]

    @classmethod
    def of(cls, path: str | Path) -> Damage:
        """Read every chunk of a store, one at a time.

        Raises
        ------
        InputError
            If it does not even announce what it is.
        """
        stored = look(path)
        checks: dict[str, Callable[[NDArray[Any]], bool]] = {
            _ROW_ENDS: lambda ends: bool((ends[1:] >= ends[:-1]).all()),
            "indices": lambda found: bool(((found >= 0) & (found < stored.shape[1])).all()),
            "data": lambda found: bool(np.isfinite(found).all()),
            "background": lambda found: bool(np.isfinite(found).all()),
        }
        found = {}
        for name, array in stored.arrays.items():
            fine = checks.get(name, lambda values: True)
            numbers = range(-(-array.shape[0] // array.chunks[0]))
            bad = [number for number in numbers if not _is_whole(array, number, fine)]
            if bad:
                found[name] = bad
        return cls(stored, found)

    @property
    def names(self) -> list[str]:
        """The damaged chunks' files within the store."""
        return [
            array.chunk_file(_index(array, number)).relative_to(self.stored.place).as_posix()
            for name, numbers in self.chunks.items()
            for array in [self.stored.arrays[name]]
            for number in numbers
        ]

    @cached_property
    def rows(self) -> list[Span]:
        """Rows that have something in a damaged chunk, in order and apart."""
        touched = np.zeros(self.stored.shape[0], np.bool_)
        for name, numbers in self.chunks.items():
            for number in numbers:
                start, stop = _range(self.stored.arrays[name], number)
                if name in _ENTRIES:
                    low, high = self._bounds
                    touched |= (low[:-1] < stop) & (high[1:] > start)
                elif name == _ROW_ENDS:
                    # The ends of these rows, and the beginnings of those that follow.
                    touched[max(0, start - 1) : stop] = True
                else:
                    touched[start:stop] = True
        edges = np.flatnonzero(np.diff(np.r_[False, touched, False]))
        return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]

    @cached_property
    def _bounds(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """What the ends of rows are at least and at most; the same where they are known."""
        array = self.stored.arrays[_ROW_ENDS]
        entries = self.stored.arrays["data"].shape[0]
        low, high = np.zeros(array.shape, np.int64), np.full(array.shape, entries, np.int64)
        damaged = self.chunks.get(_ROW_ENDS, [])
        for number in range(-(-array.shape[0] // array.chunks[0])):
            if number not in damaged:
                start, stop = _range(array, number)
                low[start:stop] = high[start:stop] = array.read(slice(start, stop))
        return np.maximum.accumulate(low), np.minimum.accumulate(high[::-1])[::-1]

    def mend(self, rows: Mapping[int, SparseRows], running: Checkpoint) -> None:
        """Put new chunks in the places of the damaged ones.

        Parameters
        ----------
        rows : mapping of int to SparseRows
            The rows of each span of `rows`, solved again, by its first row.
        running : Checkpoint
            Holds the lock of the store, and the new chunks until they are whole.

        Raises
        ------
        InputError
            If the rows are others than the undamaged part of the store has; nothing is changed.
        OutputError
            If the disk fails; chunks that were mended remain.
        """
        new = self._fresh(rows)
        sizes = {}
        for (name, number), content in new.items():
            array = self.stored.arrays[name]
            index = _index(array, number)
            file = array.chunk_file(index)
            data = _encoded(array, index, content)
            running.replace(f"{name.replace('/', '-')}-{number}.chunk", data, file)
            sizes[file.relative_to(self.stored.place).as_posix()] = len(data)
        STORE.resize(self.stored.place, sizes)

    def _fresh(self, rows: Mapping[int, SparseRows]) -> dict[tuple[str, int], NDArray[Any]]:
        """What the damaged chunks have to hold."""
        found: dict[tuple[str, int], NDArray[Any]] = {}
        for start, _ in self.rows:
            own = rows[start]
            first = int(self._bounds[0][start])
            ends = first + own.coefficients.indptr.astype(np.int64)
            parts: dict[str, tuple[int, NDArray[Any]]] = {
                _ROW_ENDS: (start, ends),
                "indices": (first, own.coefficients.indices),
                "data": (first, own.coefficients.data),
                "background": (start, own.background),
            }
            facts = own.diagnostics.items()
            parts |= {f"diagnostics/{name}": (start, values) for name, values in facts}
            if parts.keys() != self.stored.arrays.keys():
                raise self._others("other diagnostics")
            for name, (begin, values) in parts.items():
                self._take(found, name, begin, values)
        return found

    def _take(
        self,
        found: dict[tuple[str, int], NDArray[Any]],
        name: str,
        begin: int,
        values: NDArray[Any],
    ) -> None:
        """Values of an array from `begin` on: into damaged chunks; compared where not damaged."""
        array, damaged = self.stored.arrays[name], self.chunks.get(name, [])
        values = np.asarray(values, array.dtype)
        if values.shape[1:] != array.shape[1:] or begin + len(values) > array.shape[0]:
            raise self._others(f"{name} of another size")
        end, size = begin + len(values), array.chunks[0]
        for number in range(begin // size, -(-end // size)):
            start, stop = _range(array, number)
            low, high = max(start, begin), min(stop, end)
            part = values[low - begin : high - begin]
            if number in damaged:
                shape = (stop - start, *array.shape[1:])
                whole = found.setdefault((name, number), np.zeros(shape, array.dtype))
                whole[low - start : high - start] = part
            elif not _equal(array.read(slice(low, high)), part):
                raise self._others(name)

    def _others(self, what: str) -> InputError:
        return InputError(
            f"{self.stored.place}: its rows, solved again, are not those that are stored ({what})",
            hint="give the capture and the versions that it was estimated with (`lightmatrix info` "
            "tells), or estimate again with --overwrite",
        )


def _is_whole(array: StoredArray, number: int, fine: Callable[[NDArray[Any]], bool]) -> bool:
    try:
        return fine(array.read(slice(*_range(array, number))))
    except MemoryError:
        raise
    # The codecs raise nearly anything on damaged chunks.
    except Exception:
        return False


def _range(array: StoredArray, number: int) -> Span:
    """The rows of an array that a chunk holds."""
    size = array.chunks[0]
    return number * size, min((number + 1) * size, array.shape[0])


def _index(array: StoredArray, number: int) -> tuple[int, ...]:
    return number, *(0 for _ in array.chunks[1:])


def _equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def _encoded(array: StoredArray, index: Sequence[int], content: NDArray[Any]) -> bytes:
    """A chunk as the store has it."""
    memory: dict[str, Any] = {}
    group = zarr.open_group(MemoryStore(memory), mode="w", zarr_format=3)
    # Of an array that ends with the chunk, which is padded like the last one of a longer one.
    chunks = array.chunks
    made = create_array(group, "a", content.shape, array.dtype, chunks)
    made[...] = content
    key = "/".join(("a", "c", *("0" for _ in index)))
    data: bytes = memory[key].to_bytes()
    return data


def differing(path: Path, stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Refuse to repair with other settings than those that made a store.

    Versions may differ, as what is solved again is compared with what is there.

    Raises
    ------
    InputError
        Naming the settings that differ.
    """
    plain = json.loads(json.dumps(dict(wanted), default=str))
    keys = sorted({**stored, **plain}.keys() - {"versions"})
    others = [key for key in keys if stored.get(key) != plain.get(key)]
    if others:
        raise InputError(
            f"{path}: was estimated with other settings ({', '.join(others)})",
            hint="repair it by the command that made it, with --repair; `lightmatrix info` tells "
            "its settings",
        )
