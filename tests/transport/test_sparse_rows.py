"""`SparseRows`: split, joined, saved and read back; damaged ones are refused."""

from __future__ import annotations

import itertools
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.transport.sparse_rows import SparseRows, footprint_sizes, row_blocks, stack_rows
from lightmatrix.transport.store import save_rows


def rows(count: int = 7, pixels: int = 9, background: int = 2) -> SparseRows:
    random = np.random.default_rng(count)
    dense = random.random((count, pixels)) * (random.random((count, pixels)) < 0.4)
    return SparseRows(
        csr_array(dense.astype(np.float32)),
        random.random((count, background)).astype(np.float32),
        {"gap": random.random(count), "converged": random.random(count) < 0.5},
    )


def same(one: SparseRows, other: SparseRows) -> None:
    np.testing.assert_array_equal(one.coefficients.toarray(), other.coefficients.toarray())
    np.testing.assert_array_equal(one.background, other.background)
    assert list(one.diagnostics) == list(other.diagnostics)
    for name, values in one.diagnostics.items():
        np.testing.assert_array_equal(values, other.diagnostics[name])
        assert values.dtype == other.diagnostics[name].dtype


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1e-6, 1.0, 1e6]))
def test_rounded_rows_err_by_little(seed: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    data, background = scale * random.lognormal(sigma=3, size=(2, 4, 6))
    background[0] = 0
    made = SparseRows(csr_array(data), -background).rounded()
    np.testing.assert_allclose(made.coefficients.toarray(), data, rtol=1.001 * 2.0**-12)
    assert np.all(
        np.abs(made.background + background) <= 1.001 * 2.0**-12 * background.max(1)[:, None]
    )
    assert made.background.dtype == made.coefficients.dtype == np.float32


def test_rounded_rows_compress_better(tmp_path: Path) -> None:
    whole = rows(2000, 60, 64)
    for name, kept in (("whole", whole), ("rounded", whole.rounded())):
        save_rows(tmp_path / f"{name}.zarr", [kept], (40, 50), (6, 10), (8, 8), {}, False)
    sizes = [
        sum(f.stat().st_size for f in (tmp_path / f"{name}.zarr" / part).rglob("*") if f.is_file())
        for name in ("rounded", "whole") for part in ("background", "data")
    ]  # fmt: skip
    assert sizes[0] < 0.65 * sizes[2]
    assert sizes[1] < 0.65 * sizes[3]


def test_joining_undoes_splitting_in_any_order() -> None:
    whole = rows()
    same(SparseRows.joined([whole.rows(slice(0, 3)), whole.rows(slice(3, 7))]), whole)
    order = np.random.default_rng(0).permutation(7)
    parts = [whole.rows(order[:4]), whole.rows(order[4:])]
    same(SparseRows.joined(parts).rows(np.argsort(order)), whole)
    assert SparseRows.joined(parts).count == 7


@given(st.lists(st.integers(0, 7), max_size=5), st.tuples(st.integers(0, 9), st.integers(0, 99)))
def test_parts_that_are_made_one_after_the_other_are_joined(
    cuts: list[int], spare: tuple[int, int]
) -> None:
    whole = rows()
    edges = [0, *sorted(cuts), 7]
    parts = (whole.rows(slice(*edge)) for edge in itertools.pairwise(edges))
    bound = 7 + spare[0], whole.coefficients.nnz + spare[1]
    same(SparseRows.joined(parts, bound), whole)


@pytest.mark.parametrize(
    "other",
    [
        rows(pixels=8),
        rows(background=1),
        replace(rows(), diagnostics={"gap": np.zeros(7)}),
        replace(rows(), coefficients=csr_array((7, 9))),
    ],
    ids=["columns", "background", "diagnostics", "precision"],
)
def test_parts_that_differ_are_not_joined(other: SparseRows) -> None:
    with pytest.raises(ValueError, match="parts of rows differ"):
        SparseRows.joined([rows(), other])


def test_joined_rows_are_in_memory_once() -> None:
    whole = rows(4000, 60, 64)

    def parts() -> Iterator[SparseRows]:
        for start in range(0, 4000, 100):
            yield whole.rows(slice(start, start + 100))

    tracemalloc.start()
    joined = SparseRows.joined(parts(), (4000, whole.coefficients.nnz))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.3 * sum(array.nbytes for array in joined.arrays().values())


def test_arrays_hold_everything() -> None:
    whole = rows()
    same(SparseRows.from_arrays(whole.arrays()), whole)


def test_single_precision() -> None:
    whole = rows()
    double = replace(
        whole,
        coefficients=csr_array(whole.coefficients, dtype=np.float64),
        background=whole.background.astype(np.float64),
    )
    assert double.single().coefficients.dtype == double.single().background.dtype == np.float32
    same(double.single(), whole)


def _with(name: str, change: Any) -> dict[str, Any]:
    arrays = rows().arrays()
    arrays[name] = change(np.array(arrays[name]))
    return arrays


def _set(place: int, value: float) -> Any:
    def change(array: Any) -> Any:
        array.flat[place] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("indices", _set(3, 9)),
        ("indices", _set(3, -1)),
        ("indptr", _set(2, 1000)),
        ("indptr", _set(0, 1)),
        ("indptr", lambda array: array[:-1]),
        ("data", _set(0, np.nan)),
        ("data", lambda array: array[:-1]),
        ("data", lambda array: array.astype(complex)),
        ("shape", _set(0, 6)),
        ("shape", lambda array: array[0]),
        ("shape", lambda array: array[:1]),
        ("background", _set(0, np.inf)),
        ("background", lambda array: array[:, 0]),
        ("background", lambda array: array[1:]),
        ("diagnostic_gap", lambda array: array[1:]),
    ],
)
def test_damaged_arrays_are_refused(name: str, change: Any) -> None:
    with pytest.raises(InputError, match=r"rows|indices|numbers"):
        SparseRows.from_arrays(_with(name, change))


def test_stacked_rows_have_indices_of_32_bits() -> None:
    wide = csr_array(rows().coefficients)
    wide.indices, wide.indptr = (part.astype(np.int64) for part in (wide.indices, wide.indptr))
    stacked = stack_rows([wide, wide])
    assert {stacked.indices.dtype, stacked.indptr.dtype} == {np.dtype(np.int32)}
    np.testing.assert_array_equal(stacked.toarray(), np.vstack([wide.toarray()] * 2))


def test_blocks_of_rows_have_about_equally_many_entries() -> None:
    entries = np.array([3, 0, 5, 1, 4, 2, 6, 3])
    ends = np.concatenate([[0], np.cumsum(entries)])
    cuts = row_blocks(ends, 8)
    assert (cuts[0], cuts[-1]) == (0, 8)
    assert (np.diff(cuts) > 0).all()
    # 24 entries in blocks of 8, give or take a row.
    assert len(cuts) == 4
    assert (np.diff(ends[cuts]) < 8 + entries.max()).all()
    np.testing.assert_array_equal(row_blocks(ends, 100), [0, 8])
    np.testing.assert_array_equal(row_blocks(ends, 23), [0, 5, 8])


def test_footprint_sizes_count_equal_entries() -> None:
    dense = np.array([[2.0, 2, 2, 0], [0, 0, 0, 0], [5, 0, 0, 0], [3, 1, 0, 0]])
    sizes = footprint_sizes(csr_array(dense))
    np.testing.assert_allclose(sizes, [3, 0, 1, 1.6])
