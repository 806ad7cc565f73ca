"""The work folder of the cases, made once in a process of tests, and a fresh copy for each case."""

from __future__ import annotations

import multiprocessing.forkserver
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.systems import FORKS

from .work import fresh_copy, make_work

ROOT = Path(__file__).resolve().parents[2]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Commands run in processes that are forked off."""
    for item in items:
        if item.path.parent == Path(__file__).parent:
            item.add_marker(FORKS)


@pytest.fixture(scope="session")
def template() -> Iterator[Path]:
    """The work folder with everything in it."""
    # Thousands of small files cost least in memory, if devices may be made there too.
    memory = Path("/dev/shm")
    usable = memory.is_dir() and not os.statvfs(memory).f_flag & (os.ST_NODEV | os.ST_NOEXEC)
    with (
        tempfile.TemporaryDirectory(prefix="faults-", dir=memory if usable else None) as home,
        pytest.MonkeyPatch.context() as patch,
    ):
        for name, value in {
            "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "Agg",
            "MPLCONFIGDIR": f"{home}/matplotlib",
            "XDG_CACHE_HOME": f"{home}/cache",
            "COLUMNS": "200",
            "NO_COLOR": "1",
        }.items():
            patch.setenv(name, value)
        multiprocessing.set_forkserver_preload(["tests.faults.warm"])
        multiprocessing.forkserver.ensure_running()
        place = Path(home) / "template" / "outer" / "work"
        (Path(home) / "template" / "tmp").mkdir(parents=True)
        make_work(place)
        yield place


@pytest.fixture
def work(request: pytest.FixtureRequest, template: Path) -> Iterator[Path]:
    """A fresh copy of what the cases of a module need: its NEEDS."""
    with fresh_copy(template, request.module.NEEDS) as place:
        yield place
