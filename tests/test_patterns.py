"""Pattern sets are linear operators: adjoint identity, dense twin, digests, descriptions."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.errors import InputError
from lightmatrix.patterns import (
    BernoulliPatterns,
    BlockPatterns,
    HadamardPatterns,
    ImagePatterns,
    PatternSet,
    block_mean,
    from_description,
    one_pixel_patterns,
    sampled_pixels,
)

sizes = st.integers(1, 13)


@st.composite
def pattern_sets(draw: st.DrawFn) -> PatternSet:
    shape = (draw(sizes), draw(sizes))
    seed = draw(st.integers(0, 2**32))
    kind = draw(st.sampled_from(["bernoulli", "hadamard", "blocks", "images"]))
    if kind == "bernoulli":
        return BernoulliPatterns(shape, draw(sizes), draw(st.floats(0.01, 0.99)), seed)
    if kind == "hadamard":
        order = draw(st.sampled_from(["natural", "sequency", "random"]))
        count = min(draw(sizes), shape[0] * shape[1])
        return HadamardPatterns(shape, count, order, draw(st.booleans()), seed)
    if kind == "blocks":
        return BlockPatterns(shape, (draw(sizes), draw(sizes)))
    generator = np.random.default_rng(seed)
    return ImagePatterns(generator.random((draw(sizes), *shape)).astype(np.float32))


@given(pattern_sets(), st.integers(0, 4), st.sampled_from([np.float32, np.float64]))
@settings(max_examples=150, deadline=None)
def test_products_match_the_dense_matrix_and_are_adjoint(
    patterns: PatternSet, rows: int, dtype: type[np.floating]
) -> None:
    generator = np.random.default_rng(3)
    x = generator.standard_normal((rows, patterns.pixels)).astype(dtype)
    e = generator.standard_normal((rows, patterns.count)).astype(dtype)
    dense = patterns.dense().astype(np.float64)
    assert dense.shape == (patterns.count, patterns.pixels)

    samples, correlations = patterns.forward(x), patterns.adjoint(e)
    assert samples.dtype == correlations.dtype == dtype
    tolerance = 1e-4 if dtype is np.float32 else 1e-10
    np.testing.assert_allclose(samples, x @ dense.T, atol=tolerance)
    np.testing.assert_allclose(correlations, e @ dense, atol=tolerance)
    np.testing.assert_allclose((samples * e).sum(), (x * correlations).sum(), atol=10 * tolerance)
    np.testing.assert_allclose(patterns.means, dense.mean(axis=1), atol=1e-6)
    np.testing.assert_allclose(patterns.gram, dense @ dense.T, atol=1e-5)


@given(pattern_sets(), st.data())
@settings(max_examples=50, deadline=None)
def test_columns_rows_and_coarse_versions(patterns: PatternSet, data: st.DataObject) -> None:
    dense = patterns.dense()
    index = np.array(data.draw(st.lists(st.integers(0, patterns.pixels - 1), max_size=5)), int)
    np.testing.assert_array_equal(patterns.columns(index), dense[:, index])
    start = data.draw(st.integers(0, patterns.count))
    np.testing.assert_array_equal(patterns.rows(start, patterns.count), dense[start:])
    block = (data.draw(sizes), data.draw(sizes))
    coarse = patterns.coarse(block)
    for k in range(patterns.count):
        image = patterns.images()[k]
        for i, j in np.ndindex(coarse.shape):
            part = image[i * block[0] : (i + 1) * block[0], j * block[1] : (j + 1) * block[1]]
            assert coarse.images()[k, i, j] == pytest.approx(part.mean(), abs=1e-6)


@given(pattern_sets())
@settings(max_examples=40, deadline=None)
def test_descriptions_remake_the_set(patterns: PatternSet) -> None:
    remade = from_description(json.loads(json.dumps(patterns.description)))
    if isinstance(patterns, ImagePatterns):
        assert remade is None
    else:
        assert remade is not None
        assert remade.digest == patterns.digest
        np.testing.assert_array_equal(remade.dense(), patterns.dense())


def test_bernoulli_is_reproducible_and_has_its_density() -> None:
    one = BernoulliPatterns((64, 64), 40, density=0.3, seed=5)
    assert one.digest == BernoulliPatterns((64, 64), 40, density=0.3, seed=5).digest
    assert one.digest != BernoulliPatterns((64, 64), 40, density=0.3, seed=6).digest
    assert one.means.mean() == pytest.approx(0.3, abs=0.005)
    more = BernoulliPatterns((64, 64), 80, density=0.3, seed=5)
    np.testing.assert_array_equal(more.bits[:40], one.bits)


def test_hadamard_is_orthogonal_once_centred() -> None:
    patterns = HadamardPatterns((8, 16), 128, "sequency", permute=True, seed=2)
    signed = 2 * patterns.dense().astype(float) - 1
    np.testing.assert_array_equal(signed @ signed.T, 128 * np.eye(128))


def test_sequency_order_starts_with_low_frequencies() -> None:
    images = HadamardPatterns((8, 8), 64, "sequency").images()
    changes = [
        np.abs(np.diff(image[:, 0])).sum() + np.abs(np.diff(image[0])).sum() for image in images
    ]
    assert images[0].min() == 1
    assert changes == sorted(changes)


def test_hadamard_never_builds_the_matrix() -> None:
    patterns = HadamardPatterns((512, 512), 1024, "random", seed=1)
    e = np.zeros((1, 1024), np.float32)
    e[0, 7] = 1
    np.testing.assert_array_equal(patterns.adjoint(e)[0], patterns.rows(7, 8)[0])


def test_sampled_pixels_are_the_papers_256() -> None:
    index = sampled_pixels((128, 128))
    assert len(index) == 256
    assert index[0] == 4 * 128 + 4
    assert one_pixel_patterns((128, 128), index).count == 256


def test_block_mean_handles_uneven_blocks() -> None:
    image = np.arange(15, dtype=float).reshape(3, 5)
    np.testing.assert_allclose(block_mean(image, (2, 3)), [[3.5, 6.0], [11.0, 13.5]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BernoulliPatterns((0, 4), 3), "both at least 1"),
        (lambda: BernoulliPatterns((4, 4), 0), "0 patterns"),
        (lambda: BernoulliPatterns((4, 4), 3, density=1.0), "density of 1.0"),
        (lambda: HadamardPatterns((4, 4), 17), "there are 16"),
        (lambda: HadamardPatterns((4, 4), 2, "walsh"), "natural, sequency, random"),
        (lambda: BlockPatterns((4, 4), (0, 1)), "block"),
        (lambda: one_pixel_patterns((4, 4), np.array([16])), "use 0 to 15"),
        (lambda: ImagePatterns(np.full((2, 3, 3), 2.0, np.float32)), r"scale the patterns"),
        (lambda: ImagePatterns(np.zeros((3, 3), np.float32)), r"\(K, rows, cols\)"),
        (lambda: from_description({"kind": "bernoulli"}), "cannot be read"),
        (lambda: from_description({"kind": "moire"}), "unknown"),
    ],
)
def test_bad_patterns_are_refused_with_a_remedy(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]
