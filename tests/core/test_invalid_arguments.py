"""The compiled core refuses every invalid argument with an ordinary exception and a message."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from lightmatrix import _core
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from tests.helpers import core_arguments as core
from tests.helpers.core_arguments import (
    ALL,
    BITS,
    CLIPPED,
    MATRIX,
    MEANS,
    ORDINARY,
    PATTERNS,
    PIXELS,
    ROWS,
    SHAPE,
    SHOWN_SET,
    UNSHOWN,
    VALUES,
    cells,
    neighbourhood,
    pseudo_samples,
    samples,
    sparse_rows,
    start,
)

HUGE, NAN, INF = 2**40, float("nan"), float("inf")
OTHER_PIXELS = BernoulliPatterns((5, 5), PATTERNS).prepared


def changed(values: NDArray[Any], place: Any, value: Any) -> NDArray[Any]:
    values = values.copy()
    values[place] = value
    return values


def f4(*shape: int, fill: float = 1) -> NDArray[np.float32]:
    return np.full(shape, fill, np.float32)


def sparse_rows_that_do_not_fit() -> dict[str, Any]:
    indptr, indices, data = MATRIX.indptr, MATRIX.indices, MATRIX.data
    return {
        "index below 0": sparse_rows(indices=changed(indices, 3, -1)),
        "index too large": sparse_rows(indices=changed(indices, 3, PIXELS)),
        "int64 index too large": sparse_rows(indices=changed(indices.astype(np.int64), 3, 2**32)),
        "int64 index below 0": sparse_rows(indices=changed(indices.astype(np.int64), 3, -HUGE)),
        "indices of uint32": sparse_rows(indices=indices.astype(np.uint32)),
        "too few indices": sparse_rows(indices=indices[:-1]),
        "indptr falls": sparse_rows(indptr=changed(indptr, 4, len(data))),
        "indptr begins late": sparse_rows(indptr=changed(indptr, 0, 1)),
        "indptr ends late": sparse_rows(indptr=changed(indptr, -1, len(data) + 5)),
        "indptr ends early": sparse_rows(indptr=changed(indptr, -1, len(data) - 1)),
        "indptr below 0": sparse_rows(indptr=changed(indptr.astype(np.int64), 2, -(2**62))),
        "indptr too short": sparse_rows(indptr=indptr[:-1]),
        "indptr empty": sparse_rows(indptr=indptr[:0]),
        "indptr of floats": sparse_rows(indptr=indptr.astype(float)),
        "indptr of two axes": sparse_rows(indptr=indptr[None]),
        "too few data": sparse_rows(data=data[:-1]),
        "data of float16": sparse_rows(data=data.astype(np.float16)),
        "complex data": sparse_rows(data=data.astype(complex)),
        "data with NaN": sparse_rows(data=changed(data, 1, NAN)),
        "data with infinity": sparse_rows(data=changed(data, 1, INF)),
        "data beyond float32": sparse_rows(data=changed(data.astype(float), 1, 1e300)),
        "data in a list": sparse_rows(data=data.tolist()),
        "no data": SimpleNamespace(indptr=indptr, indices=indices),
        "another shape": csr_array((ROWS + 1, PIXELS), dtype=np.float32),
        "sparse columns": csc_array(MATRIX),
        "a dense array": MATRIX.toarray(),
        "a number": 3,
    }


def samples_that_do_not_fit() -> dict[str, Any]:
    return {
        "NaN": samples(values=changed(VALUES, (1, 2), NAN)),
        "infinity": samples(values=changed(VALUES, (1, 2), -INF)),
        "beyond float32": samples(values=changed(VALUES.astype(float), (1, 2), 1e300)),
        "too few patterns": samples(values=VALUES[:, 1:]),
        "one axis": samples(values=VALUES[0]),
        "three axes": samples(values=VALUES[None]),
        "float16": samples(values=VALUES.astype(np.float16)),
        "integers": samples(values=VALUES.astype(np.int32)),
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
        "weights of integers": samples(weights=np.ones(PATTERNS, int)),
        "an array": VALUES,
        "a string": "samples",
    }


def repeated_and_falling_pixels() -> tuple[Any, Any]:
    """Sparse rows with a pixel twice in one row, and with two pixels in falling order."""
    first = MATRIX.indptr[np.argmax(np.diff(MATRIX.indptr) > 1)]
    twice = changed(MATRIX.indices, first + 1, MATRIX.indices[first])
    falling = changed(MATRIX.indices, first, MATRIX.indices[first + 1])
    falling[first + 1] = MATRIX.indices[first]
    return sparse_rows(indices=twice), sparse_rows(indices=falling)


def transforms_that_do_not_fit() -> list[Any]:
    fast = HadamardPatterns(SHAPE, PATTERNS, order="random", permute=True)
    length, rows, places = fast.transform_size, fast.selected, fast.position
    return [
        *((bad, rows, places) for bad in (24, 0, 2, -(2**70), 2**62)),
        (length, changed(rows, 0, -1), places),
        (length, changed(rows, 0, length), places),
        (length, changed(rows, 0, rows[1]), places),
        (length, rows[1:], places),
        (length, rows, changed(places, 0, HUGE)),
        (length, rows, changed(places, 0, places[1])),
        (length, rows, np.append(places, places)),
        (length, rows),
    ]


TWICE, FALLING = repeated_and_falling_pixels()
DENSE = SHOWN_SET.dense()

# For each function, parameters with invalid values. All other arguments are valid.
INVALID: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (core.forward, {
        "x": [f4(2, PIXELS - 1), f4(PIXELS), np.ones((2, PIXELS), int), [[1.0] * PIXELS]],
        "pixels": [-1, 2**64, 8 * BITS.shape[1] + 1, 99],
        "packed": [BITS.astype(np.int8), BITS[0]],
    }),
    (core.adjoint, {
        "e": [f4(2, PATTERNS - 1), np.ones((2, PATTERNS), np.float16)],
        "pixels": [2**31],
    }),
    (core.columns_of_bits, {
        "index": [np.arange(3) - 1, np.arange(3) + PIXELS - 2, np.zeros(3), np.zeros((1, 3), int)],
    }),
    (core.hadamard, {
        "x": [np.ones((2, 6)), np.ones((2, 0)), np.ones(8), np.ones((2, 8), complex), None],
    }),
    (core.moments, {
        "shape": [(2, 4), (HUGE, HUGE)],
        "images": [f4(6), np.ones((2, 6)), None],
        "kernel": [f4(0), f4(2, fill=NAN), f4(3)],
    }),
    (core.rows_times, {
        "matrix": [f4(5, 4), f4(3), None],
        "rows": [f4(3), np.ones((2, 3))],
    }),
    (core.from_bits, {
        "packed": [BITS[:0], BITS[:, :0]],
        "pixels": [-5],
        "means": [MEANS[1:], MEANS * NAN, MEANS[None]],
        "instructions": ["abacus"],
        "transform": transforms_that_do_not_fit(),
    }),
    (core.from_dense, {
        "matrix": [DENSE * 1.5, -DENSE, DENSE * np.float32(NAN), DENSE.astype(float),
                   DENSE[:, :0], DENSE[0]],
    }),
    (core.scores, {"e": [np.ones((2, PATTERNS - 1)), np.full((2, PATTERNS), NAN), MEANS]}),
    (core.pass_only, {"e": [np.full((2, PATTERNS), INF)]}),
    (core.columns, {
        "index": [np.array([PIXELS]), np.array([-1]), np.zeros((2, 2), int), np.zeros(1)],
    }),
    (core.atoms, {
        "shape": [(2, 3), (1, *SHAPE), (HUGE, HUGE)],
        "planes": [[], *([plane] for plane in (
            (f4(0), 1.0), (f4(3, fill=0), 1.0), (f4(3), 1.0), (-f4(1), 1.0), (f4(1, fill=NAN), 1.0),
            (f4(1), 0.0), (f4(1), 2.0), (f4(1), NAN),
        ))],
    }),
    (core.settings, {
        "regularization": [0, -1, NAN, INF, 10**400, "much", None],
        "fidelity": ["clipped", "", "ONE-SIDED", 3, None],
        "nonnegative": ["yes", None, np.ones(3)],
        "background": [2.5],
        "tolerance": [0, 1, -1e-3, NAN, INF, "little"],
        "max_passes": [0, -1, 2**31, 2**32, 2**70, 1.5, None],
        "threads": [0, -1, 1025, 2**31, 2**32, 2**63, 2**64, -(2**80), 1.5, "all"],
    }),
    (core.solve, {
        "samples": samples_that_do_not_fit(),
        "settings": [SimpleNamespace(threads=1)],
        "progress": [3],
        "start": [
            start(coefficients=TWICE), start(coefficients=MATRIX.toarray()),
            start(background=np.zeros((ROWS - 1, 1))), start(background=np.full((ROWS, 1), NAN)),
            np.zeros((ROWS, PIXELS)),
        ],
    }),
    (core.weighted, {
        "samples": {"too few patterns": samples(values=VALUES[:, 1:])},
        "candidates": [TWICE, FALLING, sparse_rows(data=changed(MATRIX.data, 0, 0)),
                       sparse_rows(data=changed(MATRIX.data, 0, -1)), MATRIX.toarray()],
        "cells": [
            cells(means=f4(2, PATTERNS, fill=1.5)), cells(means=f4(2, PATTERNS, fill=NAN)),
            cells(means=ALL[:2]), cells(penalties=np.ones(1)), cells(penalties=np.zeros(2)), 3,
        ],
        "start": [start(background=np.zeros(ROWS)), start(background=np.zeros((ROWS, 0)))],
        "background": [ALL, ALL[:, :PATTERNS] * np.float32(NAN)],
        "expected": [
            (OTHER_PIXELS, pseudo_samples()), (UNSHOWN, pseudo_samples(values=ALL[1:])),
            (UNSHOWN, pseudo_samples(weights=-ALL)), (None, pseudo_samples()), pseudo_samples(),
            (UNSHOWN, pseudo_samples(values=ALL * np.float32(NAN))),
        ],
    }),
    (core.expected, {
        "samples": {"too few patterns": samples(values=VALUES[:, 1:])},
        "shown": [OTHER_PIXELS],
        "unseen": [OTHER_PIXELS],
        "level": [0, NAN],
        "start": [-1, 1, 2**64 - 1],
        "reach": [-1, 2**63],
        "neighbourhood": [
            neighbourhood(rows=start(coefficients=MATRIX.toarray())),
            neighbourhood(jacobian=f4(ROWS, 4, fill=NAN)), neighbourhood(jacobian=f4(ROWS - 1, 4)),
            *(neighbourhood(camera=camera)
              for camera in ((HUGE, HUGE, 3), (1, 1, 1), (3, 4), "3x4")),
        ],
        "background": [ALL[1:], ALL * np.float32(INF)],
        "index": [np.arange(ROWS - 1), np.arange(1, ROWS + 1), np.arange(ROWS)[::-1]],
    }),
    (core.frames, {
        "rows": sparse_rows_that_do_not_fit(),
        "columns": [MATRIX, sparse_rows()],
        "background": [f4(ROWS), f4(ROWS, 1), f4(ROWS, 0), np.ones((ROWS, 2))],
        "cells": [np.full(PIXELS, 2), np.full(PIXELS, -1), np.zeros(PIXELS), np.zeros(3, int)],
        "samples": [f4(ROWS, 3), f4(ROWS - 1, 4), f4(0, 4)],
        "pixels": [f4(PIXELS, 4), f4(PIXELS + 1, 3), f4(0, 3)],
        "wanted": [[], [f4(ROWS)], [f4(ROWS)] * 17, [f4(ROWS), f4(ROWS - 1)], [f4(ROWS), None], 3],
        "last_pattern": [f4(ROWS)],
        "last_wanted": [f4(PIXELS)],
        "out": [f4(1, PIXELS), f4(2, ROWS), f4(PIXELS, 2).T, np.ones((2, PIXELS))],
        "room": [f4(9), np.ones(2000), f4(4000)[::2]],
        "ridge": [0, NAN],
        "tolerance": [-1],
        "steps": [0, -1, 2**40],
    }),
    (core.likely, {
        "rows": sparse_rows_that_do_not_fit(),
        "camera": [[HUGE, HUGE, 3], [2**31 - 1] * 3, (3, 0, 1), (-3, -4, 1)],
        "projector": [(1, 2**20, 2**20), (1, 1, 1), (4, 6), (1, 4.0, 6.5)],
        "jacobian": [f4(1, 4), f4(ROWS, 4, fill=NAN)],
        "spots": [[], [f4(0)], [f4(2, fill=3)]],
        "within": [0.0, NAN],
        "wider": [f4(3), -f4(1), f4(1, fill=NAN)],
        "singles": [f4(1), f4(ROWS, fill=3), f4(ROWS, fill=NAN)],
        "doubts": [np.ones(1), np.zeros(ROWS), np.full(ROWS, NAN)],
        "reach": [(-1, 1), (2**64, 1)],
        "most": [0],
        "range": [(5, 3), (0, ROWS + 1), (-1, 3), (1,)],
        "index": [*map(np.array, ([ROWS], [-1], [1, 1], [1, 0])), np.zeros(1)],
    }),
]  # fmt: skip


def _cases() -> list[Any]:
    cases = []
    for call, parameters in INVALID:
        for name, values in parameters.items():
            named = values if isinstance(values, dict) else dict(enumerate(values))
            for label, value in named.items():
                cases.append(pytest.param(call, name, value, id=f"{call.__name__}-{name}-{label}"))
    return cases


@pytest.mark.parametrize(("call", "name", "value"), _cases())
def test_invalid_arguments_are_refused(call: Callable[..., Any], name: str, value: Any) -> None:
    call()
    with pytest.raises(ORDINARY) as caught:
        call(**{name: value})
    assert str(caught.value)


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        (core.from_bits, {"instructions": "abacus"}, "abacus"),
        (core.scores, {"e": np.zeros((2, 8))}, "9 patterns"),
        (core.from_bits, {"pixels": 99}, "bytes a pattern"),
        (core.from_bits, {"means": np.zeros(3)}, "means has shape"),
        (core.from_dense, {"matrix": f4(2, 3, fill=1.5), "means": np.zeros(2)}, "outside"),
        (core.from_bits, {"transform": (24, np.arange(9), np.arange(24))}, "of length 24"),
        (core.likely, {"rows": sparse_rows(indptr=MATRIX.indptr[:-1])}, "rows.indptr"),
        (core.solve, {"samples": samples(weights=-f4(PATTERNS))}, "samples.weights"),
    ],
)
def test_messages_name_the_argument(
    call: Callable[..., Any], arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call(**arguments)


def test_prepared_patterns_have_no_constructor() -> None:
    with pytest.raises(TypeError):
        _core.PreparedPatterns()


@pytest.mark.parametrize(
    ("call", "arguments"),
    [
        # 2^60 numbers, and a number of numbers beyond 64 bits.
        (core.forward, {"packed": np.zeros((2**30, 0), np.uint8), "x": f4(2**30, 0)}),
        (core.forward, {"packed": np.zeros((2**59, 0), np.uint8), "x": f4(2**59, 0)}),
    ],
)
def test_products_without_memory_are_refused(
    call: Callable[..., Any], arguments: dict[str, Any]
) -> None:
    with pytest.raises(MemoryError):
        call(pixels=0, **arguments)


def test_patterns_of_2_to_the_31_pixels_without_memory_are_refused() -> None:
    none, pixels = np.zeros((0, 2**28), np.uint8), 2**31 - 1
    with pytest.raises(MemoryError):
        core.adjoint(packed=none, pixels=pixels, e=f4(2**29, 0))
    with pytest.raises(ORDINARY):
        core.from_bits(packed=none, pixels=pixels, means=MEANS[:0])
