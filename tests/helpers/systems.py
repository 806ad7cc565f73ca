"""Marks for tests that need something that Windows lacks; they are skipped there with a reason."""

from __future__ import annotations

import sys

import pytest

POSIX = sys.platform != "win32"


def needs_posix(what: str) -> pytest.MarkDecorator:
    """Skip a test on Windows, where there is no such thing: `needs_posix("named pipes")`."""
    return pytest.mark.skipif(not POSIX, reason=f"Windows has no {what}")


PIPES = needs_posix("named pipes")
LIMITS = needs_posix("limits of a process's resources")
SIGNALS = needs_posix("signals that kill or stop")
FORKS = needs_posix("forks")
SHELL = needs_posix("shell of POSIX")
FLOCKS = needs_posix("flock")
