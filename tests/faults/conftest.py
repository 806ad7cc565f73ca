"""The workers, which take seconds to start and make their inputs; once for all fault tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .workers import Pool


@pytest.fixture(scope="session")
def pool() -> Iterator[Pool]:
    with Pool() as pool:
        yield pool
