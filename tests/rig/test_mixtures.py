"""Frames do not keep a small share of the pattern shown before."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lightmatrix.rig.devices.base import Frame
from lightmatrix.rig.pattern_match import fit_mixture
from lightmatrix.rig.photograph import AveragedFrame, References, Shot

from .rig_mixtures import run


def test_pictures_that_come_within_the_exposure_leave_less_than_noise_behind() -> None:
    met, kept, left_out = run(1)
    assert left_out == 0
    assert sum(mixed.share > 0.01 for mixed in met) > 8
    assert all(mixed.light < 1 and mixed.share < 0.01 for mixed in kept)


@pytest.mark.parametrize("share", [0.0, 0.03])
def test_a_share_is_found_with_its_error(share: float) -> None:
    random = np.random.default_rng(0)
    own, other, error = 9 + 3 * random.standard_normal((3, 400)) * [[1], [1], [0.1]]
    error /= 9

    def frame() -> Any:
        # The prediction is too strong, and the lamp has become weaker.
        light = (1 - share) * own + share * other + error * random.standard_normal(400)
        return 0.98 * light - 0.2

    rows = np.repeat(np.arange(40), 10)
    mixtures = [fit_mixture(frame() - own, other, own, error, rows) for _ in range(300)]
    shares = np.array([mix.share for mix in mixtures])
    assert shares.mean() == pytest.approx(share, abs=0.003)
    assert shares.std() == pytest.approx(mixtures[0].error, rel=0.15)
    assert not any(mix.torn for mix in mixtures)
    contrast = float(np.sqrt(((other - own) ** 2).mean()))
    # A share that adds less light than noise cannot be excluded. A larger one is seen or doubted.
    assert not any(mix.excluded(0.05 * contrast) for mix in mixtures)
    excluded = np.mean([mix.excluded(0.07 * contrast) for mix in mixtures])
    assert excluded > 0.88 if not share else 0.1 < excluded < 0.5


def test_two_photographs_that_share_a_little_of_white_or_a_pattern_do_not_agree() -> None:
    random = np.random.default_rng(1)
    shape, top, noise = (24, 24), 4095.0, 12.0
    white = np.full(shape, 2600.0) + 900 * random.random(shape)

    def photograph(light: Any) -> Any:
        return np.rint(64 + light + noise * random.standard_normal(shape)).astype(np.uint16)

    def average(light: Any) -> AveragedFrame:
        frame = Frame(photograph(light), 1, 0.0, top)
        mean = np.asarray(64 + light, np.float32)
        return AveragedFrame(mean, [Shot(frame, 0.01, 0.0)], noise, 0.0005)

    black = np.zeros(shape)
    references = References(average(black), average(white), np.float32(64) + np.zeros(shape, "f4"))
    own, other = (white * random.integers(0, 2, shape) for _ in range(2))
    for _ in range(20):
        one = photograph(own)
        assert references.agree(one, photograph(own), 0.01, [other, white, black])
        for before in (other, white):
            mixed = photograph(0.985 * own + 0.015 * before)
            assert not references.agree(one, mixed, 0.01, [before])
