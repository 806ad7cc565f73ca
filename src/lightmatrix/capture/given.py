"""A capture, given as what it is or as where it lies."""

from __future__ import annotations

from pathlib import Path

from lightmatrix.capture.capture import Capture


def given_capture(capture: Capture | str | Path) -> Capture:
    """The capture itself, or what a capture folder or packed capture holds, not yet checked.

    Raises
    ------
    InputError
        On a folder that is none.
    """
    return capture if isinstance(capture, Capture) else Capture.open(capture)
