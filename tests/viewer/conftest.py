"""One browser for all tests of the viewer."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from browser import installed, opened
from playwright.sync_api import Browser


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """A headless Chromium. While it runs, the main thread counts as one that runs asyncio."""
    if installed() is None:
        pytest.skip("no Chromium is installed: make system-deps brings one")
    with opened() as chromium:
        yield chromium
