"""Three hundred mutations at each run of the tests; `make fuzz` does 20,000."""

from __future__ import annotations

import pytest

from tests.helpers.systems import FORKS

from ..case import GOOD
from ..workers import Pool

COUNT = 300

# Cases are run by processes that were forked off.
pytestmark = FORKS


def test_what_is_damaged_is_refused_or_read_rightly(pool: Pool) -> None:
    answers = pool.answers({"do": "fuzz", "number": number} for number in range(COUNT))
    bad = [
        f"{answer['outcome']}, `python -m tests.faults.fuzz --case {request['number']}`: "
        f"{answer['detail']}"
        for request, answer in answers
        if answer["outcome"] not in GOOD
    ]
    if bad:
        pytest.fail("\n".join([f"{len(bad)} of {COUNT}", *sorted(bad)]), pytrace=False)
