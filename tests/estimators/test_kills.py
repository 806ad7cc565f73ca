"""Killed at random moments, an estimate of a large frame goes on to the same result."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_killed_estimates_end_as_if_nothing_had_happened() -> None:
    command = [sys.executable, "-m", "tests.estimators.kills", "--small", "--count", "3"]
    root = Path(__file__).parents[2]
    ran = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "3 runs" in ran.stdout
