"""Binning a truth: what the coarse camera measures under coarse patterns stays the same."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import Truth, binned


@pytest.fixture(scope="module")
def truth() -> Truth:
    return ProceduralScene((12, 8), (8, 12), seed=2, background=0.05).truth()


@pytest.mark.parametrize("factor", [2, 4])
def test_images_under_coarse_patterns_are_the_binned_images(truth: Truth, factor: int) -> None:
    """The definition: coarse T times q is the block mean of T times q spread over its blocks."""
    small = binned(truth, factor)
    assert small.camera_shape == (12 // factor, 8 // factor)
    assert small.projector_shape == (8 // factor, 12 // factor)
    patterns = np.random.default_rng(0).random((5, *small.projector_shape)).astype(np.float32)
    fine = np.kron(patterns, np.ones((1, factor, factor), np.float32))
    for wide, narrow in ((truth.matrix, small.matrix), (truth.direct, small.direct)):
        images = (wide @ fine.reshape(5, -1).T).T.reshape(5, 12, 8)
        binned_images = (narrow @ patterns.reshape(5, -1).T).T.reshape(5, *small.camera_shape)
        np.testing.assert_allclose(binned_images, block_mean(images, (factor, factor)), rtol=1e-5)


def test_direct_light_stays_a_part_of_all_light(truth: Truth) -> None:
    small = binned(truth, 2)
    assert len(small.direct_data) == small.matrix.nnz
    assert (small.direct_data <= small.matrix.data * (1 + 1e-6)).all()
    assert (small.direct_data >= 0).all()
    assert small.matrix.has_canonical_format
    assert small.metadata["coarse"] == [2, 2]
    white = truth.matrix.sum() / 4
    assert small.matrix.sum() == pytest.approx(white, rel=1e-5)


def test_colour_channels_are_not_mixed() -> None:
    grey = ProceduralScene((4, 6), (6, 4), seed=1).truth()
    gains = np.array([1.0, 0.5, 0.25], np.float32)
    rows = grey.matrix.toarray()[:, None, :] * gains[:, None]
    matrix = type(grey.matrix)(rows.reshape(-1, 24))
    direct = np.zeros(matrix.nnz, np.float32)
    colour = Truth(matrix, direct, (4, 6, 3), (6, 4))
    small = binned(colour, 2)
    assert small.camera_shape == (2, 3, 3)
    expected = binned(grey, 2).matrix.toarray()[:, None, :] * gains[:, None]
    np.testing.assert_allclose(small.matrix.toarray(), expected.reshape(18, 6), rtol=1e-5)


@pytest.mark.parametrize("factor", [0, -2, 3, 8])
def test_factors_that_do_not_divide_are_refused(truth: Truth, factor: int) -> None:
    with pytest.raises(InputError, match="common divisor"):
        binned(truth, factor)


def test_camera_and_projector_are_binned_independently(truth: Truth) -> None:
    both = binned(truth, 2)
    one_after_the_other = binned(binned(truth, 2, 1), 1, 2)
    assert binned(truth, 2, 1).projector_shape == truth.projector_shape
    assert binned(truth, 1, 2).camera_shape == truth.camera_shape
    np.testing.assert_allclose(
        one_after_the_other.matrix.toarray(), both.matrix.toarray(), rtol=1e-5
    )
