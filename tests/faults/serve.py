"""The process behind `workers.Worker`: imports everything, then works through requests."""

from __future__ import annotations

import contextlib
import functools
import gc
import importlib
import io
import json
import os
import pkgutil
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from . import fuzz
from .case import Case, Outcome, Ran, SkipError, judge
from .cases import ALL, NEEDS, group_of
from .snapshot import snapshot
from .work import copy_work, make_work
from .zygote import run_command

# What lightmatrix may import late; once here, not in each child.
_HEAVY = ("zarr", "scipy.io", "scipy.signal", "scipy.sparse.linalg", "tifffile", "PIL.Image")


def preload() -> None:
    """Import what commands import, so that a child need not."""
    for name in (*_HEAVY, "pydantic", "matplotlib.pyplot", "rich.progress", "typer"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    import lightmatrix
    from lightmatrix.cli import main

    for module in pkgutil.walk_packages(lightmatrix.__path__, "lightmatrix.", lambda _: None):
        if module.name.rpartition(".")[2] != "__main__":
            with contextlib.suppress(Exception):
                importlib.import_module(module.name)
    # What the first command of a process still loads and builds, whatever it does.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        main(["info", "not-there.zarr", "--json"])


def run_case(case: Case, template: Path, needs: Iterable[str]) -> tuple[Outcome, str, float]:
    """Put a case's fault into a fresh copy of the work folder, run it, and judge."""
    with tempfile.TemporaryDirectory(prefix="case-", dir=template.parent) as base:
        place = Path(base) / "outer" / "work"
        copy_work(template, place, {*needs, *case.needs})
        (Path(base) / "tmp").mkdir()
        os.environ["TMPDIR"] = str(Path(base) / "tmp")
        started = time.perf_counter()
        try:
            case.prepare(place)
            before = snapshot(place.parent.parent)
            ran = _ran(case, place)
        except SkipError as reason:
            return Outcome.SKIPPED, str(reason), 0.0
        after = snapshot(place.parent.parent)
        outcome, detail = judge(case, ran, before, after)
        if outcome in (Outcome.FINE, Outcome.REFUSED_WELL):
            outcome, detail = _checked(case, ran, place, outcome, detail)
        return outcome, detail, time.perf_counter() - started


def _ran(case: Case, place: Path) -> Ran:
    run = functools.partial(run_command, folder=place, seconds=case.seconds)
    if case.scenario is not None:
        return case.scenario(place, run)
    return run(case.command, limits=case.limits)


def _checked(
    case: Case, ran: Ran, place: Path, outcome: Outcome, detail: str
) -> tuple[Outcome, str]:
    complaint = None if case.check is None else case.check(place, ran)
    if complaint:
        return (
            Outcome.ACCEPTED_WRONGLY if ran.code == 0 else Outcome.UNCLEAR,
            complaint,
        )
    if case.then is not None:
        second = run_command(case.then, place, seconds=case.seconds)
        if second.code != 0:
            words = " / ".join(second.err.strip().splitlines())[:200]
            return Outcome.REFUSED_WRONGLY, f"afterwards `{case.then}`: {second.code}, {words}"
    return outcome, detail


def answer(request: dict[str, Any], home: Path) -> dict[str, Any]:
    """One request's answer, JSON-ready."""
    template = home / "template"
    if request["do"] == "make":
        make_work(template)
        return {"outcome": Outcome.FINE}
    if request["do"] == "case":
        name = request["name"]
        outcome, detail, seconds = run_case(ALL[name], template, NEEDS[group_of(name)])
    else:
        outcome, detail, seconds = fuzz.run_one(request["number"], template)
    return {"outcome": outcome, "detail": detail, "seconds": seconds}


def serve(home: Path) -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    preload()
    # What is here now is not looked at again, so that children need not copy it.
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        try:
            result = answer(json.loads(line), home)
        except Exception as error:
            result = {
                "outcome": "broken",
                "detail": f"{type(error).__name__}: {error}",
                "seconds": 0,
            }
        answers.write(json.dumps(result) + "\n")
        answers.flush()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
