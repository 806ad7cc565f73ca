"""Inverse light: the pattern under which the camera sees direct light only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.simulation.truth import Truth


@pytest.fixture(scope="module")
def truth() -> Truth:
    return lm.truth("corner")


def _direct(truth: Truth) -> lm.LightTransport:
    return lm.LightTransport.from_matrix(truth.direct, truth.camera_shape, truth.projector_shape)


def _residue(truth: Truth, pattern: Any, wanted: Any) -> float:
    direct = truth.direct @ wanted.ravel()
    missed = truth.matrix @ pattern.ravel() - direct
    return float(np.linalg.norm(missed) / np.linalg.norm(direct))


def test_known_global_light_is_cancelled(truth: Truth) -> None:
    """0.288 of the direct light before."""
    white = np.ones(truth.projector_shape, np.float32)
    found = lm.cancel_global(truth.transport(), direct=_direct(truth))
    assert _residue(truth, white, white) > 0.25
    assert _residue(truth, found.pattern, white) < 0.06
    assert found.pattern.min() >= 0
    assert found.pattern.max() <= 1
    expected = (truth.direct @ white.ravel()).reshape(truth.camera_shape)
    np.testing.assert_allclose(found.target, expected, rtol=1e-4, atol=1e-6)


def test_global_light_that_separation_finds_is_cancelled(truth: Truth) -> None:
    stripes = np.zeros(truth.projector_shape, np.float32)
    stripes[:, ::4] = stripes[:, 1::4] = 1
    found = lm.cancel_global(truth.transport(), stripes)
    before = _residue(truth, stripes, stripes)
    assert _residue(truth, found.pattern, stripes) < 0.6 * before


def test_what_does_not_fit_is_refused(truth: Truth, tmp_path: Path) -> None:
    known, direct = truth.transport(), _direct(truth)
    other = lm.ProceduralScene((8, 8), (8, 8)).truth().transport()
    faults: dict[str, dict[str, Any]] = {
        "gives no direct light": {"pattern": np.zeros((64, 64)), "direct": direct},
        "direct part of the same": {"direct": other},
        "pattern has shape": {"pattern": np.ones((8, 8)), "direct": direct},
        "pattern of shape": {"pattern": np.ones((64, 64, 3)), "direct": direct},
    }
    for words, arguments in faults.items():
        with pytest.raises(lm.InputError) as caught:
            lm.cancel_global(known, output=tmp_path / "new.png", **arguments)
        assert words in f"{caught.value} {caught.value.hint}"
    assert not list(tmp_path.iterdir())
