"""Every case of the table of faults."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import pytest

from tests.helpers.systems import FORKS

from .case import GOOD, Outcome
from .cases import ALL
from .workers import Pool

# Cases are run by processes that were forked off.
pytestmark = FORKS

Answers = dict[str, Future[dict[str, Any]]]


@pytest.fixture(scope="module")
def answers(request: pytest.FixtureRequest, pool: Pool) -> Answers:
    """The answers to all cases that were chosen, worked out ahead by two processes."""
    wanted = [
        str(item.callspec.params["name"])
        for item in request.session.items
        if isinstance(item, pytest.Function)
        and item.originalname == "test_a_fault_is_borne"
        and hasattr(item, "callspec")
    ]
    return {name: pool.submit({"do": "case", "name": name}) for name in wanted}


@pytest.mark.parametrize("name", ALL)
def test_a_fault_is_borne(name: str, answers: Answers) -> None:
    answer = answers[name].result()
    if answer["outcome"] == Outcome.SKIPPED:
        pytest.skip(answer["detail"])
    if answer["outcome"] not in GOOD:
        # Where in this file it was noticed is of no interest.
        pytest.fail(f"{answer['outcome']}: {answer['detail']}", pytrace=False)


def test_the_table_is_as_long_as_promised() -> None:
    assert len(ALL) >= 200
