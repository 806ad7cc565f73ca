"""The photograph that is missing is named by what the others show, or by their numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.diagnosis.frame_order import (
    _missing_numbers,
    _ordinal,
    _scores_by_place,
    check_counts,
    missing_places,
)
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.bits import BernoulliPatterns
from tests.helpers.surface import PROJECTOR, photographs

K = 32
PATTERNS = BernoulliPatterns(PROJECTOR, K)
DECODER = lm.Decoder(clip=255, full_scale=255)


def survey(place: int, count: int = K, diffuse: float = 0.3, noise: float = 0.005) -> Survey:
    patterns = BernoulliPatterns(PROJECTOR, count)
    frames = np.delete(photographs(patterns, diffuse=diffuse, noise=noise), place, axis=0)
    capture = lm.Capture.from_arrays(patterns.subset(np.arange(count - 1)), frames, DECODER)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    return replace(taken, patterns=patterns)


@pytest.mark.parametrize("place", [0, 1, 13, 30, 31])
def test_the_missing_frame_is_named(place: int) -> None:
    assert missing_places(survey(place)) == (place,)


def test_nothing_is_named_from_too_little() -> None:
    assert missing_places(survey(5, count=12)) == ()
    few = survey(13)
    lit = np.flatnonzero(few.valid & few.inner)
    for left, named in ((23, ()), (40, (13,))):
        valid = np.zeros_like(few.valid)
        valid[lit[:: len(lit) // left][:left]] = True
        assert missing_places(replace(few, valid=valid)) == named
    noisy = survey(13)
    raw = np.random.default_rng(0).permutation(noisy.raw, axis=1)
    assert missing_places(replace(noisy, raw=raw)) == ()


def test_the_place_is_scored_by_the_variance_that_single_pixels_explain() -> None:
    """The score of each place is that of brute force."""
    values = photographs(PATTERNS).reshape(K, -1)[:, 100:130].T / 255.0
    rest = np.delete(values, 9, axis=1)
    clipped = np.zeros(rest.shape, bool)
    clipped[3, 7] = True
    samples = lm.Samples(np.where(clipped, 9, rest), clipped, np.ones(K - 1))
    scores = _scores_by_place(PATTERNS, samples)
    assert scores.argmax() == 9
    columns = PATTERNS.columns(np.arange(PATTERNS.pixels)).astype(float)
    columns -= columns.mean(axis=0)
    columns /= np.sqrt((columns**2).sum(axis=0))
    light = np.where(clipped, np.nan, rest)
    light = np.nan_to_num(light - np.nanmean(light, axis=1, keepdims=True))
    for place in (0, 4, 9, 31):
        shown = np.delete(columns, place, axis=0)
        best = np.maximum(light @ shown, 0).max(axis=1) ** 2 / (light**2).sum(axis=1)
        assert scores[place] == pytest.approx(-np.log1p(-best).mean(), rel=1e-3)


def images(*numbers: int) -> list[Path]:
    return [Path(f"IMG_{number:04d}.png") for number in numbers]


def test_numbers_that_names_leave_out() -> None:
    assert _missing_numbers(images(1, 2, 3, 5, 6, 7, 8, 9)) == ["4"]
    assert _missing_numbers(images(3, 1, 2)) == []
    # Every second number is a step, not a gap: one of four numbers may be missing.
    assert _missing_numbers(images(1, 3, 5, 7)) == []
    assert _missing_numbers(images(1, 2, 3, 5)) == ["4"]
    assert _missing_numbers(images(1, 3, 4)) == []
    assert _missing_numbers([Path("a.png"), *images(1, 3, 4, 5, 6)]) == []


def test_words_without_a_survey() -> None:
    found = check_counts(None, 9, images(1, 2, 3, 5, 6, 7, 8, 9))
    assert (found.kind, found.frames) == ("counts", ())
    assert found.message == "9 patterns, but 8 photographs; their names leave out number 4"
    assert "take it again" in found.advice
    many = check_counts(None, 40, images(*(k for k in range(40) if k % 5)))
    assert many.message.endswith("leave out number 5, 10, 15, 20, 25")
    assert many.frames == ()
    more = check_counts(None, 3, images(1, 2, 3, 4))
    assert more.message == "3 patterns, but 4 photographs"
    assert "remove what is no photograph" in more.advice


def test_words_with_a_survey() -> None:
    names = images(*range(100, 100 + K - 1))
    found = check_counts(survey(13), K, names)
    assert found.frames == (13,)
    assert found.message.endswith(
        "the one of pattern 13 (the 14th) is missing, before IMG_0113.png"
    )
    last = check_counts(survey(31), K, names)
    assert last.message.endswith("the one of pattern 31 (the 32nd) is missing")
    # Two are missing: the survey is of no use.
    assert check_counts(survey(13), K + 1, names).frames == ()


def test_ordinals() -> None:
    words = [_ordinal(k) for k in (1, 2, 3, 4, 11, 12, 13, 21, 22, 101, 111, 112)]
    assert words == [
        "1st",
        "2nd",
        "3rd",
        "4th",
        "11th",
        "12th",
        "13th",
        "21st",
        "22nd",
        "101st",
        "111th",
        "112th",
    ]
