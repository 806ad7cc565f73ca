"""The gamma of photographs is measured, and linear ones are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.diagnosis import linearity
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.linearity import _likeliest, _medium_rows, check_linearity
from lightmatrix.diagnosis.survey import Survey, high_variance_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from tests.helpers.surface import PROJECTOR, photographs

K = 32
PATTERNS = BernoulliPatterns(PROJECTOR, K)


@pytest.fixture(autouse=True)
def _few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linearity, "_ROWS", 40)


def survey(power: float, **options: float) -> Survey:
    """A survey of photographs whose levels are raised to a power."""
    levels = photographs(PATTERNS, noise=0.001, **options) / 255
    frames = np.rint(255 * levels**power).astype(np.uint8)
    capture = lm.Capture.from_arrays(PATTERNS, frames, lm.Decoder(clip=255, full_scale=255))
    return Survey.take(capture.patterns, capture.frames, capture.decoder)


def found(taken: Survey, *, steady: bool = True) -> list[Finding]:
    rows = high_variance_rows(taken)
    findings = check_linearity(taken, rows, np.zeros(K, bool), steady=steady)
    assert all(each.kind == "response" and not each.frames for each in findings)
    return findings


@pytest.mark.parametrize(("gamma", "words"), [(2.2, "srgb or gamma:2.2"), (1.5, "gamma:1.")])
def test_the_gamma_is_measured(gamma: float, words: str) -> None:
    (finding,) = found(survey(1 / gamma))
    measured = float(finding.message.split()[-1])
    assert measured == pytest.approx(gamma, abs=0.3)
    assert words in finding.advice


@pytest.mark.parametrize("gamma", [3.0, 2.6, 1.8, 0.65, 0.4])
def test_all_gammas_are_measured(gamma: float) -> None:
    (finding,) = found(survey(1 / gamma))
    number = float(finding.message.split()[-1])
    assert (number if gamma > 1 else 1 / number) == pytest.approx(gamma, rel=0.15)


def test_powers_are_measured_in_steady_light_only() -> None:
    (finding,) = found(survey(1.8))
    assert float(finding.message.split()[-1]) == pytest.approx(1.8, abs=0.4)
    assert "--response linear" in finding.advice
    assert found(survey(1.8), steady=False) == []


def test_linear_photographs_are_left_alone() -> None:
    assert found(survey(1.0)) == []
    assert found(survey(1 / 1.05)) == []


def test_doubted_frames_are_not_learned_from() -> None:
    taken = survey(1.0)
    raw = taken.raw.copy()
    raw[:, :3] = np.random.default_rng(0).integers(0, 200, (len(raw), 3))
    object.__setattr__(taken, "raw", raw)
    rows = high_variance_rows(taken)
    assert check_linearity(taken, rows, np.arange(K) < 3, steady=True) == []


def test_few_rows_reveal_nothing() -> None:
    taken = survey(1 / 2.2)
    rows = np.flatnonzero(taken.valid & taken.inner)
    taken.valid[rows[19:]] = False
    assert check_linearity(taken, rows[:19], np.zeros(K, bool), steady=True) == []


def test_rows_are_of_medium_level() -> None:
    taken = survey(1.0, exposure=1.3)
    rows = high_variance_rows(taken)
    chosen = _medium_rows(taken, rows)
    known = taken.statistics
    assert len(chosen) == 40
    assert (np.diff(chosen) > 0).all()
    assert taken.inner[chosen].all()
    assert known.clipped[chosen].max() <= 0.3
    assert known.spread[chosen].min() >= known.spread[rows].min()


def curve(top: float, gammas: NDArray[np.floating]) -> dict[float, float]:
    return {float(g): float(1 - (np.log(g) - np.log(top)) ** 2) for g in gammas}


def test_the_likeliest_gamma_lies_between_those_that_were_tried() -> None:
    gammas = np.array([1.0, 1.2, 1.5, 1.8, 2.2, 2.6, 3.0])
    assert _likeliest(curve(1.9, gammas)) == pytest.approx(1.9, rel=1e-6)
    assert _likeliest(curve(5.0, gammas)) == pytest.approx(3.0)
    assert _likeliest(curve(0.9, gammas)) == pytest.approx(1.0)
