"""Mutations of everything that is read: it is refused with words, or read rightly.

python -m tests.faults.fuzz --count 500 [--first 0] [--seconds N]
python -m tests.faults.fuzz --case 1234
"""

from __future__ import annotations

from .run import run_one

__all__ = ["run_one"]
