"""Every example runs and does what it says."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_every_example_is_tested() -> None:
    tested = {"relight_and_dual", "estimate_in_python", "few_patterns"}
    assert {path.stem for path in EXAMPLES.glob("*.py")} == tested


def test_relight_and_dual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["relight_and_dual.py", str(tmp_path)])
    runpy.run_path(str(EXAMPLES / "relight_and_dual.py"), run_name="__main__")
    assert {path.name for path in tmp_path.iterdir()} == {"relit.png", "dual.png", "row.png"}


def test_estimate_in_python() -> None:
    errors = runpy.run_path(str(EXAMPLES / "estimate_in_python.py"))["main"]()
    blind, paper, convex = errors.values()
    assert max(paper, convex) < 0.5 * blind


def test_few_patterns() -> None:
    errors = runpy.run_path(str(EXAMPLES / "few_patterns.py"))["main"]()
    row_by_row, coherent, two_exposures = errors.values()
    assert coherent < 0.6 * row_by_row
    assert two_exposures < 0.02
