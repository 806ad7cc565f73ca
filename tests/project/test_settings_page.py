"""The settings in the docs are those of the code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_settings_page_is_up_to_date() -> None:
    command = [sys.executable, str(ROOT / "tools" / "settings_table.py"), "--check"]
    assert subprocess.run(command).returncode == 0, "run python tools/settings_table.py"
