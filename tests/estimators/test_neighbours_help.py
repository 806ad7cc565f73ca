"""Photographs held out decide whether camera pixels learn from their neighbours."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.check.finding import Finding
from lightmatrix.estimators import choice, plain
from lightmatrix.estimators.choice import check_and_choose, choose_estimator
from lightmatrix.estimators.coherent import rounds
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error

SIZE = 24


def test_independent_speckle_is_estimated_row_by_row() -> None:
    drawn = draw("speckle", "random", "none", SIZE, seed=3)
    with pytest.warns(lm.LightMatrixWarning, match="estimating row by row"):
        chosen = lm.estimate(drawn.capture, progress=False, check=False)
    coherent = lm.estimate(drawn.capture, coherent=True, progress=False, check=False)
    assert chosen.provenance["estimator"] == "plain"
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


def test_what_is_tried_is_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise AssertionError("judged")

    for module in (plain, rounds):
        monkeypatch.setattr(module, "with_certainty", refused)
    capture = draw("speckle", "random", "none", SIZE, seed=3).capture
    assert isinstance(choose_estimator(capture), PlainEstimator)


def test_the_middle_of_the_light_stands_for_a_larger_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    capture = draw("speckle", "random", "none", SIZE, seed=3).capture
    monkeypatch.setattr(choice, "_TRIED", 144)
    assert isinstance(choose_estimator(capture), PlainEstimator)


@pytest.mark.parametrize(("coherent", "beside"), [(None, True), (True, False), (False, False)])
def test_frames_are_checked_while_both_ways_are_tried(coherent: bool | None, beside: bool) -> None:
    capture = draw("wall", "random", "none", 16, seed=3).capture
    settings = lm.EstimateSettings(coherent=coherent)
    threads: list[threading.Thread] = []
    found = [Finding("light", (), "dark", "expose longer")]

    def check() -> list[Finding]:
        threads.append(threading.current_thread())
        return found

    estimator, findings = check_and_choose(
        check, capture, settings, lm.estimate_resources(capture, settings)
    )
    assert [each is not threading.main_thread() for each in threads] == [beside]
    assert estimator == choose_estimator(capture, settings)
    assert findings is found


def test_what_a_check_raises_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = draw("speckle", "random", "none", SIZE, seed=3).capture
    settings = lm.EstimateSettings()
    resources = lm.estimate_resources(capture, settings)

    def refuse() -> list[Finding]:
        raise lm.InputError("frame 1 and frame 2 look swapped")

    def fail(*_: object, **__: object) -> None:
        raise lm.SolverError("no solution")

    monkeypatch.setattr(PlainEstimator, "estimate", fail)
    with pytest.raises(lm.InputError, match="look swapped"):
        check_and_choose(refuse, capture, settings, resources)
    with pytest.raises(lm.SolverError, match="no solution"):
        check_and_choose(list, capture, settings, resources)


@pytest.mark.parametrize("patterns", ["stripes", "one pixel"])
def test_nothing_is_tried_where_no_frame_can_be_held_out(
    patterns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = draw("wall", patterns, "none", 16, seed=3).capture

    def fail(*_: object) -> None:
        raise AssertionError("an estimate was tried")

    monkeypatch.setattr(PlainEstimator, "estimate", fail)
    monkeypatch.setattr(CoherentEstimator, "estimate", fail)
    assert isinstance(choose_estimator(capture), CoherentEstimator)
