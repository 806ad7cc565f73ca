"""Estimates by several processes: the same bits, whichever process dies; and refusals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from multiprocessing import spawn
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import lightmatrix as lm
from lightmatrix.capture.packed import PackedFrames
from lightmatrix.cli import main
from lightmatrix.errors import ClusterError, InputError, MissingExtraError
from lightmatrix.estimators import workers as workers_module
from lightmatrix.estimators.coherent import schedule
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.work import LEAST_TILE, cut_rows
from lightmatrix.estimators.workers import dask_pool
from lightmatrix.solvers import ActiveSet
from lightmatrix.transport import store
from lightmatrix.transport.matrix import LightTransport
from tests.helpers.systems import SIGNALS

distributed = pytest.importorskip("distributed")
WINDOWS = ((2, 1), (1, 1))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Two workers that the estimate did not start."""
    # On a busy machine Dask warns of slow disks and slow ends.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        started = distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=50,
            memory_limit=0,
            local_directory=str(tmp_path_factory.mktemp("dask")),
        )
    yield started
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        started.close()


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> lm.Capture:
    """Photographs in files, 24 x 22 of them."""
    folder = tmp_path_factory.mktemp("capture") / "capture.zarr"
    scene = lm.ProceduralScene((24, 22), (24, 24))
    lm.simulate(scene.truth(), lm.BernoulliPatterns((24, 24), 24)).save(folder)
    return lm.Capture.open(folder)


def place_of(capture: lm.Capture) -> Path:
    """The folder of a packed capture."""
    assert isinstance(capture.frames, PackedFrames)
    return capture.frames.array.place.parents[1]


def same(one: LightTransport, other: LightTransport) -> bool:
    return (
        all(
            np.array_equal(getattr(one.sparse, name), getattr(other.sparse, name))
            for name in ("data", "indices", "indptr")
        )
        and np.array_equal(one.background, other.background)
        and one.diagnostics.keys() == other.diagnostics.keys()
        and all(
            np.array_equal(values, other.diagnostics[name], equal_nan=True)
            for name, values in one.diagnostics.items()
        )
    )


ESTIMATORS: dict[str, Any] = {
    "plain": PlainEstimator(ActiveSet(), 0.1, tile_rows=100),
    "multi-scale": MultiScaleEstimator(ActiveSet(), 0.1),
    "coherent": CoherentEstimator(windows=WINDOWS, tile_rows=100),
    "growing": CoherentEstimator(windows=WINDOWS, tile_rows=100),
}


@pytest.fixture(scope="module")
def coherent(capture: lm.Capture) -> LightTransport:
    """The estimate of this process alone."""
    made: LightTransport = ESTIMATORS["coherent"].estimate(capture)
    return made


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_workers_give_the_same(
    name: str, capture: lm.Capture, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "growing":
        large_frames = replace(schedule.GROWTH, large=0, fewest_seeds=3)
        monkeypatch.setattr(schedule, "GROWTH", large_frames)
    estimator, reported = ESTIMATORS[name], list[int]()
    alone = estimator.estimate(capture)
    with dask_pool(cluster=cluster.scheduler_address) as workers:
        estimate = estimator.estimate(
            capture,
            output=tmp_path / "s.zarr",
            progress=lambda done, total: reported.append(done),
            pool=workers,
        )
    assert same(estimate, alone)
    assert same(store.open(tmp_path / "s.zarr"), alone)
    assert reported == sorted(reported)
    assert reported[-1] == capture.rows
    assert os.listdir(tmp_path) == ["s.zarr"]


def test_a_pool_makes_one_estimate_after_the_other(capture: lm.Capture, cluster: Any) -> None:
    alone = ESTIMATORS["plain"].estimate(capture)
    with dask_pool(cluster=cluster.scheduler_address) as workers:
        for _ in range(2):
            assert same(ESTIMATORS["plain"].estimate(capture, pool=workers), alone)


@SIGNALS
def test_a_worker_that_dies_costs_its_tile_only(
    capture: lm.Capture, cluster: Any, coherent: LightTransport, tmp_path: Path
) -> None:
    estimator = ESTIMATORS["coherent"]
    killed, reported = list[int](), list[int]()

    def kill(done: int, total: int) -> None:
        reported.append(done)
        if not killed and done > total / 4:
            pids = workers.client.run(os.getpid)
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    with dask_pool(cluster=cluster.scheduler_address) as workers:
        estimate = estimator.estimate(
            capture, output=tmp_path / "s.zarr", progress=kill, pool=workers
        )
    assert killed
    # No tile is solved twice: each is reported once.
    assert reported == sorted(reported)
    assert same(estimate, coherent)
    assert os.listdir(tmp_path) == ["s.zarr"]


KILLED = """
import os, pathlib, signal, sys
import lightmatrix as lm
from tests.estimators.test_workers import ESTIMATORS
from lightmatrix.estimators.workers import dask_pool
capture = lm.Capture.open(sys.argv[1])
kill = lambda done, total: done > total / 2 and os.kill(os.getpid(), signal.SIGKILL)
with dask_pool(cluster=sys.argv[2]) as workers:
    target = pathlib.Path(sys.argv[3])
    ESTIMATORS["coherent"].estimate(capture, output=target, progress=kill, pool=workers)
"""


@SIGNALS
def test_a_killed_estimate_continues_with_its_workers(
    capture: lm.Capture, cluster: Any, coherent: LightTransport, tmp_path: Path
) -> None:
    address, target = cluster.scheduler_address, tmp_path / "s.zarr"
    command = [sys.executable, "-c", KILLED, str(place_of(capture)), address, str(target)]
    killed = subprocess.run(command, cwd=Path(__file__).parents[2], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not target.exists()
    reported = list[int]()
    with dask_pool(cluster=address) as workers:
        estimate = ESTIMATORS["coherent"].estimate(
            capture, output=target, progress=lambda done, total: reported.append(done), pool=workers
        )
    assert min(reported) > 0.4 * capture.rows
    assert same(estimate, coherent)
    assert os.listdir(tmp_path) == ["s.zarr"]


def test_runs_with_and_without_workers_continue_each_other(
    capture: lm.Capture, cluster: Any, coherent: LightTransport, tmp_path: Path
) -> None:
    address = cluster.scheduler_address
    target = tmp_path / "s.zarr"

    def run(with_workers: bool, stop_at: float | None) -> list[int]:
        reported = list[int]()

        def stop(done: int, total: int) -> None:
            reported.append(done)
            if stop_at is not None and done > stop_at * total:
                raise KeyboardInterrupt

        estimator = CoherentEstimator(windows=WINDOWS, tile_rows=60)
        with dask_pool(cluster=address) if with_workers else nullcontext() as workers:
            estimator.estimate(capture, output=target, progress=stop, pool=workers)
        return reported

    for with_workers, share in ((True, 0.3), (False, 0.6), (True, 0.8)):
        with pytest.raises(KeyboardInterrupt):
            run(with_workers, share)
        assert not target.exists()
    assert min(run(False, None)) > 0.6 * capture.rows
    assert same(store.open(target), coherent)
    assert os.listdir(tmp_path) == ["s.zarr"]


def test_the_command_starts_its_own_workers(capture: lm.Capture, tmp_path: Path) -> None:
    output = tmp_path / "s.zarr"
    command = [
        "estimate",
        str(place_of(capture)),
        "-o",
        str(output),
        "--no-coherent",
        "--workers",
        "2",
    ]
    assert main([*command, "--memory", "2GiB", "--no-check"]) == 0
    assert same(store.open(output), lm.estimate(capture, coherent=False, check=False))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not stop processes")
def test_the_tiles_of_a_stopped_worker_go_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    # On a busy machine workers that live may be silent for some seconds.
    monkeypatch.setattr(workers_module, "PATIENCE", replace(workers_module.PATIENCE, silent=20.0))
    truth = lm.ProceduralScene((24, 22), (24, 24)).truth()
    capture = lm.simulate(truth, lm.BernoulliPatterns((24, 24), 48), exposure=0.5)
    estimator, stopped = PlainEstimator(ActiveSet()), list[int]()

    def stop(done: int, total: int) -> None:
        if not stopped:
            stopped.append(next(iter(pool.client.run(os.getpid).values())))
            os.kill(stopped[0], signal.SIGSTOP)

    with dask_pool(2) as pool:
        estimate = estimator.estimate(capture, progress=stop, pool=pool)
    assert stopped
    assert same(estimate, estimator.estimate(capture))


# ---- refusals before any work


def refused(address: str, capture: lm.Capture, output: Path) -> ClusterError:
    with pytest.raises(ClusterError) as caught:
        lm.estimate(capture, coherent=False, cluster=address, output=output)
    assert caught.value.hint
    assert not output.exists()
    assert not os.listdir(output.parent)
    return caught.value


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "ftp://127.0.0.1:9"])
def test_a_scheduler_that_does_not_answer(
    address: str, capture: lm.Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers_module, "PATIENCE", replace(workers_module.PATIENCE, scheduler=0.5))
    assert "no scheduler of Dask answers" in str(refused(address, capture, tmp_path / "s.zarr"))


def test_workers_of_another_version(
    capture: lm.Capture, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers_module, "versions", lambda: {"lightmatrix": "9.1", "numpy": "3.2"})
    message = str(refused(cluster.scheduler_address, capture, tmp_path / "s.zarr"))
    assert f"lightmatrix {lm.__version__}, not 9.1" in message
    assert f"numpy {np.__version__}, not 3.2" in message


def test_a_worker_of_another_version_that_joins_late(
    capture: lm.Capture, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with dask_pool(cluster=cluster.scheduler_address) as workers:
        monkeypatch.setattr(workers_module, "versions", lambda: {"lightmatrix": "9.1"})
        with pytest.raises(ClusterError, match=f"a worker: has lightmatrix {lm.__version__}, not"):
            ESTIMATORS["plain"].estimate(capture, pool=workers)


def test_workers_without_the_package(
    capture: lm.Capture, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = ModuleType("of_another_machine")
    exec("def about(dask_worker): return {}", module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(workers_module, "describe_worker", module.about)
    message = str(refused(cluster.scheduler_address, capture, tmp_path / "s.zarr"))
    assert "does not have this version of lightmatrix" in message


def test_a_capture_that_workers_do_not_see(
    capture: lm.Capture, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os.path, "abspath", lambda path: f"/elsewhere{path}")
    error = refused(cluster.scheduler_address, capture, tmp_path / "s.zarr")
    assert "/elsewhere" in str(error)
    assert "all workers share" in str(error.hint)


def test_settings_that_exclude_one_another(
    capture: lm.Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="workers here and a cluster"):
        lm.EstimateSettings(workers=2, cluster="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="workers is 0"):
        lm.EstimateSettings(workers=0)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"lightmatrix\[cluster\]"):
        lm.estimate(capture, workers=2)


def test_workers_share_memory(capture: lm.Capture) -> None:
    one = lm.estimate_resources(capture)
    two = lm.estimate_resources(capture, lm.EstimateSettings(workers=2))
    assert two.memory == 2 * one.memory
    assert "(2 workers)" in str(two)


@given(st.integers(0, 9000), st.integers(1, 9000), st.integers(1, 40))
def test_tiles_of_a_step(rows: int, most: int, parts: int) -> None:
    spans = list(cut_rows(rows, most, parts))
    assert [0, *(stop for _, stop in spans)] == [*(start for start, _ in spans), rows]
    sizes = [stop - start for start, stop in spans]
    assert max(sizes, default=0) <= most
    assert sizes == sorted(sizes, reverse=True)
    if parts > 1:
        assert len(spans) >= parts or rows < 2 * parts * LEAST_TILE
        # The first tile is about twice an equal part, where that fits.
        assert sizes[:1] <= [max(LEAST_TILE, 2 * -(-rows // parts))]
        if rows > 4 * parts * LEAST_TILE and parts > 3 and most >= rows:
            assert sizes[0] >= 2 * rows // parts
        # The last tile takes at most half as long as an equal part would.
        assert sizes[-1:] <= [max(LEAST_TILE, -(-rows // parts) // 2 + 1)]


def test_workers_do_not_import_the_script_that_starts_them(monkeypatch: pytest.MonkeyPatch) -> None:
    # The test runner may not be a script, so that this one is made up.
    monkeypatch.setattr(spawn, "get_preparation_data", lambda name: {"init_main_from_path": name})

    def script_keys(name: str) -> set[str]:
        return {key for key in spawn.get_preparation_data(name) if key.startswith("init_main")}

    with workers_module._without_script():
        assert not script_keys("Dask Worker process (from Nanny)")
        assert script_keys("another's")
    assert script_keys("Dask Worker process (from Nanny)")
