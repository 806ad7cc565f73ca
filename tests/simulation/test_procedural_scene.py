"""The procedural matrix: the same for all blocks, with all its parts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.errors import InputError
from lightmatrix.simulation.procedural import ProceduralScene

shapes = st.tuples(st.integers(1, 9), st.integers(1, 9))


@settings(max_examples=25, deadline=None)
@given(shapes, shapes, st.integers(0, 5), st.integers(1, 30))
def test_blocks_of_any_size_give_the_same_matrix(
    camera: tuple[int, int], projector: tuple[int, int], seed: int, size: int
) -> None:
    scene = ProceduralScene(camera, projector, seed)
    whole = scene.truth()
    for start, rows, direct in scene.blocks(size):
        stop = start + rows.shape[0]
        part = whole.matrix[start:stop]
        np.testing.assert_array_equal(rows.toarray(), part.toarray())
        begin, end = whole.matrix.indptr[[start, stop]]
        np.testing.assert_array_equal(direct, whole.direct_data[begin:end])


@settings(max_examples=25, deadline=None)
@given(shapes, shapes, st.integers(0, 1000))
def test_entries_are_light(camera: tuple[int, int], projector: tuple[int, int], seed: int) -> None:
    truth = ProceduralScene(camera, projector, seed).truth()
    assert truth.matrix.shape == (camera[0] * camera[1], projector[0] * projector[1])
    assert (truth.matrix.data > 0).all()
    assert (truth.direct_data >= 0).all()
    assert (truth.direct_data <= truth.matrix.data * (1 + 1e-6)).all()
    assert truth.matrix.has_canonical_format


def test_direct_footprints_are_small_and_dominate() -> None:
    truth = ProceduralScene((32, 32), (32, 32), seed=1).truth()
    footprint = (truth.direct.toarray() > 0).sum(axis=1)
    assert footprint.max() <= 4
    assert np.median(footprint) >= 2
    lit = footprint > 0
    assert lit.mean() > 0.9
    share = truth.direct_data.sum() / truth.matrix.sum()
    # 1 direct, 0.3 interreflection of which some leaves the projector's field, 0.05 background.
    assert 1 / 1.36 < share < 1 / 1.15


def test_depth_edges_break_the_footprints_order() -> None:
    scene = ProceduralScene((64, 64), (64, 64), seed=0, relief=0.2)
    direct = scene.truth().direct
    column = (direct @ (np.arange(64 * 64) % 64)) / np.maximum(direct.sum(axis=1), 1e-9)
    jumps = np.abs(np.diff(column.reshape(64, 64), axis=1))
    assert (jumps > 3).any()
    assert np.median(jumps) < 1.2


def test_without_bounces_and_background_only_direct_light_is_left() -> None:
    truth = ProceduralScene((8, 8), (8, 8), bounces=0, background=0).truth()
    np.testing.assert_array_equal(truth.direct_data, truth.matrix.data)


def test_a_large_one_is_made_in_pieces() -> None:
    scene = ProceduralScene((2048, 2048), (1024, 1024))
    rows, _ = scene.rows(1_000_000, 1_000_256)
    assert rows.shape == (256, 1024 * 1024)
    assert 60 < rows.nnz / 256 < 101


@pytest.mark.parametrize(
    "options",
    [
        {"camera_shape": (0, 4)},
        {"projector_shape": (4, 0)},
        {"bounces": -1},
        {"indirect": -0.1},
        {"background": float("nan")},
        {"relief": 2.0},
    ],
)
def test_impossible_scenes_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError):
        ProceduralScene(**{"camera_shape": (4, 4), "projector_shape": (4, 4), **options})  # type: ignore[arg-type]
