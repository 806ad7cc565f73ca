"""The paper's numerical simulation, with few trials."""

from __future__ import annotations

import numpy as np

from experiments import fig4


def _mean(method: str, observations: int, level: float, trials: int = 20) -> float:
    matrices, x = fig4.draw(trials, observations, seed=0)
    return float(fig4.errors(method, matrices, x, level).mean())


def test_draws_follow_the_protocol() -> None:
    matrices, x = fig4.draw(30, 40, seed=3)
    assert matrices.shape == (30, 40, 100)
    assert ((matrices >= 0) & (matrices < 1)).all()
    assert ((x != 0).sum(axis=1) == 10).all()
    assert x.min() >= 0
    assert x.max() < 1


def test_unclipped_the_two_admms_coincide_and_beat_romp() -> None:
    for observations in (40, 90):
        plain = _mean("admm", observations, np.inf)
        saturation = _mean("saturation-admm", observations, np.inf)
        assert abs(plain - saturation) < 0.002
        assert max(plain, saturation) < 0.005
        assert max(plain, saturation) < _mean("romp", observations, np.inf)


def test_clipped_only_the_clip_aware_estimates_converge() -> None:
    saturation = _mean("saturation-admm", 100, fig4.CLIP_LEVEL)
    assert saturation <= 0.02
    assert saturation <= _mean("admm", 100, fig4.CLIP_LEVEL) / 8
    assert _mean("one-sided", 100, fig4.CLIP_LEVEL) <= 0.02


def test_unclipped_the_other_fidelities_are_saturation_admm() -> None:
    """Which is why `measure` does not solve them again."""
    matrices, x = fig4.draw(3, 40, seed=0)
    expected = fig4.errors("saturation-admm", matrices, x, np.inf)
    for name in fig4.SAME_WHERE_UNCLIPPED:
        np.testing.assert_array_equal(fig4.errors(name, matrices, x, np.inf), expected)
