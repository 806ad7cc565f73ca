"""The verdict on an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.evaluation.doubts import OwnError
from lightmatrix.evaluation.verdict import Verdict, verdict
from tests.helpers.transports import random_transport


@pytest.fixture
def transport() -> lm.LightTransport:
    return random_transport()


def test_the_verdict_follows_the_estimated_errors(transport: lm.LightTransport) -> None:
    assert verdict(transport).level == "not tested"

    def judged(**facts: float) -> str:
        diagnostics = {name: np.full(30, value) for name, value in facts.items()}
        return str(verdict(replace(transport, diagnostics=diagnostics)))

    assert judged(estimated_error=0.01).startswith("Good. Estimated error of T: 1 %.")
    assert judged(estimated_error=0.1).startswith("Fair. ")
    assert judged(estimated_error=0.5).startswith("Doubtful. ")
    assert "Not tested. 100 % of the rows converged." in judged(converged=1)
    assert "reached the iteration limit" in judged(converged=0)
    assert "clipped in more than half" in judged(clipped_share=0.8, estimated_error=0.01)
    # Rows count by their light; rows without an estimated error do not count.
    errors = np.where(np.arange(30) < 2, 0.5, 0.01)
    errors[5] = np.nan
    mixed = replace(transport, diagnostics={"estimated_error": errors})
    energy = (transport.dense_rows(np.arange(30)).astype(float) ** 2).sum(axis=1)
    known = np.isfinite(errors)
    expected = np.sqrt((energy[known] * errors[known] ** 2).sum() / energy[known].sum())
    assert OwnError(mixed).estimated == pytest.approx(expected, rel=1e-5)
    assert verdict(mixed).level == "fair"


def test_what_no_error_estimate_shows_makes_the_verdict_doubtful() -> None:
    good = Verdict("good", "Estimated error of T: 1 %.")
    assert good.with_findings(["flicker", "stripes"]) is good
    spoiled = good.with_findings(["response", "flicker", "order"])
    assert spoiled.level == "doubtful"
    assert spoiled.sentence.endswith("(order, response).")
    assert "1 %" not in spoiled.sentence


def test_an_estimate_with_clipped_single_responses_is_not_called_good(
    transport: lm.LightTransport,
) -> None:
    brightest = float(transport.dense_rows(np.arange(30)).max())

    def judged(exposure: object) -> lm.Verdict:
        known = {"estimated_error": np.full(30, 0.01)}
        made = {"capture_description": {"exposure": exposure}}
        return verdict(replace(transport, diagnostics=known, provenance=made))

    assert judged(0.5 / brightest).level == "good"
    clipped = judged([1e3 / brightest, 2e3 / brightest])
    assert clipped.level == "fair"
    assert "of the rows clip under a single projector pixel" in clipped.sentence
    # The shortest of several exposures does not clip.
    assert judged([1e3 / brightest, 0.5 / brightest]).level == "good"
    damaged: object
    for damaged in ("much", None, [], {}, float("nan"), ["a"]):
        assert judged(damaged).level == "good"
