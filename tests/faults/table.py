"""Runs the table and prints it, counted by group and outcome.

python -m tests.faults.table [--json FILE] [--only WORD] [-v]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .case import GOOD, Outcome
from .cases import GROUPS, group_of
from .workers import Pool


def counted(outcomes: dict[str, str]) -> dict[str, Counter[str]]:
    """How often each outcome came, by group; `all` is their sum."""
    table: dict[str, Counter[str]] = {name: Counter() for name in (*GROUPS, "all")}
    for name, outcome in outcomes.items():
        table[group_of(name)][outcome] += 1
        table["all"][outcome] += 1
    return table


def as_text(table: dict[str, Counter[str]]) -> str:
    """The counts as a Markdown table, a column an outcome that came."""
    columns = [o for o in (*Outcome, "broken") if any(counts[o] for counts in table.values())]
    lines = [
        f"| group | {' | '.join(columns)} | cases |",
        "|---" * (len(columns) + 2) + "|",
    ]
    for group, counts in table.items():
        if counts:
            cells = " | ".join(str(counts[column] or "") for column in columns)
            lines.append(f"| {group} | {cells} | {counts.total()} |")
    return "\n".join(lines)


def main() -> int:
    """Run all cases, or those whose name holds a word; 0 if every one is as it should be."""
    parser = argparse.ArgumentParser(description="Count the fault cases by outcome.")
    parser.add_argument("--json", type=Path, help="file for the outcomes, a line a case")
    parser.add_argument("--read", type=Path, help="count such a file instead")
    parser.add_argument("--only", default="", help="a word that names must hold")
    parser.add_argument("--workers", type=int, default=2, help="cases at a time")
    parser.add_argument("-v", action="store_true", help="print every case that is not well")
    arguments = parser.parse_args()
    if arguments.read is not None:
        answers = [json.loads(line) for line in arguments.read.read_text().splitlines()]
    else:
        answers = list(_run(arguments.only, arguments.workers, arguments.json, verbose=arguments.v))
    outcomes = {answer["name"]: answer["outcome"] for answer in answers}
    sys.stdout.write(as_text(counted(outcomes)) + "\n")
    return int(any(outcome not in GOOD for outcome in outcomes.values()))


def _run(word: str, workers: int, file: Path | None, *, verbose: bool) -> Iterator[dict[str, Any]]:
    """The answers to all cases whose names hold a word; kept in a file as they come."""
    names = [name for cases in GROUPS.values() for name in cases if word in name]
    with Pool(workers) as pool, open(file or os.devnull, "w") as kept:
        for request, answer in pool.answers({"do": "case", "name": name} for name in names):
            named = {"name": request["name"], **answer}
            kept.write(json.dumps(named) + "\n")
            kept.flush()
            if verbose and answer["outcome"] not in GOOD:
                sys.stderr.write(f"{answer['outcome']:17} {named['name']}: {answer['detail']}\n")
            yield named


if __name__ == "__main__":
    sys.exit(main())
