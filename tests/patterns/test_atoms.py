"""Atoms: a spot's column is the blurred pattern, whatever computes it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.estimators.coherent import neighbourhood
from lightmatrix.estimators.coherent.neighbourhood import Neighbourhood
from lightmatrix.patterns.atoms import AtomPatterns, Sheet, boxes_around
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.transport.sparse_rows import SparseRows

SIZES = (0.0, 0.7, 1.4)


def kinds(shape: tuple[int, int], count: int, seed: int) -> list[PatternSet]:
    grey = np.random.default_rng(seed).random((count, *shape)).astype(np.float32)
    return [BernoulliPatterns(shape, count, seed=seed), ImagePatterns(grey)]


@settings(max_examples=20, deadline=None)
@given(st.tuples(st.integers(1, 20), st.integers(1, 20)), st.integers(2, 70), st.integers(0, 2**16))
def test_forward_and_adjoint_belong_together(shape: Any, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    for patterns in kinds(shape, count, seed):
        atoms = AtomPatterns(patterns, SIZES)
        x = random.standard_normal((3, atoms.pixels))
        e = random.standard_normal((3, count))
        one, other = np.sum(atoms.forward(x) * e), np.sum(x * atoms.adjoint(e))
        scale = np.abs(atoms.forward(np.abs(x))).sum() * np.abs(e).max()
        assert abs(one - other) <= 1e-6 * scale
        dense = atoms.dense().astype(np.float64)
        np.testing.assert_allclose(atoms.adjoint(e), e @ dense, atol=1e-5 * np.abs(e).sum())
        index = np.array([0, atoms.pixels - 1])
        assert np.array_equal(atoms.columns(index), atoms.dense()[:, index])


@settings(max_examples=15, deadline=None)
@given(st.tuples(st.integers(1, 20), st.integers(1, 20)), st.integers(2, 70), st.integers(0, 2**16))
def test_the_compiled_pass_bounds_every_correlation(shape: Any, count: int, seed: int) -> None:
    e = np.random.default_rng(seed).standard_normal((4, count))
    for patterns in kinds(shape, count, seed):
        atoms = AtomPatterns(patterns, SIZES)
        exact = atoms.adjoint(e)
        scores, bounds = atoms.prepared.scores(e)
        unit, offset, up, down = bounds.reshape(-1, 4, 1).transpose(1, 0, 2)
        # The plain twin rounds in single precision.
        slack = 1e-5 * np.abs(e).sum(axis=1, keepdims=True)
        assert (exact >= unit * (scores + offset - down) - slack).all()
        assert (exact <= unit * (scores + offset + up) + slack).all()
        # A 249th of the largest two tables for each of them, which are of six samples.
        assert (unit * (up + down) <= 0.04 * np.abs(e).sum(axis=1, keepdims=True) + slack).all()


@settings(max_examples=20, deadline=None)
@given(st.tuples(st.integers(1, 9), st.integers(1, 9)), st.integers(1, 70), st.integers(0, 99))
def test_patterns_are_laid_on_a_sheet(shape: Any, count: int, seed: int) -> None:
    pixels = np.random.default_rng(seed).integers(-1, shape[0] * shape[1], (5, 7))
    for patterns in kinds(shape, count, seed):
        laid = patterns.laid(pixels)
        assert laid.shape == (5, 7)
        expected = np.where(pixels < 0, 0, patterns.dense()[:, pixels])
        np.testing.assert_array_equal(laid.images(), expected)
        np.testing.assert_allclose(laid.sums, expected.sum(axis=(1, 2), dtype=float))


@settings(max_examples=15, deadline=None)
@given(
    st.tuples(st.integers(1, 20), st.integers(1, 20)), st.integers(2, 70), st.booleans(), st.data()
)
def test_only_the_wanted_atoms_are_made(shape: Any, count: int, narrow: bool, data: Any) -> None:
    for patterns in kinds(shape, count, 1):
        atoms = AtomPatterns(patterns, SIZES, narrow=narrow)
        whole = atoms.prepared.columns(np.arange(atoms.pixels))
        wanted = np.unique(data.draw(st.lists(st.integers(0, atoms.pixels - 1), max_size=30)))
        wanted = wanted.astype(np.int64)
        some = replace(atoms, wanted=wanted).prepared.columns(np.arange(atoms.pixels))
        np.testing.assert_allclose(some[wanted], whole[wanted], atol=2e-5)
        assert not np.delete(some, wanted, axis=0).any()


def test_wanted_atoms_must_be_there() -> None:
    atoms = AtomPatterns(BernoulliPatterns((4, 5), 8), SIZES, wanted=np.array([60]))
    with pytest.raises(ValueError, match="atom 60 of 60"):
        _ = atoms.prepared


def test_the_fast_transform_serves_atoms_too() -> None:
    atoms = AtomPatterns(HadamardPatterns((8, 8), 40), SIZES)
    e = np.random.default_rng(0).standard_normal((2, 40))
    scores, bounds = atoms.prepared.scores(e)
    unit, offset, *_ = bounds.reshape(-1, 4, 1).transpose(1, 0, 2)
    np.testing.assert_allclose(unit * (scores + offset), atoms.adjoint(e), atol=0.05)


def test_a_spot_is_a_blurred_pixel() -> None:
    atoms = AtomPatterns(BernoulliPatterns((32, 40), 8), (0.0, 1.0, 2.0))
    assert atoms.gains[0] < atoms.gains[1] < atoms.gains[2] == 1
    n = 32 * 40
    place = 16 * 40 + 20
    rows = csr_array(
        (np.array([1, 1], np.float32), np.array([n + place, 2 * n + place]), np.array([0, 1, 2])),
        shape=(2, 3 * n),
    )
    point = np.zeros((32, 40))
    point[16, 20] = 1
    for row, size, gain in zip(atoms.expand(rows).toarray(), (1, 2), atoms.gains[1:], strict=True):
        spot = gaussian_filter(point, size, truncate=3)
        assert row.sum() == pytest.approx(gain, rel=1e-3)
        # Pixels of a spot below a thousandth of its middle are left out.
        np.testing.assert_allclose(row.reshape(32, 40) / gain, spot, atol=4e-3 * spot.max())
    centres = atoms.centres(rows).toarray()
    np.testing.assert_allclose(centres[:, place], atoms.gains[1:], rtol=1e-6)


def test_light_beyond_the_projector_is_lost() -> None:
    atoms = AtomPatterns(BernoulliPatterns((32, 32), 8), (0.0, 2.0))
    corner = csr_array((np.ones(1, np.float32), np.array([1024]), np.array([0, 1])), (1, 2048))
    # A quarter of a spot lies on the projector, and half of its two middle lines more.
    assert 0.25 < atoms.expand(corner).sum() < 0.4
    white = ImagePatterns(np.ones((1, 32, 32), np.float32))
    under_white = AtomPatterns(white, atoms.sizes, atoms.gains).columns(np.array([1024]))
    assert atoms.expand(corner).sum() == pytest.approx(under_white[0, 0], rel=5e-3)


def test_columns_of_all_sizes_have_the_same_contrast() -> None:
    atoms = AtomPatterns(BernoulliPatterns((64, 64), 200, density=0.3), (0.0, 1.0, 2.0))
    assert atoms.single_contrast == pytest.approx(np.sqrt(0.3 * 0.7), rel=0.01)
    n = 64 * 64
    spread = [atoms.dense()[:, s * n : (s + 1) * n].std() for s in range(3)]
    np.testing.assert_allclose(spread, spread[0], rtol=0.02)


def test_smooth_patterns_hardly_tell_neighbours_apart() -> None:
    random = BernoulliPatterns((32, 32), 64)
    atoms = AtomPatterns(random, (0.0,))
    assert atoms.neighbour_contrast == pytest.approx(atoms.single_contrast, rel=0.03)
    blocks = random.dense().reshape(64, 32, 32).repeat(4, axis=1).repeat(4, axis=2)
    coarse = AtomPatterns(ImagePatterns(blocks[:, :32, :32]), (0.0,))
    # One step of four crosses from a block to the next.
    assert coarse.neighbour_contrast == pytest.approx(coarse.single_contrast / 2, rel=0.1)
    # Fine patterns among coarse ones tell neighbours apart.
    mixed = np.concatenate([blocks[:32, :32, :32], random.dense().reshape(64, 32, 32)[:32]])
    atoms = AtomPatterns(ImagePatterns(mixed), (0.0,))
    assert atoms.neighbour_contrast == pytest.approx(atoms.single_contrast, rel=0.03)


@settings(max_examples=25, deadline=None)
@given(st.tuples(st.integers(1, 90), st.integers(1, 90)), st.integers(1, 5), st.integers(0, 2**16))
def test_the_compiled_moments_are_those_of_blurred_images(
    shape: Any, count: int, seed: int
) -> None:
    grey = np.random.default_rng(seed).random((count, *shape)).astype(np.float32)
    atoms = AtomPatterns(ImagePatterns(grey), (0.0, 0.7, 4.0), (1.0, 1.0, 1.0))
    images = grey.reshape(count, -1)
    for plane, kernel in enumerate(atoms.kernels):
        moments = _core.blurred_moments(images, shape, kernel)
        values = atoms._scaled(images, plane).astype(np.float64)
        np.testing.assert_allclose(moments, (values.sum(), (values**2).sum()), rtol=1e-5)


@pytest.mark.parametrize(
    ("sizes", "gains"),
    [((), ()), ((1.0,), ()), ((0.0, 2.0, 1.0), ()), ((0.0, 1.0), (1.0,)), ((0.0,), (2.0,))],
)
def test_sizes_and_gains_out_of_range(sizes: Any, gains: Any) -> None:
    with pytest.raises(InputError, match=r"sizes|gains"):
        AtomPatterns(BernoulliPatterns((8, 8), 4), sizes, gains)


def test_single_pixels_are_believed_in_where_they_hold_light() -> None:
    """On the left all light is single pixels', on the right spots'; the last row found nothing."""
    atoms = AtomPatterns(BernoulliPatterns((8, 8), 16), (0.0, 1.0))
    camera = (30, 60, 1)
    light = np.zeros((30, 60, atoms.pixels), np.float32)
    light[:-1, :30, 5] = 1
    light[:-1, 30:, 64 + 5] = 2
    rows = csr_array(light.reshape(1800, -1))
    count = rows.shape[0]
    solved = SparseRows(rows, np.zeros((count, 1), np.float32), {})
    belief = Neighbourhood(solved, camera, atoms).singles.reshape(30, 60)
    np.testing.assert_array_equal(belief[:, :26], 1)
    constants = neighbourhood.LIKELY_ATOMS
    np.testing.assert_array_equal(belief[:, 34:], np.float32(constants.pixels_least))
    # Two of the nine columns around hold single pixels.
    share = 2 / 9 / constants.pixels_believed
    expected = max(share**constants.pixels_power, constants.pixels_least)
    np.testing.assert_allclose(belief[:, 32], expected, rtol=1e-5)


def test_a_sheet_holds_the_atoms_of_its_boxes() -> None:
    whole = AtomPatterns(BernoulliPatterns((70, 90), 6), SIZES)
    rows = csr_array((2, whole.pixels), dtype=np.float32).tolil()
    far = np.array([3, 40 * 90 + 4, 69 * 90 + 89])
    # One in each of the boxes, a spot at the border among them, and one beyond all boxes.
    rows[0, far], rows[1, 2 * 6300 + far[::-1]], rows[1, 20 * 90 + 60] = 1, 2, 5
    boxes = boxes_around(far, whole.shape)
    assert len(boxes) == 3
    sheet = Sheet.of(boxes, whole.shape, len(whole.kernels[-1]) - 1)
    laid = sheet.laid(csr_array(rows.tocsr()))
    part = whole.part(sheet.pixels)
    assert laid.shape == (2, part.pixels)
    assert laid.nnz == 6
    np.testing.assert_allclose(
        part.columns(laid.indices), whole.columns(rows.tocsr().indices[[0, 1, 2, 4, 5, 6]])
    )
    lifted = sheet.lifted(laid, whole.planes)
    rows[1, 20 * 90 + 60] = 0
    assert (lifted != rows.tocsr()).nnz == 0
