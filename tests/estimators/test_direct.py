"""Photographs that determine T: it is read, and what lies below the noise is dark."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.simulation.truth import Truth

pytestmark = pytest.mark.filterwarnings("ignore::lightmatrix.LightMatrixWarning")
SHAPE = (16, 16)


def estimated(
    patterns: lm.PatternSet, matrix: Any, camera: tuple[int, int], exposure: float = 0.8
) -> tuple[lm.LightTransport, float]:
    """The estimate of a T, from photographs of 12 bits, and its error."""
    rows = csr_array(matrix, dtype=np.float32)
    known = Truth(rows, rows.data.copy(), camera, patterns.shape)
    capture = lm.simulate(known, patterns, exposure=exposure, bits=12, noise=0.001, black_level=100)
    transport = lm.estimate(capture, progress=False)
    assert transport.provenance["estimator"] == "direct"
    return transport, lm.evaluate(transport, known).relative_error


def sparse(seed: int = 0) -> np.ndarray[Any, Any]:
    """Rows of three entries each, of 1 in sum."""
    random = np.random.default_rng(seed)
    result = np.zeros((100, 256))
    for row in result:
        row[random.choice(256, 3, replace=False)] = random.dirichlet((2, 2, 2))
    return result


@pytest.mark.parametrize("kind", ["onepixel", "hadamard"])
def test_entries_above_the_noise_are_read_and_others_are_dark(kind: str) -> None:
    transport, error = estimated(lm.make_patterns(kind, SHAPE), sparse(), (10, 10))
    assert error < 0.004
    # The noise of the dark would be three times as much, and most of 25,600 entries are dark.
    assert transport.sparse.nnz < 360
    verdict = lm.verdicts(transport).transport
    assert verdict.error is not None
    assert error / 2 < verdict.error < 4 * error
    assert transport.provenance["regularization"] == pytest.approx(0.001 / 0.8, rel=0.1)


def test_rows_whose_white_clips_are_solved_without_it() -> None:
    patterns = lm.make_patterns("hadamard", SHAPE)
    transport, error = estimated(patterns, sparse(), (10, 10), 1.1)
    assert (transport.diagnostics["clipped_share"] > 0).all()
    # Read as they are, the samples that clip give an error of 0.11 or more.
    assert error < 0.07


def test_a_picture_is_read_as_it_is() -> None:
    """A bucket detector: no entry is dark, so nothing is cut off, and no error is stated."""
    y, x = np.indices(SHAPE) / 16
    picture = 1 + np.sin(5 * x) * np.cos(4 * y) / 2
    transport, error = estimated(
        lm.make_patterns("hadamard", SHAPE), picture.reshape(1, -1) / picture.sum(), (1, 1)
    )
    assert transport.sparse.nnz == 256
    # Least squares have 2 / 16 of the noise in each pixel.
    assert error == pytest.approx(0.001 / 0.8 * 2 / 16 * 256, rel=0.5)
    verdict = lm.verdicts(transport).transport
    assert verdict.level == "not tested"
    assert "Hardly an entry is dark" in verdict.sentence


def test_lights_one_at_a_time_and_one_that_is_never_lit() -> None:
    random = np.random.default_rng(2)
    matrix = random.random((400, 24)) * (random.random((400, 24)) < 0.7)
    images = np.eye(24, dtype=np.float32)[[k for k in range(24) if k != 5]].reshape(23, 4, 6)
    patterns = lm.ImagePatterns(images)
    with pytest.warns(lm.LightMatrixWarning, match="1 of the 24 projector pixels are lit by no"):
        transport, error = estimated(patterns, matrix, (20, 20), 0.9)
    matrix[:, 5] = 0
    found = transport.sparse.toarray()
    # Camera pixels that have nothing in common do not help each other.
    assert np.linalg.norm(found - matrix) < 0.0022 * np.linalg.norm(matrix)
    assert error > 0.1
    assert "Nothing is known of the projector pixels that no pattern lit" in (
        lm.verdicts(transport).transport.sentence
    )


def test_a_dome_of_lights_comes_near_the_noise_of_its_photographs() -> None:
    """No estimate that weighs entries one by one errs by less than this oracle does."""
    y, x = (np.indices((24, 24)) - 11.5) / 11
    height = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.stack([x, y, height], axis=-1) * (height > 0)[..., None]
    angles = np.pi * np.arange(24) / 12
    lights = np.stack([np.cos(angles), np.sin(angles), np.full(24, 0.3)], axis=1) / 1.045
    # A surface that is somewhat glossy.
    matrix = np.maximum(normals.reshape(-1, 3) @ lights.T, 0) ** 8
    patterns = lm.ImagePatterns(np.eye(24, dtype=np.float32).reshape(24, 4, 6))
    _, error = estimated(patterns, matrix, (24, 24), 0.9)
    noise = np.hypot(0.001, 1 / 4095 / np.sqrt(12)) / 0.9
    least = np.linalg.norm(np.minimum(matrix, noise)) / np.linalg.norm(matrix)
    assert 0.9 * least < error < 1.12 * least


def test_what_is_asked_for_is_done() -> None:
    capture = lm.simulate("metal", lm.make_patterns("onepixel", (8, 8)), noise=0.001)
    for setting in ({"regularization": 0.1}, {"solver": "romp"}, {"signed": True}):
        made = lm.estimate(capture, progress=False, **setting)
        assert made.provenance["estimator"] != "direct"
