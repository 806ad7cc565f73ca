"""The experiment on responses: its photographs, its rows, its table and its figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.diagnosis.curves import exponent
from lightmatrix.experiments import responses
from lightmatrix.experiments.harness import Measured


def test_cameras_code_light_as_their_curve_says() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 3)
    light = lm.simulate("metal", patterns, exposure=0.5, bits=None, noise=0)
    for name in (*responses.RESPONSES, responses.S_CURVE):
        curve = responses.camera_of(name)
        capture = responses.coded(light, curve, bits=16)
        assert capture.frame(0).dtype == np.uint16
        decoded = curve.linearise(capture.frame(0) / 65535)
        # 16 bits of a gamma below 1 are coarse in the dark.
        assert decoded == pytest.approx(light.frame(0).clip(0, 1), abs=2e-4)
    assert (responses.coded(light, responses.camera_of("linear")).frame(0) <= 255).all()


def test_a_case_compares_the_found_curve_with_the_known_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the search and the estimates, whose tests are elsewhere: it finds 2.0 for 2.2."""

    def estimate(capture: lm.Capture, *, check: bool) -> lm.LightTransport:
        assert not check
        known = lm.truth("l_objects").transport()
        off = abs(exponent(capture.decoder.response) - 2.2)
        return replace(known, sparse=known.sparse * np.float32(1.01 + off))

    monkeypatch.setattr(responses, "estimate", estimate)
    found = lm.FoundResponse(lm.Response.parse("gamma:2"), 2.0, 0.01, 0.1, 1)
    monkeypatch.setattr(responses, "find_response", lambda _: found)
    (row,) = responses.measure(responses.Case("l_objects", 0.0, "gamma:2.2", 32)).rows
    assert row["error_known"] < 0.02 < row["error_auto"] < row["error_linear"]
    assert row["ratio"] == pytest.approx(row["error_auto"] / row["error_known"])
    assert row["gamma"] == pytest.approx(2.2)


def test_a_curve_that_is_not_determined_is_a_row_without_errors_by_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def undetermined(_: lm.Capture) -> lm.FoundResponse:
        raise lm.InputError("the photographs do not determine the camera's response")

    known = lm.truth("l_objects").transport()
    brighter = replace(known, sparse=known.sparse * np.float32(1.01))
    monkeypatch.setattr(responses, "estimate", lambda *_, **__: brighter)
    monkeypatch.setattr(responses, "find_response", undetermined)
    (row,) = responses.measure(responses.Case("l_objects", 0.0, "gamma:2.2", 16)).rows
    assert not row["found"]
    assert np.isnan(row["error_auto"])


def test_the_table_has_the_worst_scene(tmp_path: Path) -> None:
    def measured(scene: str, gamma: float, ratio: float) -> tuple[responses.Case, Measured]:
        case = responses.Case(scene, 0.0, "gamma:2.2", 32)
        errors = {"error_known": 0.01, "error_auto": 0.01 * ratio, "error_linear": 0.4}
        row = {
            "scene": scene, "blur": 0.0, "response": case.response, "patterns": 32, "gamma": 2.2,
            "gamma_found": gamma, "curve_difference": 0.01, "estimates": 1, "ratio": ratio,
            "projector": 0.0, "projector_found": 0.0, "found": gamma > 0,
            **errors,
        }  # fmt: skip
        return case, Measured([row])

    results = [measured("metal", 2.2, 1.0), measured("gripper", 2.42, 1.5)]
    results.append(measured("corner", np.nan, np.nan))
    (row,) = responses._summary([row for _, each in results for row in each.rows])
    assert row["gamma_off_most"] == pytest.approx(0.1)
    assert row["ratio_most"] == 1.5
    assert (row["scenes"], row["found"]) == (3, 2)
    assert row["error_auto"] == pytest.approx(0.0125)
    responses._draw(tmp_path, results)
    assert (tmp_path / "responses.png").stat().st_size > 5000


def test_grey_patterns_become_the_light_of_the_projector() -> None:
    greys, light = responses.grey_patterns((16, 16), 4, 2.2)
    assert light.dense() == pytest.approx(greys.dense() ** 2.2, abs=1e-5)
    grey = [case for case in responses.cases(False) if case.projector]
    assert len(grey) == 20
    assert len({case.name for case in responses.cases(False)}) == 160
