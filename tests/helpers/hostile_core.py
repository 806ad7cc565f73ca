"""Arguments that no compiled function may fall over: a table, and sound ones to change.

Run as a program it goes through the table: what would end the process then ends only that one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from lightmatrix import _core
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns

# What a caller can be expected to catch; PyO3's PanicException is none of them.
ORDINARY = (ValueError, TypeError, MemoryError)

ROWS, PATTERNS, UNSEEN, SHAPE = 12, 9, 5, (4, 6)
PIXELS = SHAPE[0] * SHAPE[1]
CAMERA = (3, 4, 1)
HUGE = 2**40
SHOWN_SET = BernoulliPatterns(SHAPE, PATTERNS)
UNSEEN_SET = BernoulliPatterns(SHAPE, UNSEEN, seed=7)
OTHER = BernoulliPatterns((5, 5), PATTERNS).prepared
SHOWN, UNSHOWN = SHOWN_SET.prepared, UNSEEN_SET.prepared
BITS, MEANS = SHOWN_SET.bits, np.asarray(SHOWN_SET.means, np.float64)
RNG = np.random.default_rng(0)
VALUES = RNG.random((ROWS, PATTERNS)).astype(np.float32)
CLIPPED = VALUES > 0.8
MATRIX = csr_array(np.where(RNG.random((ROWS, PIXELS)) < 0.2, 0.5, 0).astype(np.float32))
NAN, INF = float("nan"), float("inf")

Call = Callable[[], Any]


def samples(**changes: Any) -> Any:
    return SimpleNamespace(**{"values": VALUES, "clipped": CLIPPED, "weights": None} | changes)


def chosen(**changes: Any) -> _core.Settings:
    usual: dict[str, Any] = {
        "regularization": 0.05,
        "fidelity": "one-sided",
        "nonnegative": True,
        "background": True,
        "tolerance": 1e-4,
        "max_passes": 50,
        "threads": 1,
    }
    return _core.Settings(**usual | changes)


def sparse(**changes: Any) -> Any:
    parts = {"indptr": MATRIX.indptr, "indices": MATRIX.indices, "data": MATRIX.data}
    return SimpleNamespace(**parts | changes)


def begin(**changes: Any) -> Any:
    usual = {
        "coefficients": MATRIX,
        "background": np.zeros((ROWS, 3)),
    }
    return SimpleNamespace(**usual | changes)


def cells(**changes: Any) -> Any:
    usual = {"means": np.full((2, PATTERNS), 0.5, np.float32), "penalties": np.ones(2, np.float32)}
    return SimpleNamespace(**usual | changes)


def expectation(**changes: Any) -> Any:
    ones = np.ones((ROWS, PATTERNS + UNSEEN), np.float32)
    return SimpleNamespace(**{"values": ones, "weights": ones} | changes)


def around(**changes: Any) -> Any:
    usual = {
        "rows": begin(),
        "camera": CAMERA,
        "projector": (1, *SHAPE),
        "movement": np.zeros((ROWS, 4), np.float32),
    }
    return SimpleNamespace(**usual | changes)


def solve(rows: Any = None, chosen_: Any = None, **options: Any) -> Any:
    return SHOWN.solve(rows or samples(), chosen_ or chosen(), **options)


def weighted(candidates: Any = None, rows: Any = None, **options: Any) -> Any:
    return _core.solve_weighted(
        SHOWN, rows or samples(), chosen(), candidates or sparse(), **options
    )


def expected(rows: Any = None, near: Any = None, **changes: Any) -> Any:
    background = np.zeros((ROWS, PATTERNS + UNSEEN), np.float32)
    usual: dict[str, Any] = {"background": background, "reach": 9, "start": 0, "level": 1.0}
    options: dict[str, Any] = {"shown": SHOWN, "unseen": UNSHOWN} | usual | changes
    return _core.expected_samples(
        samples=rows or samples(), neighbourhood=near or around(), **options
    )


def moments(**changes: Any) -> Any:
    usual: dict[str, Any] = {"images": np.ones((2, 6), np.float32), "shape": (2, 3)}
    usual["kernel"] = np.array([0.5, 0.25], np.float32)
    return _core.blurred_moments(**usual | changes)


def rows_times(**changes: Any) -> Any:
    usual = {"rows": np.ones((2, 3), np.float32), "matrix": np.ones((3, 4), np.float32)}
    return _core.rows_times(**usual | changes)


PLANES = [(np.ones(1, np.float32), 1.0)]


def likely(rows: Any = None, **changes: Any) -> Any:
    usual: dict[str, Any] = {
        "camera": CAMERA,
        "projector": (1, *SHAPE),
        "movement": np.zeros((ROWS, 4), np.float32),
        "spots": [np.ones(1, np.float32)],
        "within": 0.1,
        "wider": np.ones(1, np.float32),
        "singles": np.ones(ROWS, np.float32),
        "reach": (1, 1),
        "most": 5,
        "doubts": np.full(ROWS, 0.01),
        "range": (0, ROWS),
    }
    return _core.likely_pixels(rows=rows or sparse(), **usual | changes)


def changed(values: NDArray[Any], place: Any, value: Any) -> NDArray[Any]:
    values = values.copy()
    values[place] = value
    return values


def hostile_sparse(name: str, call: Callable[[Any], Any]) -> dict[str, Call]:
    """Sparse rows whose parts do not fit, for a call that takes some."""
    indptr, indices, data = MATRIX.indptr, MATRIX.indices, MATRIX.data
    lies = {
        "index below 0": sparse(indices=changed(indices, 3, -1)),
        "index too large": sparse(indices=changed(indices, 3, PIXELS)),
        "int64 index too large": sparse(indices=changed(indices.astype(np.int64), 3, 2**32)),
        "int64 index below 0": sparse(indices=changed(indices.astype(np.int64), 3, -(2**40))),
        "indptr falls": sparse(indptr=changed(indptr, 4, len(data))),
        "indptr begins late": sparse(indptr=changed(indptr, 0, 1)),
        "indptr ends late": sparse(indptr=changed(indptr, -1, len(data) + 5)),
        "indptr ends early": sparse(indptr=changed(indptr, -1, len(data) - 1)),
        "indptr below 0": sparse(indptr=changed(indptr.astype(np.int64), 2, -(2**62))),
        "indptr too short": sparse(indptr=indptr[:-1]),
        "indptr empty": sparse(indptr=indptr[:0]),
        "indptr of floats": sparse(indptr=indptr.astype(float)),
        "indptr of two axes": sparse(indptr=indptr[None]),
        "indices of uint32": sparse(indices=indices.astype(np.uint32)),
        "indices too few": sparse(indices=indices[:-1]),
        "data too few": sparse(data=data[:-1]),
        "data of float16": sparse(data=data.astype(np.float16)),
        "data complex": sparse(data=data.astype(complex)),
        "data with NaN": sparse(data=changed(data, 1, NAN)),
        "data with infinity": sparse(data=changed(data, 1, INF)),
        "data beyond float32": sparse(data=changed(data.astype(float), 1, 1e300)),
        "data a list": sparse(data=data.tolist()),
        "no data": SimpleNamespace(indptr=indptr, indices=indices),
        "another shape": csr_array((ROWS + 1, PIXELS), dtype=np.float32),
        "columns, not rows": csc_array(MATRIX),
        "a dense array": MATRIX.toarray(),
        "a number": 3,
    }
    return {f"{name}: {what}": lambda lie=lie: call(lie) for what, lie in lies.items()}  # type: ignore[misc]


def hostile_samples(name: str, call: Callable[[Any], Any]) -> dict[str, Call]:
    lies = {
        "NaN": samples(values=changed(VALUES, (1, 2), NAN)),
        "infinity": samples(values=changed(VALUES, (1, 2), -INF)),
        "beyond float32": samples(values=changed(VALUES.astype(float), (1, 2), 1e300)),
        "one pattern too few": samples(values=VALUES[:, 1:]),
        "one axis": samples(values=VALUES[0]),
        "three axes": samples(values=VALUES[None]),
        "float16": samples(values=VALUES.astype(np.float16)),
        "whole numbers": samples(values=VALUES.astype(np.int32)),
        "another byte order": samples(values=VALUES.astype(">f4")),
        "a list": samples(values=VALUES.tolist()),
        "objects": samples(values=VALUES.astype(object)),
        "clipped of bytes": samples(clipped=CLIPPED.astype(np.uint8)),
        "clipped neither 0 nor 1": samples(clipped=np.full(CLIPPED.shape, 2, np.uint8).view(bool)),
        "clipped of other rows": samples(clipped=CLIPPED[1:]),
        "clipped missing": SimpleNamespace(values=VALUES, weights=None),
        "weight below 0": samples(weights=np.full(PATTERNS, -1.0)),
        "weight NaN": samples(weights=np.full(VALUES.shape, NAN)),
        "weights of other patterns": samples(weights=np.ones(PATTERNS + 1)),
        "weights of other rows": samples(weights=np.ones((ROWS - 1, PATTERNS))),
        "weights of three axes": samples(weights=np.ones((1, ROWS, PATTERNS))),
        "weights of whole numbers": samples(weights=np.ones(PATTERNS, int)),
        "an array": VALUES,
        "a string": "samples",
    }
    return {f"{name}: {what}": lambda lie=lie: call(lie) for what, lie in lies.items()}  # type: ignore[misc]


def hostile_products() -> dict[str, Call]:
    x, e = np.ones((2, PIXELS), np.float32), np.ones((2, PATTERNS))
    stride = BITS.shape[1]
    wide = np.broadcast_to(np.uint8(0), (0, stride))
    index = np.arange(3)
    return {
        "forward: one pixel too few": lambda: _core.bits_forward(BITS, PIXELS, x[:, 1:]),
        "forward: one axis": lambda: _core.bits_forward(BITS, PIXELS, x[0]),
        "forward: whole numbers": lambda: _core.bits_forward(BITS, PIXELS, x.astype(int)),
        "forward: a list": lambda: _core.bits_forward(BITS, PIXELS, x.tolist()),  # type: ignore[arg-type]
        "forward: pixels below 0": lambda: _core.bits_forward(BITS, -1, x),
        "forward: pixels huge": lambda: _core.bits_forward(BITS, 2**64, x),
        "forward: pixels of more bytes": lambda: _core.bits_forward(BITS, 8 * stride + 1, x),
        "forward: bits of int8": lambda: _core.bits_forward(BITS.astype(np.int8), PIXELS, x),
        "forward: bits of one axis": lambda: _core.bits_forward(BITS[0], PIXELS, x),
        "forward: a product of 2^60 numbers": lambda: _core.bits_forward(
            np.zeros((2**30, 0), np.uint8), 0, np.zeros((2**30, 0), np.float32)
        ),
        "forward: a product that overflows": lambda: _core.bits_forward(
            np.zeros((2**59, 0), np.uint8), 0, np.zeros((2**59, 0), np.float32)
        ),
        "adjoint: one pattern too few": lambda: _core.bits_adjoint(BITS, PIXELS, e[:, 1:]),
        "adjoint: float16": lambda: _core.bits_adjoint(BITS, PIXELS, e.astype(np.float16)),
        "adjoint: a product of 2^60 numbers": lambda: _core.bits_adjoint(
            np.zeros((0, 2**28), np.uint8), 2**31 - 1, np.zeros((2**29, 0), np.float32)
        ),
        "adjoint: more pixels than int32": lambda: _core.bits_adjoint(wide, 2**31, e),
        "columns: index below 0": lambda: _core.bits_columns(BITS, PIXELS, index - 1),
        "columns: index too large": lambda: _core.bits_columns(BITS, PIXELS, index + PIXELS - 2),
        "columns: index of floats": lambda: _core.bits_columns(BITS, PIXELS, index + 0.5),  # type: ignore[arg-type]
        "columns: index of two axes": lambda: _core.bits_columns(BITS, PIXELS, index[None]),
        "hadamard: 6 values": lambda: _core.hadamard(np.ones((2, 6))),
        "hadamard: no values": lambda: _core.hadamard(np.ones((2, 0))),
        "hadamard: one axis": lambda: _core.hadamard(np.ones(8)),
        "hadamard: complex": lambda: _core.hadamard(np.ones((2, 8), complex)),
        "moments: other shape": lambda: moments(shape=(2, 4)),
        "moments: huge shape": lambda: moments(shape=(HUGE, HUGE)),
        "moments: one image alone": lambda: moments(images=np.ones(6, np.float32)),
        "moments: float64": lambda: moments(images=np.ones((2, 6))),
        "moments: None": lambda: moments(images=None),
        "moments: empty kernel": lambda: moments(kernel=np.zeros(0, np.float32)),
        "moments: NaN in the kernel": lambda: moments(kernel=np.full(2, np.nan, np.float32)),
        "moments: bright kernel": lambda: moments(kernel=np.ones(3, np.float32)),
        "rows_times: other widths": lambda: rows_times(matrix=np.ones((5, 4), np.float32)),
        "rows_times: a row alone": lambda: rows_times(rows=np.ones(3, np.float32)),
        "rows_times: one axis": lambda: rows_times(matrix=np.ones(3, np.float32)),
        "rows_times: float64": lambda: rows_times(rows=np.ones((2, 3))),
        "rows_times: None": lambda: rows_times(matrix=None),
        "hadamard: None": lambda: _core.hadamard(None),  # type: ignore[arg-type]
    }


def hostile_patterns() -> dict[str, Call]:
    make, dense = _core.PreparedPatterns.from_bits, _core.PreparedPatterns.from_dense
    fast = HadamardPatterns(SHAPE, PATTERNS, order="random", permute=True)
    length, rows, places = fast.transform_size, fast.selected, fast.position
    matrix = SHOWN_SET.dense()

    def turned(length: Any = length, rows: Any = rows, places: Any = places) -> Any:
        return make(BITS, PIXELS, MEANS, (length, rows, places))

    return {
        "bits: no patterns": lambda: make(BITS[:0], PIXELS, MEANS[:0]),
        "bits: no pixels": lambda: make(BITS[:, :0], 0, MEANS),
        "bits: no patterns of 2^31 pixels": lambda: make(
            np.zeros((0, 2**28), np.uint8), 2**31 - 1, MEANS[:0]
        ),
        "bits: pixels below 0": lambda: make(BITS, -5, MEANS),
        "bits: means too few": lambda: make(BITS, PIXELS, MEANS[1:]),
        "bits: means NaN": lambda: make(BITS, PIXELS, MEANS * NAN),
        "bits: means of two axes": lambda: make(BITS, PIXELS, MEANS[None]),
        "bits: unknown instructions": lambda: make(BITS, PIXELS, MEANS, None, "abacus"),
        "transform: length 24": lambda: turned(24),
        "transform: length 0": lambda: turned(0),
        "transform: length below 0": lambda: turned(-(2**70)),
        "transform: length 2^62": lambda: turned(2**62),
        "transform: length too short": lambda: turned(2),
        "transform: row below 0": lambda: turned(rows=changed(rows, 0, -1)),
        "transform: row too large": lambda: turned(rows=changed(rows, 0, length)),
        "transform: row twice": lambda: turned(rows=changed(rows, 0, rows[1])),
        "transform: rows too few": lambda: turned(rows=rows[1:]),
        "transform: place too large": lambda: turned(places=changed(places, 0, 2**40)),
        "transform: place twice": lambda: turned(places=changed(places, 0, places[1])),
        "transform: places too many": lambda: turned(places=np.append(places, places)),
        "transform: two parts": lambda: make(BITS, PIXELS, MEANS, (length, rows)),  # type: ignore[arg-type]
        "dense: above 1": lambda: dense(matrix * 1.5, MEANS),
        "dense: below 0": lambda: dense(-matrix, MEANS),
        "dense: NaN": lambda: dense(matrix * np.float32(NAN), MEANS),
        "dense: float64": lambda: dense(matrix.astype(float), MEANS),
        "dense: no pixels": lambda: dense(matrix[:, :0], MEANS),
        "dense: one axis": lambda: dense(matrix[0], MEANS),
        "scores: one pattern too few": lambda: SHOWN.scores(np.ones((2, PATTERNS - 1))),
        "scores: NaN": lambda: SHOWN.scores(np.full((2, PATTERNS), NAN)),
        "scores: one axis": lambda: SHOWN.scores(np.ones(PATTERNS)),
        "pass: infinity": lambda: SHOWN.pass_only(np.full((2, PATTERNS), INF)),
        "no constructor": lambda: _core.PreparedPatterns(),
    }


def hostile_settings() -> dict[str, Call]:
    lies: dict[str, list[Any]] = {
        "regularization": [0, -1, NAN, INF, 10**400, "much", None],
        "fidelity": ["clipped", "", "ONE-SIDED", 3, None],
        "nonnegative": ["yes", None, np.ones(3)],
        "background": [2.5],
        "tolerance": [0, 1, -1e-3, NAN, INF, "little"],
        "max_passes": [0, -1, 2**31, 2**32, 2**70, 1.5, None],
        "threads": [0, -1, 1025, 2**31, 2**32, 2**63, 2**64, -(2**80), 1.5, "all"],
    }
    return {
        f"settings: {name} {str(lie)[:9]}": lambda name=name, lie=lie: chosen(**{name: lie})  # type: ignore[misc]
        for name, values in lies.items()
        for lie in values
    }


def hostile_rows() -> dict[str, Call]:
    twice = MATRIX.indices.copy()
    start = MATRIX.indptr[np.argmax(np.diff(MATRIX.indptr) > 1)]
    twice[start + 1] = twice[start]
    falling = twice.copy()
    falling[start], falling[start + 1] = MATRIX.indices[start + 1], MATRIX.indices[start]
    data = MATRIX.data
    wide = np.ones((ROWS, PATTERNS + UNSEEN), np.float32)
    return {
        "solve: settings of another kind": lambda: solve(chosen_=SimpleNamespace(threads=1)),
        "solve: progress no function": lambda: solve(progress=3),
        "start: a pixel twice": lambda: solve(start=begin(coefficients=sparse(indices=twice))),
        "start: background too short": lambda: solve(
            start=begin(background=np.zeros((ROWS - 1, 1)))
        ),
        "start: background NaN": lambda: solve(start=begin(background=np.full((ROWS, 1), NAN))),
        "start: an array": lambda: solve(start=np.zeros((ROWS, PIXELS))),
        "candidates: a pixel twice": lambda: weighted(sparse(indices=twice)),
        "candidates: pixels that fall": lambda: weighted(sparse(indices=falling)),
        "candidates: penalty 0": lambda: weighted(sparse(data=changed(data, 0, 0))),
        "candidates: penalty below 0": lambda: weighted(sparse(data=changed(data, 0, -1))),
        "cells: mean above 1": lambda: weighted(cells=cells(means=cells().means * 3)),
        "cells: means NaN": lambda: weighted(cells=cells(means=cells().means * NAN)),
        "cells: of other patterns": lambda: weighted(cells=cells(means=wide[:2])),
        "cells: penalties too few": lambda: weighted(cells=cells(penalties=np.ones(1))),
        "cells: penalty 0": lambda: weighted(cells=cells(penalties=np.zeros(2))),
        "cells: no means": lambda: weighted(cells=3),
        "cells: start of one dimension": lambda: weighted(
            cells=cells(), start=begin(background=np.zeros(ROWS))
        ),
        "cells: start without a column": lambda: weighted(
            cells=cells(), start=begin(background=np.zeros((ROWS, 0)))
        ),
        "weighted: background of other patterns": lambda: weighted(background=wide),
        "weighted: background NaN": lambda: weighted(background=wide[:, :PATTERNS] * NAN),
        "further: of other pixels": lambda: weighted(expected=(OTHER, expectation())),
        "further: values of other rows": lambda: weighted(
            expected=(UNSHOWN, expectation(values=wide[1:]))
        ),
        "further: weight below 0": lambda: weighted(expected=(UNSHOWN, expectation(weights=-wide))),
        "further: values NaN": lambda: weighted(
            expected=(UNSHOWN, expectation(values=wide * np.float32(NAN)))
        ),
        "further: no pair": lambda: weighted(expected=expectation()),
        "further: no patterns": lambda: weighted(expected=(None, expectation())),
        "expected: shown of other pixels": lambda: expected(shown=OTHER),
        "expected: unseen of other pixels": lambda: expected(unseen=OTHER),
        "expected: level 0": lambda: expected(level=0),
        "expected: level NaN": lambda: expected(level=NAN),
        "expected: start below 0": lambda: expected(start=-1),
        "expected: start too late": lambda: expected(start=1),
        "expected: start huge": lambda: expected(start=2**64 - 1),
        "expected: reach below 0": lambda: expected(reach=-1),
        "expected: reach huge": lambda: expected(reach=2**63),
        "expected: movement NaN": lambda: expected(
            near=around(movement=np.full((ROWS, 4), NAN, np.float32))
        ),
        "expected: movement of other rows": lambda: expected(
            near=around(movement=np.zeros((ROWS - 1, 4), np.float32))
        ),
        "expected: background of other rows": lambda: expected(background=wide[1:]),
        "expected: background infinite": lambda: expected(background=wide * np.float32(INF)),
        "expected: huge camera": lambda: expected(near=around(camera=(HUGE, HUGE, 3))),
        "expected: other camera": lambda: expected(near=around(camera=(1, 1, 1))),
        "expected: no camera": lambda: expected(near=around(camera=(3, 4))),
        "expected: a camera of words": lambda: expected(near=around(camera="3x4")),
        "likely: huge camera": lambda: likely(camera=[HUGE, HUGE, 3]),
        "likely: camera of 2^93": lambda: likely(camera=[2**31 - 1] * 3),
        "likely: camera of no columns": lambda: likely(camera=(3, 0, 1)),
        "likely: camera below 0": lambda: likely(camera=(-3, -4, 1)),
        "likely: huge projector": lambda: likely(projector=(1, 2**20, 2**20)),
        "likely: other projector": lambda: likely(projector=(1, 1, 1)),
        "likely: projector of two": lambda: likely(projector=(4, 6)),
        "likely: projector of floats": lambda: likely(projector=(1, 4.0, 6.5)),
        "likely: movement of other rows": lambda: likely(movement=np.zeros((1, 4), np.float32)),
        "likely: movement NaN": lambda: likely(movement=np.full((ROWS, 4), NAN, np.float32)),
        "likely: no spots": lambda: likely(spots=[]),
        "likely: an empty spot": lambda: likely(spots=[np.zeros(0, np.float32)]),
        "likely: a spot above 1": lambda: likely(spots=[np.full(2, 3, np.float32)]),
        "likely: within 0": lambda: likely(within=0.0),
        "likely: within NaN": lambda: likely(within=NAN),
        "likely: wider of other planes": lambda: likely(wider=np.ones(3, np.float32)),
        "likely: wider below 0": lambda: likely(wider=-np.ones(1, np.float32)),
        "likely: wider NaN": lambda: likely(wider=np.full(1, NAN, np.float32)),
        "likely: singles of other rows": lambda: likely(singles=np.ones(1, np.float32)),
        "likely: singles above 1": lambda: likely(singles=np.full(ROWS, 3, np.float32)),
        "likely: singles NaN": lambda: likely(singles=np.full(ROWS, NAN, np.float32)),
        "likely: doubts of other rows": lambda: likely(doubts=np.ones(1)),
        "likely: doubts of 0": lambda: likely(doubts=np.zeros(ROWS)),
        "likely: doubts NaN": lambda: likely(doubts=np.full(ROWS, NAN)),
        "columns: beyond": lambda: SHOWN.columns(np.array([SHOWN_SET.pixels])),
        "columns: below 0": lambda: SHOWN.columns(np.array([-1])),
        "columns: of two axes": lambda: SHOWN.columns(np.zeros((2, 2), np.int64)),
        "columns: floats": lambda: SHOWN.columns(cast(Any, np.zeros(1))),
        "atoms: other shape": lambda: SHOWN.atoms((2, 3), PLANES),
        "atoms: shape of three": lambda: SHOWN.atoms(cast(Any, (1, *SHAPE)), PLANES),
        "atoms: huge shape": lambda: SHOWN.atoms((HUGE, HUGE), PLANES),
        "atoms: no planes": lambda: SHOWN.atoms(SHAPE, []),
        "atoms: empty kernel": lambda: SHOWN.atoms(SHAPE, [(np.zeros(0, np.float32), 1.0)]),
        "atoms: dark kernel": lambda: SHOWN.atoms(SHAPE, [(np.zeros(3, np.float32), 1.0)]),
        "atoms: bright kernel": lambda: SHOWN.atoms(SHAPE, [(np.ones(3, np.float32), 1.0)]),
        "atoms: negative kernel": lambda: SHOWN.atoms(SHAPE, [(-np.ones(1, np.float32), 1.0)]),
        "atoms: kernel NaN": lambda: SHOWN.atoms(SHAPE, [(np.full(1, NAN, np.float32), 1.0)]),
        "atoms: gain 0": lambda: SHOWN.atoms(SHAPE, [(np.ones(1, np.float32), 0.0)]),
        "atoms: gain 2": lambda: SHOWN.atoms(SHAPE, [(np.ones(1, np.float32), 2.0)]),
        "atoms: gain NaN": lambda: SHOWN.atoms(SHAPE, [(np.ones(1, np.float32), NAN)]),
        "likely: reach below 0": lambda: likely(reach=(-1, 1)),
        "likely: reach huge": lambda: likely(reach=(2**64, 1)),
        "likely: none": lambda: likely(most=0),
        "likely: range back": lambda: likely(range=(5, 3)),
        "likely: range too long": lambda: likely(range=(0, ROWS + 1)),
        "likely: range below 0": lambda: likely(range=(-1, 3)),
        "likely: index beyond": lambda: likely(index=np.array([ROWS])),
        "likely: index below 0": lambda: likely(index=np.array([-1])),
        "likely: index twice": lambda: likely(index=np.array([1, 1])),
        "likely: index back": lambda: likely(index=np.array([1, 0])),
        "likely: index of floats": lambda: likely(index=np.zeros(1)),
        "expected: index of other rows": lambda: expected(index=np.arange(ROWS - 1)),
        "expected: index beyond": lambda: expected(index=np.arange(1, ROWS + 1)),
        "expected: index back": lambda: expected(index=np.arange(ROWS)[::-1]),
        "likely: range of one": lambda: likely(range=(1,)),
    }


HOSTILE: dict[str, Call] = {
    **hostile_products(),
    **hostile_patterns(),
    **hostile_settings(),
    **hostile_samples("solve", solve),
    **hostile_samples("weighted", lambda rows: weighted(rows=rows)),
    **hostile_samples("expected", lambda rows: expected(rows)),
    **hostile_sparse("start", lambda rows: solve(start=begin(coefficients=rows))),
    **hostile_sparse("candidates", weighted),
    **hostile_sparse("likely", likely),
    **hostile_sparse("expected", lambda rows: expected(near=around(rows=begin(coefficients=rows)))),
    **hostile_rows(),
}


if __name__ == "__main__":
    for case, call in HOSTILE.items():
        try:
            call()
        except ORDINARY:
            continue
        sys.exit(f"{case} was taken")
