"""Working ahead keeps the order, holds little, and fails in its turn; a value is computed once."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from lightmatrix.resources.threads import computed_once, work_ahead


@pytest.mark.parametrize("threads", [1, 2, 5, None])
def test_results_come_in_order(threads: int | None) -> None:
    assert list(work_ahead(lambda k: k * k, range(40), threads)) == [k * k for k in range(40)]
    assert list(work_ahead(lambda k: k, [], threads)) == []


def test_no_more_is_read_than_is_soon_wanted() -> None:
    read: list[int] = []
    guard = threading.Lock()

    def one(k: int) -> int:
        with guard:
            read.append(k)
        return k

    results = work_ahead(one, range(1000), 3)
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    results.close()  # type: ignore[attr-defined]
    assert len(read) <= 5 + 2 * 3


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_is_raised_in_its_turn(threads: int) -> None:
    def one(k: int) -> int:
        if k in (4, 6):
            raise ValueError(f"{k} is damaged")
        return k

    results = work_ahead(one, range(9), threads)
    assert [next(results) for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="4 is damaged"):
        next(results)


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
