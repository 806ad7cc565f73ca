"""Coarse to fine: equal to the plain estimate if everything is kept, and what is kept otherwise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.capture.sensor import Sensor
from lightmatrix.cli import main
from lightmatrix.estimators import multiscale
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import (
    ADMM,
    ROMP,
    ActiveSet,
    Fidelity,
    Problem,
    SaturationADMM,
    Solver,
    solve,
)
from lightmatrix.solvers.admm import System, centred_energy
from lightmatrix.solvers.problem import objective
from lightmatrix.transport import store

SOLVERS = [ActiveSet(), SaturationADMM(), SaturationADMM(Fidelity.CLIPPED), ADMM(), ROMP()]


def photographed(truth: Truth, exposure: float, count: int = 96, noise: float = 0.003) -> Capture:
    patterns = BernoulliPatterns(truth.projector_shape, count, seed=1)
    sensor = Sensor(exposure, 0.0, noise, 0.0, 8 if noise else None)
    frames = sensor.expose(irradiance(truth.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(count, *truth.camera_shape)
    return Capture.from_arrays(patterns, stack, sensor)


@pytest.fixture(scope="module")
def truth() -> Truth:
    """A scene whose camera blocks look at compact parts of the projector."""
    return ProceduralScene((18, 13), (32, 32), seed=4, background=0.02, bounces=4).truth()


@pytest.fixture(scope="module")
def capture(truth: Truth) -> Capture:
    opened = photographed(truth, 2.5)
    assert 0.02 < opened.clipped_share < 0.6
    return opened


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
def test_keeping_everything_gives_the_plain_estimate(
    capture: Capture, solver: Solver, monkeypatch: pytest.MonkeyPatch
) -> None:
    if isinstance(solver, ADMM | SaturationADMM):
        # Both take the same steps, whether they have converged or not.
        solver = replace(solver, max_iterations=60)
    monkeypatch.setattr(multiscale, "active_blocks", lambda *of: np.ones(of[2], bool))
    plain = PlainEstimator(solver, 0.05).estimate(capture)
    whole = MultiScaleEstimator(solver, 0.05)
    estimate = whole.estimate(capture)
    assert (estimate.diagnostics["candidates"] == 1024).all()
    difference = np.linalg.norm((estimate.sparse - plain.sparse).data)
    assert difference < 2e-3 * np.linalg.norm(plain.sparse.data)
    np.testing.assert_allclose(estimate.background, plain.background, atol=0.02)
    clipped = estimate.diagnostics["clipped_share"]
    np.testing.assert_array_equal(clipped, plain.diagnostics["clipped_share"])


@pytest.mark.parametrize("solver", [*SOLVERS[:2], *SOLVERS[3:]], ids=lambda s: type(s).__name__)
def test_sparse_unclipped_rows_are_recovered(truth: Truth, solver: Solver) -> None:
    large = truth.matrix.data > 0.1 * truth.matrix.max()
    sparse = truth.matrix.copy()
    sparse.data = np.where(large, sparse.data, 0).astype(np.float32)
    sparse.eliminate_zeros()
    known = Truth(sparse[:78], sparse[:78].data, (6, 13), truth.projector_shape)
    unclipped = photographed(known, 0.9 / float(sparse.sum(axis=1).max()), 128, noise=0)
    assert unclipped.clipped_share == 0
    estimate = MultiScaleEstimator(solver, 0.01).estimate(unclipped)
    error = relative_error(estimate, known.transport())
    plain = relative_error(PlainEstimator(solver, 0.01).estimate(unclipped), known.transport())
    assert error < plain + 0.01
    # ROMP takes in wrong pixels too, and so gives up few blocks.
    if not isinstance(solver, ROMP):
        assert error < 0.01
        assert estimate.diagnostics["candidates"].mean() < 0.8 * 1024


def test_nothing_is_found_outside_the_candidates(capture: Capture) -> None:
    """Rows of a camera block share their candidates, dilated blocks of 2 x 2 pixels."""
    estimate = MultiScaleEstimator(ActiveSet(), 0.05).estimate(capture)
    counts = estimate.diagnostics["candidates"].reshape(capture.camera_shape)
    for top in range(0, 18, 8):
        for left in range(0, 13, 8):
            assert np.ptp(counts[top : top + 8, left : left + 8]) == 0
    assert (counts < 1024).any()
    assert (np.diff(estimate.sparse.indptr) <= counts.ravel()).all()
    again = MultiScaleEstimator(ActiveSet(), 0.05).estimate(capture)
    np.testing.assert_array_equal(estimate.sparse.toarray(), again.sparse.toarray())


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
def test_problems_on_some_pixels_keep_the_means_of_whole_patterns(solver: Any) -> None:
    """What the solvers compute of such a set is what its definition says."""
    whole = HadamardPatterns((8, 8), 40, "random", seed=3)
    columns = np.array([1, 8, 9, 20, 33, 63])
    patterns = ImagePatterns(whole.columns(columns)[:, None, :])
    centred = patterns.matrix.astype(np.float64) - whole.means[:, None]
    np.testing.assert_allclose(
        centred_energy(patterns, whole.means), (centred**2).sum(axis=1), atol=1e-9
    )
    system = System(patterns, 0.7, whole.means)
    matrix = np.column_stack([centred, system.scale * whole.means])
    random = np.random.default_rng(0)
    target, point = random.random((2, 40)), random.random((2, 7))
    x, prediction = system.solve(target, point)
    np.testing.assert_allclose(prediction, x @ matrix.T, atol=1e-10)
    gradient = (prediction - target) @ matrix + 0.7 * (x - point)
    np.testing.assert_allclose(gradient, 0, atol=1e-9)

    rows = random.random((3, 6)) @ patterns.matrix.T.astype(np.float64) + 0.4 * whole.means
    level = float(np.quantile(rows, 0.9))
    samples = np.minimum(rows, level)
    seen = Samples(samples, samples >= level, np.full(40, level))
    problem = Problem(patterns, seen, 1e-3, background_column=whole.means)
    result = solve(problem, solver)
    # Equation 6 is not convex; what is near its minimum is near that of the one-sided fidelity too.
    fidelity = solver.fidelity if solver.fidelity.convex else Fidelity.ONE_SIDED
    best = solve(problem, ActiveSet(fidelity, tolerance=1e-8))
    assert best.gap.max() < 1e-7
    reached = objective(problem, result.coefficients, result.background, fidelity)
    assert (reached > best.objective * (1 - 1e-7)).all()
    assert (reached < best.objective * 1.012).all()
    if fidelity is not Fidelity.LINEAR:  # which takes clipped samples for what they are not
        np.testing.assert_allclose(result.background, 0.4, atol=0.01)


def test_colour_channels_of_a_pixel_share_their_block(truth: Truth) -> None:
    grey = photographed(truth, 2.5, 64)
    frames = np.stack([grey.frames.read(k) for k in range(64)])
    colour = Capture.from_arrays(
        grey.patterns, np.repeat(frames[..., None], 3, axis=-1), grey.decoder
    )
    estimate = MultiScaleEstimator(ActiveSet(), 0.05).estimate(colour)
    assert estimate.camera_shape == (18, 13, 3)
    rows = estimate.sparse.toarray().reshape(18 * 13, 3, -1)
    np.testing.assert_allclose(rows[:, 0], rows[:, 2], atol=2e-3)


def test_the_command_line_estimates_by_scales(
    tmp_path: Path, truth: Truth, capsys: pytest.CaptureFixture[str]
) -> None:
    truth.save(tmp_path / "T.npz")
    patterns, capture, scene = (str(tmp_path / name) for name in ("p", "c", "s.zarr"))
    assert main(["patterns", "bernoulli", "-k", "48", "--size", "32x32", "-o", patterns]) == 0
    known = str(tmp_path / "T.npz")
    assert main(["simulate", known, "--patterns", patterns, "-o", capture]) == 0
    assert main(["estimate", capture, "-o", scene, "--multi-scale", "--solver", "romp"]) == 0
    made = store.open(scene).provenance
    assert made["estimator"] == "multi-scale"
    assert made["solver"] == "ROMP"
    capsys.readouterr()
    for wrong in ("--coherent", "--tile-rows=8"):
        assert main(["estimate", capture, "-o", scene, "--multi-scale", "--overwrite", wrong]) == 2
        assert wrong.split("=")[0].strip("-").replace("-", " ") in capsys.readouterr().err
