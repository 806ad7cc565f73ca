"""Mutation testing: break one thing in a copy of the sources, and see whether a test fails.

    python tools/mutants.py                      a sample of 200 mutants of the folders in TARGETS
    python tools/mutants.py src/lightmatrix/solvers --tests tests/solvers --count 60 --seed 1

First the tests in SUITES run once, in as many processes as --jobs, to record which test runs which
line. The record of each file of tests is kept in mutants-out/records until the file or a source
that it runs changes, so a run that was stopped goes on where it was. Then each mutant gets the
tests that run its line, those named after its module and the quickest first, up to a budget of
seconds; the first test that fails kills it. The survivors are printed and written to
mutants-out/mutants.json: either a test is missing, or the mutant changes nothing that matters.
Compiled code is not mutated.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mutations import Mutant, mutants_of, mutated

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "mutants-out"
PACKAGE = Path("src") / "lightmatrix"
TARGETS = [
    PACKAGE / name
    for name in ("solvers", "estimators", "capture", "diagnosis", "transport", "evaluation")
]
# Tests that run the code of TARGETS in their own process. Others would double the time of the
# record: those of the live rig wait for devices, those of the faults run the command line in
# processes whose lines are not recorded, and those of stores and plans run few of these lines.
SUITES = [
    *("tests/solvers", "tests/estimators", "tests/capture", "tests/check", "tests/transport"),
    *("tests/judgement", "tests/core", "tests/capture"),
    *("tests/cli/test_bad_input.py", "tests/cli/test_same_from_python.py"),
]
# Modules that are imported once, before the children are forked: a child then starts in one second
# instead of five.
HEAVY = (
    "pytest hypothesis numpy scipy.sparse scipy.optimize scipy.ndimage scipy.signal scipy.io zarr "
    "matplotlib.pyplot typer rich tifffile"
)
# Each mutant gets tests of at most this many recorded seconds of the processor.
BUDGET = 60.0
# A mutant hangs if it takes twice the recorded seconds of the processor and 20 seconds more, or ten
# times and five minutes more by the clock. Chosen by hand: a busy machine is no reason to kill.
CPU_PATIENCE, CPU_GRACE = 2.0, 20.0
PATIENCE, GRACE = 10.0, 300.0
# Options of pytest in a child. It warns that it cannot rewrite plugins that are imported already.
QUIETLY = ["-p", "no:cacheprovider", "-p", "no:faulthandler"]
QUIETLY += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
# The exit code of a child in which pytest could not be started.
BROKEN = 97


def main() -> int:
    """Record if need be, run a sample of mutants, report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", type=Path, default=TARGETS)
    parser.add_argument("--count", type=int, default=200, help="size of the sample; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", default=SUITES, help="folders and files of tests")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds of tests a mutant")
    parser.add_argument("--stale", action="store_true", help="trust records of earlier sources")
    parser.add_argument("--least", type=float, default=0.0, help="fail below this share killed")
    arguments = parser.parse_args()
    (OUT / "records").mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        # Mutants live in copies, so that the working tree may change meanwhile.
        copies = [copied(Path(folder) / str(number)) for number in range(arguments.jobs)]
        mutants = sample(copies[0], arguments.paths, arguments.count, arguments.seed)
        for module in HEAVY.split():
            importlib.import_module(module)
        recorded = recording(copies, arguments.tests, arguments.stale)
        control(mutants, recorded, copies[0])
        fates = run(mutants, recorded, copies, arguments.budget)
    return report(mutants, fates, arguments.least)


def sample(tree: Path, paths: list[Path], count: int, seed: int) -> list[Mutant]:
    """Some mutants of the files in `paths`, all if `count` is 0."""
    files = python_files([tree / path for path in paths], "*.py")
    mutants = [m for f in files for m in mutants_of(f.relative_to(tree), f.read_text())]
    chosen = mutants
    if 0 < count < len(mutants):
        chosen = random.Random(seed).sample(mutants, count)
    print(f"{len(chosen)} of {len(mutants)} mutants", flush=True)
    return chosen


def python_files(places: list[Path], pattern: str) -> list[Path]:
    """The files among `places`, and those in its folders whose names match."""
    return sorted(f for p in places for f in ([p] if p.is_file() else p.rglob(pattern)))


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


def recording(trees: list[Path], suites: list[str], trusted: bool) -> dict[str, Any]:
    """Tests with their seconds, and for each file's lines the tests that run them."""
    tree = trees[0]
    files = python_files([tree / suite for suite in suites], "test_*.py")
    names = [str(file.relative_to(tree)) for file in files]
    # The largest files first, so that the processes end at about the same time.
    stale = sorted(
        (n for n in names if not (is_current(kept(n), tree, n) or (trusted and kept(n).exists()))),
        key=lambda name: -(tree / name).stat().st_size,
    )
    if stale:
        print(f"recording which lines {len(stale)} files of tests run", flush=True)
    idle, busy = list(trees), dict[int, tuple[Path, str]]()
    while stale or busy:
        while stale and idle:
            copy, name = idle.pop(), stale.pop(0)
            kept(name).unlink(missing_ok=True)
            child = os.fork()
            if child == 0:
                record(copy, name)
            busy[child] = copy, name
        child, _ = os.wait()
        copy, name = busy.pop(child)
        idle.append(copy)
        if not kept(name).exists():
            raise SystemExit(f"the tests of {name} could not be recorded: run them")
    return merge([json.loads(kept(name).read_text()) for name in names])


def kept(name: str) -> Path:
    """Where the record of a file of tests is kept."""
    return OUT / "records" / (name.replace("/", ".") + ".json")


def is_current(record: Path, tree: Path, name: str) -> bool:
    """Whether neither the tests nor a source that they run has changed since the record."""
    if not record.exists():
        return False
    earlier = json.loads(record.read_text())
    return bool(earlier["digests"] == digests(tree, name, earlier["lines"]))


def digests(tree: Path, name: str, sources: Iterable[str]) -> dict[str, str]:
    """The digests of a file of tests, of what it may import from other tests, and of sources."""
    shared = [*(tree / "tests").rglob("conftest.py"), *(tree / "tests/helpers").rglob("*.py")]
    files = [tree / name, *shared, *(tree / source for source in sources)]
    return {
        str(file.relative_to(tree)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if file.exists()
    }


def merge(records: list[dict[str, Any]]) -> dict[str, Any]:
    """The records of several files of tests as one."""
    lines: dict[str, dict[str, list[str]]] = {}
    for record in records:
        for file, tests_by_line in record["lines"].items():
            for line, tests in tests_by_line.items():
                lines.setdefault(file, {}).setdefault(line, []).extend(tests)
    return {
        "seconds": {test: n for record in records for test, n in record["seconds"].items()},
        "failed": [test for record in records for test in record["failed"]],
        "lines": lines,
    }


class Recorder:
    """A pytest plugin: one coverage context a test, and one a shared fixture."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.failed: set[str] = set()
        self.users: dict[str, list[str]] = {}
        self.began = 0.0

    def pytest_collection_finish(self, session: Any) -> None:
        for item in session.items:
            for name in item.fixturenames:
                file = item.nodeid.split("::")[0]
                self.users.setdefault(f"{file}::fixture {name}", []).append(item.nodeid)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)

    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> None:
        # All tests that use a shared fixture rely on the lines that it runs, not only the first.
        if fixturedef.scope != "function":
            file = request.node.nodeid.split("::")[0]
            self.coverage.switch_context(f"{file}::fixture {fixturedef.argname}")

    def pytest_fixture_post_finalizer(self) -> None:
        self.coverage.switch_context("")

    def pytest_runtest_call(self, item: Any) -> None:
        self.coverage.switch_context(item.nodeid)
        # Seconds of the processor, since others may use it too.
        self.began = time.process_time()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call":
            self.seconds[report.nodeid] += time.process_time() - self.began
        if report.failed:
            self.failed.add(report.nodeid)


def record(tree: Path, name: str) -> None:
    """In a child: run a file of tests under coverage, write its record, leave."""
    code = BROKEN
    try:
        enter(tree)
        import coverage
        import pytest

        measured = coverage.Coverage(
            data_file=None, include=[str(tree / PACKAGE / "*")], config_file=False
        )
        recorder = Recorder(measured)
        measured.start()
        code = int(pytest.main([*QUIETLY, name], plugins=[recorder]))
        measured.stop()
        data = measured.get_data()
        lines: dict[str, dict[int, list[str]]] = {}
        for file in data.measured_files():
            contexts = data.contexts_by_lineno(file)
            lines[str(Path(file).relative_to(tree))] = {
                line: sorted({t for n in names for t in recorder.users.get(n, [n]) if t})
                for line, names in contexts.items()
                if any(names)
            }
        lines = {file: tests_by_line for file, tests_by_line in lines.items() if tests_by_line}
        entry = {
            "digests": digests(tree, name, lines),
            "seconds": recorder.seconds,
            "failed": sorted(recorder.failed),
            "lines": lines,
        }
        kept(name).write_text(json.dumps(entry))
    finally:
        os._exit(code)


def tests_of(mutant: Mutant, recorded: dict[str, Any], budget: float) -> tuple[list[str], float]:
    """Tests that run the mutant's lines, those of its own file and the quickest first, in seconds.

    Lines that run when their module is imported are left to the tests that run any of its lines.
    """
    lines = recorded["lines"].get(str(mutant.file), {})
    names = {t for n in range(mutant.first, mutant.last + 1) for t in lines.get(str(n), [])}
    names = names or {t for tests in lines.values() for t in tests} or set(recorded["seconds"])
    seconds, own = recorded["seconds"], f"/test_{mutant.file.stem}.py"
    usable = sorted(
        (n for n in names if n in seconds and n not in recorded["failed"]),
        key=lambda n: (own not in n, seconds[n], n),
    )
    chosen: list[str] = []
    total = 0.0
    for name in usable:
        total += seconds[name] + 0.005  # pytest itself takes some 5 ms a test
        if chosen and total > budget:
            break
        chosen.append(name)
    return chosen, min(total, budget)


# --- running


def control(mutants: list[Mutant], recorded: dict[str, Any], tree: Path) -> None:
    """Check that the tests pass on the unbroken tree; else every mutant would count as killed."""
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
        limit = round(CPU_PATIENCE * seconds + CPU_GRACE)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        attempt(worker.tree, tests)
    return True


def attempt(tree: Path, tests: list[str]) -> None:
    """In the child: run the tests, leave with pytest's code."""
    code = BROKEN
    try:
        enter(tree)
        import pytest

        code = int(pytest.main(["-x", *QUIETLY, *tests]))
    finally:
        os._exit(code)


def enter(tree: Path) -> None:
    """In a child: print nothing, and import the package from this copy of the tree."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    os.chdir(tree)
    os.environ.update(environment(tree))
    sys.path[:0] = [str(tree / "src")]
    # A .pyc of an earlier mutant of the same size and second would be run instead of this one.
    sys.dont_write_bytecode = True


def environment(tree: Path) -> dict[str, str]:
    """Let children import the copy, and use one thread each, since mutants run side by side."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    settings = {"PYTHONPATH": str(tree / "src"), "PYTHONDONTWRITEBYTECODE": "1", "NO_COLOR": "1"}
    return {**os.environ, **single, **settings}


def fate_of(worker: Worker) -> str | None:
    """How the child ended; None while it runs."""
    done, status = os.waitpid(worker.child, os.WNOHANG)
    if done:
        code = os.waitstatus_to_exitcode(status)
        if code == BROKEN:
            raise SystemExit("the tests could not be started")
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            return "timeout"
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
