"""From a capture to T: tiles do not matter, interrupted runs go on, the metrics are met."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError, OutputError
from lightmatrix.estimators import plain
from lightmatrix.estimators.base import solver_provenance
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error, unclipped_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import ADMM, ROMP, ActiveSet, Fidelity, SaturationADMM, Solver, solve
from lightmatrix.transport import store

EXPOSURE = 2.5


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """A small capture on disk and its truth."""
    truth = ProceduralScene((12, 10), (16, 16), seed=4, background=0.02, bounces=6).truth()
    patterns = BernoulliPatterns(truth.projector_shape, 96, seed=1)
    sensor = Sensor(EXPOSURE, 0.0, 0.003, 0.0, 8)
    frames = sensor.expose(irradiance(truth.matrix, patterns))
    assert 0.02 < (frames == 255).mean() < 0.5
    folder = tmp_path_factory.mktemp("rig") / "capture"
    stack = np.ascontiguousarray(frames.T).reshape(patterns.count, *truth.camera_shape)
    write_capture(folder, patterns, stack, sensor=sensor, camera_shape=truth.camera_shape)
    return folder, truth


def test_clip_aware_beats_clip_blind(rig: tuple[Path, Truth]) -> None:
    folder, truth = rig
    capture, known = Capture.open(folder), truth.transport()
    rows = np.flatnonzero(unclipped_rows(known, EXPOSURE))
    solvers: dict[str, Solver] = {
        "blind": ADMM(),
        "one-sided": SaturationADMM(),
        "clipped": SaturationADMM(Fidelity.CLIPPED),
    }
    error = {
        name: relative_error(PlainEstimator(solver, 0.05).estimate(capture), known, rows)
        for name, solver in solvers.items()
    }
    assert error["one-sided"] < 0.5 * error["blind"]
    assert error["clipped"] < 0.5 * error["blind"]


@pytest.mark.parametrize("solver", [ActiveSet(), SaturationADMM(), ADMM(), ROMP()])
def test_tiles_do_not_matter(rig: tuple[Path, Truth], solver: Any) -> None:
    capture = Capture.open(rig[0])
    whole = PlainEstimator(solver, tile_rows=1000).estimate(capture)
    tiles = PlainEstimator(solver, tile_rows=17).estimate(capture)
    difference = abs(whole.sparse - tiles.sparse)
    assert difference.max() < 1e-4
    np.testing.assert_allclose(whole.background, tiles.background, atol=1e-3)
    for name in ("clipped_share", "iterations", "converged", "gap", "objective"):
        assert whole.diagnostics[name].shape == (capture.rows,)


def test_interrupted_runs_go_on(
    rig: tuple[Path, Truth], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = Capture.open(rig[0])
    estimator = PlainEstimator(SaturationADMM(), tile_rows=40)
    expected = estimator.estimate(capture)
    solved: list[int] = []

    def interrupted(problem: Any, solver: Any, progress: Any) -> Any:
        if len(solved) == 2:
            raise KeyboardInterrupt
        solved.append(problem.rows)
        return solve(problem, solver, progress=progress)

    output = tmp_path / "scene.zarr"
    monkeypatch.setattr(plain, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        estimator.estimate(capture, output=output)
    assert not output.exists()

    solved.clear()
    again: list[int] = []

    def counted(problem: Any, solver: Any, progress: Any) -> Any:
        again.append(problem.rows)
        return solve(problem, solver, progress=progress)

    monkeypatch.setattr(plain, "solve", counted)
    estimate = estimator.estimate(capture, output=output)
    assert again == [40]
    assert abs(estimate.sparse - expected.sparse).max() == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.zarr"]
    stored = store.open(output)
    assert abs(stored.sparse - expected.sparse).max() == 0
    assert stored.provenance["solver"] == "SaturationADMM"
    assert stored.provenance["pattern_digest"] == capture.patterns.digest


def test_a_disk_that_is_too_small_is_said_before_anything_is_solved(
    rig: tuple[Path, Truth], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=5000))
    monkeypatch.setattr(plain, "solve", None)
    with pytest.raises(OutputError, match="takes at least about"):
        PlainEstimator(ActiveSet()).estimate(Capture.open(rig[0]), output=tmp_path / "s.zarr")
    assert not os.listdir(tmp_path)


def test_empty_tiles_are_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        PlainEstimator(ADMM(), tile_rows=0)


def test_the_provenance_names_the_solver_and_its_parameters() -> None:
    made = solver_provenance(ActiveSet(tolerance=1e-3, threads=2))
    assert made["solver"] == "ActiveSet"
    expected = {"fidelity": "one-sided", "tolerance": 1e-3, "max_passes": 200, "threads": 2}
    assert made["solver_parameters"] == expected
    assert json.loads(json.dumps(made)) == made


class Terminal(io.StringIO):
    """A terminal that somebody looks at."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("progress", "shown"), [(True, True), (False, False)])
def test_a_terminal_shows_progress(
    progress: bool, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16))
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    lm.estimate(capture, coherent=False, iterations=1, check=False, progress=progress)
    assert ("estimating" in terminal.getvalue()) == shown


def test_a_callable_counts_progress_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 16))
    terminal, counted = Terminal(), list[tuple[int, int]]()
    monkeypatch.setattr(sys, "stderr", terminal)
    lm.estimate(
        capture,
        coherent=False,
        iterations=1,
        check=False,
        progress=lambda done, total: counted.append((done, total)),
    )
    assert counted[-1] == (4096, 4096)
    assert terminal.getvalue() == ""


@pytest.mark.parametrize("coherent", [True, False])
def test_the_core_solves_rows_at_most_six_calls_below_estimate(coherent: bool) -> None:
    """The first lines of `estimators/estimate.py` list these calls."""
    truth = ProceduralScene((12, 12), (16, 16)).truth()
    capture = lm.simulate(truth, lm.BernoulliPatterns((16, 16), 32))
    depths: set[int] = set()

    def count(frame: Any, event: str, called: Any) -> None:
        name = getattr(called, "__name__", "")
        if event != "c_call" or name not in ("solve", "solve_weighted"):
            return
        files = []
        while frame is not None and frame.f_code is not lm.estimate.__code__:
            files.append(frame.f_code.co_filename)
            frame = frame.f_back
        if frame is not None:
            depths.add(1 + sum("lightmatrix" in file for file in files))

    sys.setprofile(count)
    try:
        lm.estimate(capture, coherent=coherent, check=False, progress=False)
    finally:
        sys.setprofile(None)
    assert depths
    assert max(depths) <= 6, depths
