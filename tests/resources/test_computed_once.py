"""Threads that ask for a property together get one value, computed once."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

from lightmatrix.resources.computed_once import computed_once


class Asked:
    def __init__(self) -> None:
        self.times = 0

    @computed_once
    def value(self) -> object:
        """What takes long."""
        self.times += 1
        time.sleep(0.05)
        return object()


def test_threads_share_one_value() -> None:
    asked = Asked()
    with ThreadPoolExecutor(4) as pool:
        values = list(pool.map(lambda _: asked.value, range(4)))
    assert asked.times == 1
    assert all(value is asked.value for value in values)
    assert Asked().value is not asked.value
    assert Asked.value.__doc__ == "What takes long."
