"""Mutation testing: break one thing in a copy of the sources, and see whether a test fails.

    python tools/mutants.py                      200 of all mutants of solvers, estimators, capture
    python tools/mutants.py --count 60 --seed 1 src/lightmatrix/solvers

First the whole suite runs once, to record which test runs which line (kept until sources or tests
change). Then each mutant is given the tests that run its line, the quickest first, up to a budget;
the first that fails kills it. Survivors are printed and written to mutants-out/mutants.json: either
a test is missing, or the mutant changes nothing that matters. Compiled code is not mutated.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mutations import Mutant, mutants_of, mutated

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "mutants-out"
PACKAGE = Path("src") / "lightmatrix"
TARGETS = [PACKAGE / name for name in ("solvers", "estimators", "capture")]
# Imported once, before workers are forked: a mutant then costs a second, not five.
HEAVY = (
    "pytest hypothesis numpy scipy.sparse scipy.optimize scipy.ndimage scipy.signal scipy.io zarr "
    "matplotlib.pyplot typer rich imageio tifffile"
)
# Seconds of tests, as recorded, that a mutant is given. It may take PATIENCE times as long, and
# GRACE more, before it counts as one that hangs.
BUDGET = 60.0
PATIENCE, GRACE = 4.0, 60.0
# Exit code of a child in which pytest could not be started.
BROKEN = 97


def main() -> int:
    """Record if need be, run a sample of mutants, report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", type=Path, default=TARGETS)
    parser.add_argument("--count", type=int, default=200, help="size of the sample; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds of tests a mutant")
    parser.add_argument("--least", type=float, default=0.0, help="fail below this share killed")
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.record:
        return record(arguments.record)
    OUT.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        # Who goes on working in the tree does not disturb.
        copies = [copied(Path(folder) / str(number)) for number in range(arguments.jobs)]
        mutants = sample(copies[0], arguments.paths, arguments.count, arguments.seed)
        recorded = recording(copies[0])
        for module in HEAVY.split():
            importlib.import_module(module)
        control(mutants, recorded, copies[0])
        fates = run(mutants, recorded, copies, arguments.budget)
    return report(mutants, fates, arguments.least)


def sample(tree: Path, paths: list[Path], count: int, seed: int) -> list[Mutant]:
    """Some mutants of the files in `paths`, all if `count` is 0."""
    found = [tree / path for path in paths]
    files = sorted(f for p in found for f in ([p] if p.is_file() else p.rglob("*.py")))
    mutants = [m for f in files for m in mutants_of(f.relative_to(tree), f.read_text())]
    chosen = mutants
    if 0 < count < len(mutants):
        chosen = random.Random(seed).sample(mutants, count)
    print(f"{len(chosen)} of {len(mutants)} mutants", flush=True)
    return chosen


def copied(to: Path) -> Path:
    """A copy of the working tree: what git knows or does not ignore, and the compiled core."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout.splitlines()  # fmt: skip
    core = [str(path.relative_to(ROOT)) for path in (ROOT / PACKAGE).glob("_core*.so")]
    for name in [*listed, *core]:
        if (ROOT / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, to / name)
    return to


# --- which test runs which line


def recording(tree: Path) -> dict[str, Any]:
    """Tests with their seconds, and for each file's lines the tests that run them."""
    sources = [*(tree / "src").rglob("*.py"), *(tree / "tests").rglob("*.py")]
    digest = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(sources))).hexdigest()
    kept = OUT / "coverage.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text())
        if found["digest"] == digest:
            return found
    print("recording which test runs which line: the whole suite, once", flush=True)
    result = tree / "coverage.json"
    command = [sys.executable, "tools/mutants.py", "--record", str(result)]
    subprocess.run(command, cwd=tree, env=environment(tree), check=True)
    found = {"digest": digest, **json.loads(result.read_text())}
    kept.write_text(json.dumps(found))
    return found


class Recorder:
    """A pytest plugin: one coverage context a test, and one a shared fixture."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: Counter[str] = Counter()
        self.failed: set[str] = set()
        self.users: dict[str, list[str]] = {}

    def pytest_collection_finish(self, session: Any) -> None:
        for item in session.items:
            for name in item.fixturenames:
                file = item.nodeid.split("::")[0]
                self.users.setdefault(f"{file}::fixture {name}", []).append(item.nodeid)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)

    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> None:
        # What a shared fixture runs, all tests that use it rely on, not only the first.
        if fixturedef.scope != "function":
            file = request.node.nodeid.split("::")[0]
            self.coverage.switch_context(f"{file}::fixture {fixturedef.argname}")

    def pytest_fixture_post_finalizer(self) -> None:
        self.coverage.switch_context("")

    def pytest_runtest_call(self, item: Any) -> None:
        self.coverage.switch_context(item.nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call":
            self.seconds[report.nodeid] += report.duration
        if report.failed:
            self.failed.add(report.nodeid)


def record(target: Path) -> int:
    """In a copy of the tree: run the suite under coverage."""
    import coverage
    import pytest

    measured = coverage.Coverage(
        data_file=None, include=[str(Path.cwd() / PACKAGE / "*")], config_file=False
    )
    recorder = Recorder(measured)
    measured.start()
    pytest.main(["-p", "no:cacheprovider"], plugins=[recorder])
    measured.stop()
    data = measured.get_data()
    lines: dict[str, dict[int, list[str]]] = {}
    for file in data.measured_files():
        contexts = data.contexts_by_lineno(file)
        lines[str(Path(file).relative_to(Path.cwd()))] = {
            line: sorted({t for name in names for t in recorder.users.get(name, [name]) if t})
            for line, names in contexts.items()
        }
    target.write_text(
        json.dumps({"seconds": recorder.seconds, "failed": sorted(recorder.failed), "lines": lines})
    )
    return 0


def tests_of(mutant: Mutant, recorded: dict[str, Any], budget: float) -> tuple[list[str], float]:
    """Tests that run the mutant's lines, quickest first, and how long they take."""
    lines = recorded["lines"].get(str(mutant.file), {})
    names = {t for n in range(mutant.first, mutant.last + 1) for t in lines.get(str(n), [])}
    if not names:  # Runs when the module is imported.
        names = {t for tests in lines.values() for t in tests}
    seconds = recorded["seconds"]
    usable = sorted(
        (n for n in names if n in seconds and n not in recorded["failed"]),
        key=lambda n: (seconds[n], n),
    )
    taken: list[str] = []
    total = 0.0
    for name in usable:
        total += seconds[name] + 0.005
        if taken and total > budget:
            break
        taken.append(name)
    return taken, min(total, budget)


# --- running


def control(mutants: list[Mutant], recorded: dict[str, Any], tree: Path) -> None:
    """See the tests pass while nothing is broken: else each mutant would count as killed."""
    tests = {t for m in mutants[:50] for t in tests_of(m, recorded, 1.0)[0]}
    child = os.fork()
    if child == 0:
        attempt(tree, sorted(tests))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        raise SystemExit(f"tests fail though nothing is broken (pytest's code {code}): run them")


@dataclass
class Worker:
    """A copy of the tree in which one mutant at a time is tried."""

    tree: Path
    index: int = -1
    original: str = ""
    deadline: float = 0.0
    child: int = 0


def run(
    mutants: list[Mutant], recorded: dict[str, Any], copies: list[Path], budget: float
) -> dict[int, str]:
    """The fate of each mutant: killed, timeout, survived, or not run by any test."""
    fates: dict[int, str] = {}
    waiting = list(range(len(mutants)))[::-1]
    idle = [Worker(tree) for tree in copies]
    busy: list[Worker] = []
    while waiting or busy:
        while waiting and idle:
            worker, index = idle.pop(), waiting.pop()
            if start(worker, index, mutants[index], recorded, budget):
                busy.append(worker)
            else:
                fates[index] = "not run by any test"
                idle.append(worker)
        time.sleep(0.05)
        for worker in list(busy):
            fate = fate_of(worker)
            if fate is not None:
                fates[worker.index] = fate
                (worker.tree / mutants[worker.index].file).write_text(worker.original)
                busy.remove(worker)
                idle.append(worker)
                mark = {"killed": ".", "timeout": "t"}.get(fate, "S")
                print(mark, end="" if len(fates) % 100 else "\n", flush=True)
    print()
    return fates


def start(
    worker: Worker, index: int, mutant: Mutant, recorded: dict[str, Any], budget: float
) -> bool:
    """Fork a child that tries the mutant; False if no test runs it."""
    tests, seconds = tests_of(mutant, recorded, budget)
    if not tests:
        return False
    file = worker.tree / mutant.file
    worker.index, worker.original = index, file.read_text()
    worker.deadline = time.monotonic() + PATIENCE * seconds + GRACE
    file.write_text(mutated(worker.original, mutant))
    worker.child = os.fork()
    if worker.child == 0:
        os.setpgid(0, 0)
        attempt(worker.tree, tests)
    return True


def attempt(tree: Path, tests: list[str]) -> None:
    """In the child: run the tests, leave with pytest's code."""
    code = BROKEN
    try:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os.chdir(tree)
        os.environ.update(environment(tree))
        sys.path[:0] = [str(tree / "src")]
        # A stale .pyc of a mutant of the same size and second would be run instead of the next.
        sys.dont_write_bytecode = True
        import pytest

        # Plugins that are imported already are not rewritten, which pytest warns of.
        options = ["-x", "-p", "no:cacheprovider", "-p", "no:faulthandler"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        code = int(pytest.main([*options, *tests]))
    finally:
        os._exit(code)


def environment(tree: Path) -> dict[str, str]:
    """Children import the copy; one thread each, since mutants run side by side."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    found = {"PYTHONPATH": str(tree / "src"), "PYTHONDONTWRITEBYTECODE": "1", "NO_COLOR": "1"}
    return {**os.environ, **single, **found}


def fate_of(worker: Worker) -> str | None:
    """What became of the child, None while it runs."""
    done, status = os.waitpid(worker.child, os.WNOHANG)
    if done:
        code = os.waitstatus_to_exitcode(status)
        if code == BROKEN:
            raise SystemExit("the tests could not be started")
        return "survived" if code == 0 else "killed"
    if time.monotonic() > worker.deadline:
        os.killpg(worker.child, signal.SIGKILL)
        os.waitpid(worker.child, 0)
        return "timeout"
    return None


def report(mutants: list[Mutant], fates: dict[int, str], least: float) -> int:
    """Print survivors and shares, write all fates."""
    rows = [{**m.described(), "fate": fates[i]} for i, m in enumerate(mutants)]
    rows.sort(key=lambda row: (row["file"], row["line"]))
    (OUT / "mutants.json").write_text(json.dumps(rows, indent=1) + "\n")
    for row in rows:
        if row["fate"] not in ("killed", "timeout"):
            print(f"{row['file']}:{row['line']}: {row['change']} ({row['fate']})")
    for folder in sorted({str(m.file.parent) for m in mutants}):
        inside = Counter(r["fate"] for r in rows if str(Path(r["file"]).parent) == folder)
        print(f"{folder}: {_share(inside)}")
    every = Counter(row["fate"] for row in rows)
    print(f"all: {_share(every)}")
    killed = (every["killed"] + every["timeout"]) / max(len(rows), 1)
    return 0 if killed >= least else 1


def _share(fates: Counter[str]) -> str:
    killed = fates["killed"] + fates["timeout"]
    timeouts = f", {fates['timeout']} by timeout" if fates["timeout"] else ""
    share = 100 * killed / max(fates.total(), 1)
    return f"{killed} of {fates.total()} killed ({share:.0f} %){timeouts}"


if __name__ == "__main__":
    sys.exit(main())
