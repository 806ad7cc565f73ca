"""Photographs held out decide whether camera pixels learn from their neighbours."""

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.estimators import choice
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error

SIZE = 24


def test_independent_speckle_is_estimated_row_by_row() -> None:
    drawn = draw("speckle", "random", "none", SIZE, seed=3)
    with pytest.warns(lm.LightMatrixWarning, match="estimating row by row"):
        chosen = lm.estimate(drawn.capture, progress=False, check=False)
    coherent = lm.estimate(drawn.capture, coherent=True, progress=False, check=False)
    assert chosen.provenance["estimator"] == "row by row"
    assert coherent.provenance["estimator"] == "coherent"
    assert relative_error(chosen, drawn.truth) < 0.5 * relative_error(coherent, drawn.truth)


@pytest.mark.parametrize("scene", ["wall", "fibres", "permutation", "glints"])
def test_neighbours_are_used_where_they_do_no_harm(scene: str) -> None:
    drawn = draw(scene, "random", "none", SIZE, seed=3)
    assert isinstance(choose_estimator(drawn.capture), CoherentEstimator)


def test_settings_come_first() -> None:
    capture = draw("speckle", "random", "none", SIZE, seed=3).capture
    coherent = choose_estimator(capture, lm.EstimateSettings(coherent=True))
    assert isinstance(coherent, CoherentEstimator)
    wall = draw("wall", "random", "none", SIZE, seed=3).capture
    alone = choose_estimator(wall, lm.EstimateSettings(coherent=False))
    assert isinstance(alone, PlainEstimator)


@pytest.mark.parametrize(
    "whole", [CoherentEstimator(), PlainEstimator(lm.ActiveSet())], ids=["coherent", "plain"]
)
def test_what_is_only_compared_has_the_same_light(
    whole: CoherentEstimator | PlainEstimator,
) -> None:
    capture = draw("wall", "random", "none", SIZE, seed=3).capture
    bare, judged = replace(whole, judged=False).estimate(capture), whole.estimate(capture)
    np.testing.assert_array_equal(bare.sparse.toarray(), judged.sparse.toarray())
    np.testing.assert_array_equal(bare.background, judged.background)
    assert set(bare.diagnostics) < set(judged.diagnostics)
    # Neither goes on with the tiles of the other.
    plans = (replace(whole, judged=False).plan(capture), whole.plan(capture))
    assert plans[0].fingerprint != plans[1].fingerprint


def test_the_middle_of_the_light_stands_for_a_larger_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    capture = draw("speckle", "random", "none", SIZE, seed=3).capture
    monkeypatch.setattr(choice, "_TRIED", 144)
    assert isinstance(choose_estimator(capture), PlainEstimator)
