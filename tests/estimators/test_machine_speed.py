"""The speed of this machine is measured once."""

from __future__ import annotations

from typing import Any

import pytest

import lightmatrix as lm
from lightmatrix.estimators import machine_speed


def test_a_machine_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[lm.Problem] = []
    solve = lm.ActiveSet.solve

    def counted(self: lm.ActiveSet, problem: lm.Problem) -> Any:
        solved.append(problem)
        return solve(self, problem)

    monkeypatch.setattr(lm.ActiveSet, "solve", counted)
    machine_speed.slowness.cache_clear()
    first = machine_speed.slowness()
    assert machine_speed.slowness() == first > 0
    assert len(solved) == 10
    monkeypatch.setattr(machine_speed, "_USUAL_SECONDS", 1e-3)
    machine_speed.slowness.cache_clear()
    assert machine_speed.slowness() > 2 * first
    # Other tests must not get this speed.
    machine_speed.slowness.cache_clear()
