"""Processes that work through cases, two at a time; one that dies is started again."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any, Self

# Longest that one request may take, several commands included, before its worker is replaced.
_PATIENCE = 240.0
_TESTS = Path(__file__).resolve().parents[1]


class Worker:
    """One process with everything imported, that forks for each command."""

    def __init__(self, home: Path) -> None:
        self._home = home
        self._process: subprocess.Popen[str] | None = None

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send one request; a worker that dies or is silent answers with an outcome of its own."""
        process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            ready, _, _ = select.select([process.stdout], [], [], _PATIENCE)
            line = process.stdout.readline() if ready else ""
        except BrokenPipeError:
            line = ""
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        process.kill()
        code = process.wait()
        self._process = None
        return {"outcome": "crash", "detail": f"the worker itself ended ({code})", "seconds": 0.0}

    def _start(self) -> subprocess.Popen[str]:
        path = os.pathsep.join(filter(None, (str(_TESTS), os.environ.get("PYTHONPATH"))))
        environment = {
            **os.environ,
            "PYTHONPATH": path,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "Agg",
            "MPLCONFIGDIR": str(self._home / "matplotlib"),
            "XDG_CACHE_HOME": str(self._home / "cache"),
            "COLUMNS": "200",
            "NO_COLOR": "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "faults.serve", str(self._home)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self._process

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._process.stdin.close()
            self._process.wait(_PATIENCE)
            self._process.stdout.close()
            self._process = None


def _quick_disk() -> str | None:
    """Where thousands of small files cost least: in memory, if devices may be made there too."""
    memory = Path("/dev/shm")
    try:
        limited = os.statvfs(memory).f_flag & (os.ST_NODEV | os.ST_NOEXEC)
    except OSError:
        return None
    return None if limited else str(memory)


class Pool:
    """Workers that share one folder of inputs, made at the start and removed at the end."""

    def __init__(self, workers: int = 2) -> None:
        self.home = Path(tempfile.mkdtemp(prefix="faults-", dir=_quick_disk()))
        self._free: Queue[Worker] = Queue()
        self._workers = [Worker(self.home) for _ in range(workers)]
        for worker in self._workers:
            self._free.put(worker)
        self._threads = ThreadPoolExecutor(workers)
        made = self._workers[0].ask({"do": "make"})
        if made.get("outcome") != "fine":
            self.close()
            raise RuntimeError(f"the inputs of the fault tests could not be made: {made}")

    def submit(self, request: dict[str, Any]) -> Future[dict[str, Any]]:
        """Have a request answered by the next worker that is free."""
        return self._threads.submit(self._ask, request)

    def answers(
        self, requests: Iterable[dict[str, Any]]
    ) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        """Requests with their answers, as they come."""
        pending = {self.submit(request): request for request in requests}
        for future in as_completed(pending):
            yield pending[future], future.result()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        worker = self._free.get()
        try:
            return worker.ask(request)
        finally:
            self._free.put(worker)

    def close(self) -> None:
        """End the workers and remove their folder."""
        self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.close()
        shutil.rmtree(self.home, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
