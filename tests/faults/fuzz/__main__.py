"""Run mutations by number and count what became of them."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from ..case import GOOD
from ..workers import Pool
from .run import ORDER


def main() -> int:
    """Run many, or one again; 0 if every one was refused well or is fine."""
    parser = argparse.ArgumentParser(prog="fuzz", description="Mutate what lightmatrix reads.")
    parser.add_argument("--count", type=int, default=500, help="how many mutations")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--case", type=int, help="only this one, in full")
    arguments = parser.parse_args()
    numbers = (
        range(arguments.first, arguments.first + arguments.count)
        if arguments.case is None
        else [arguments.case]
    )
    counts: dict[str, Counter[str]] = {name: Counter() for name in (*ORDER, "all")}
    started = time.perf_counter()
    with Pool() as pool:
        requests = ({"do": "fuzz", "number": number} for number in numbers)
        for done, (request, answer) in enumerate(pool.answers(requests), 1):
            outcome = answer["outcome"]
            for name in (ORDER[request["number"] % len(ORDER)], "all"):
                counts[name][outcome] += 1
            if outcome not in GOOD or arguments.case is not None:
                number = request["number"]
                sys.stdout.write(f"{outcome:17} --case {number}: {answer['detail']}\n")
            if done % 1000 == 0:
                sys.stderr.write(f"{done} in {time.perf_counter() - started:.0f} s\n")
    for name, outcomes in counts.items():
        summary = ", ".join(f"{outcome} {n}" for outcome, n in sorted(outcomes.items()))
        sys.stdout.write(f"{name}: {summary}\n")
    return int(any(outcome not in GOOD for outcome in counts["all"]))


if __name__ == "__main__":
    sys.exit(main())
