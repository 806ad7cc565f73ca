"""Samples that the projector lights, and frames as a share of a white frame."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.capture.exposures import lit_samples, share_of_white


def test_dark_and_clipped_samples_are_not_lit() -> None:
    black = np.full(200, 10.0)
    white = np.full(200, 110.0)
    white[0] = 255.0  # clips
    white[1] = 246.0  # is just below 98 % of 255, 249.9
    white[2] = 19.0  # has 9 % of the light
    white[3] = 35.0
    lit = lit_samples(white, black, 255.0)
    assert np.flatnonzero(~lit).tolist() == [0, 2]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 1.2])
def test_the_share_is_that_of_the_lit_samples(share: float) -> None:
    generator = np.random.default_rng(0)
    black = generator.uniform(5, 20, 50)
    white = black + generator.uniform(50, 200, 50)
    lit = np.arange(50) < 30
    frame = black + share * (white - black)
    frame[~lit] = 0
    assert share_of_white(frame, white, black, lit) == pytest.approx(share)
