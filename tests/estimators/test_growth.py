"""Large frames: few rows search, estimates spread from them, and the result is as good."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.estimators.coherent import row_solver, schedule
from lightmatrix.estimators.coherent.estimator import WINDOWS, CoherentEstimator
from lightmatrix.estimators.coherent.neighbourhood import (
    CameraGrid,
    Neighbourhood,
)
from lightmatrix.estimators.coherent.rounds import SEARCHED
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

CAMERA = (40, 36)
# Every frame counts as large, or as one between small and large ones.
LARGE_FRAMES = replace(schedule.GROWTH, large=0, fewest_seeds=4)
BETWEEN = replace(schedule.GROWTH, small=0)


def photographed(truth: Truth, count: int = 32) -> Capture:
    patterns = BernoulliPatterns(truth.projector_shape, count, seed=1)
    sensor = Sensor(0.8, 0.0, 0.003, 0.0, 8)
    frames = sensor.expose(irradiance(truth.matrix, patterns))
    stack = np.ascontiguousarray(frames.T).reshape(count, *truth.camera_shape)
    return Capture.from_arrays(patterns, stack, sensor)


@pytest.fixture(scope="module")
def scene() -> Truth:
    return ProceduralScene(CAMERA, (40, 40), seed=4, background=0.02, bounces=4).truth()


def same(one: LightTransport, other: LightTransport) -> bool:
    facts = one.diagnostics.keys() == other.diagnostics.keys()
    return (
        facts
        and (one.sparse != other.sparse).nnz == 0
        and np.array_equal(one.background, other.background)
        and all(
            np.array_equal(values, other.diagnostics[name], equal_nan=True)
            for name, values in one.diagnostics.items()
        )
    )


def test_all_rows_of_small_frames_search_and_large_ones_grow() -> None:
    usual = schedule.schedule((64, 64, 3), 64 * 64, WINDOWS)
    assert [stage.window for stage in usual] == [None, *WINDOWS]
    assert {stage.spacing for stage in usual} == {1}
    assert not any(stage.search_unexplained for stage in usual)
    between = schedule.schedule((128, 128, 3), 128 * 128, WINDOWS)
    assert [stage.window for stage in between] == [None, *WINDOWS]
    assert [stage.spacing for stage in between] == [2] * 3 + [1] * 6
    assert [stage.age for stage in between] == [*range(9)]
    assert [i for i, stage in enumerate(between) if stage.search_unexplained] == [4]
    assert [i for i, stage in enumerate(between) if stage.skip_settled] == [6, 7]
    # Seeds need some rounds after their search, and neighbours.
    for rounds, steps in ((1, (1,)), (3, (1,)), (4, (2, 1))):
        assert schedule.spacings((128, 128), 128 * 128, WINDOWS[:rounds]) == steps
    # A camera of 64 x 64 is too coarse for a projector of 128 x 128.
    for camera in ((29, 600), (9, 9), (64, 64, 3)):
        assert schedule.spacings(camera, 128 * 128, WINDOWS) == (1,)
    assert schedule.spacings((32, 600), 128 * 128, WINDOWS) == (2, 1)
    grown = schedule.schedule((1024, 1024), 768 * 1024, WINDOWS)
    assert [stage.spacing for stage in grown] == [32] * 8 + [8] * 3 + [4] * 3 + [1] * 3
    assert [stage.window is None for stage in grown] == [True] + [False] * 16
    assert [stage.last for stage in grown] == [False] * 16 + [True]
    assert [i for i, stage in enumerate(grown) if stage.search_unexplained] == [9, 12, 14]
    assert [i for i, stage in enumerate(grown) if stage.skip_settled] == [10, 13]
    assert [i for i, stage in enumerate(grown) if stage.skip_every_second] == [15]
    assert [i for i, stage in enumerate(grown) if stage.has_pseudo_samples] == [15, 16]
    # Narrow windows would leave gaps between seeds, and thin cameras have no neighbours.
    assert schedule.spacings((1024, 1024), 768 * 1024, ((1, 1),)) == (1,)
    assert schedule.spacings((10, 100_000), 768 * 1024, WINDOWS) == (1,)
    short = schedule.schedule((1024, 1024), 768 * 1024, ((2, 1),))
    assert [stage.spacing for stage in short] == [32, 8, 4, 1, 1]
    assert schedule.spacings((128, 1000), 768 * 1024, WINDOWS) == (4, 1)
    assert schedule.spacings((3000, 4000), 2160 * 3840, WINDOWS) == (64, 16, 4, 1)
    fine = [
        stage
        for stage in schedule.schedule((3000, 4000), 2160 * 3840, WINDOWS)
        if stage.spacing == 1
    ]
    assert [stage.has_pseudo_samples for stage in fine] == [False, True]
    assert fine[0].search_unexplained
    assert not any(stage.skip_every_second for stage in fine)


@pytest.fixture(scope="module")
def estimates(scene: Truth) -> dict[schedule.Growth, LightTransport]:
    """The scene's estimate as a frame of each size."""
    made = {}
    for growth in (schedule.GROWTH, LARGE_FRAMES, BETWEEN):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(schedule, "GROWTH", growth)
            made[growth] = CoherentEstimator().estimate(photographed(scene))
    return made


def test_grown_rows_are_as_good_and_say_whether_they_searched(
    scene: Truth, estimates: dict[schedule.Growth, LightTransport]
) -> None:
    usual, grown, known = estimates[schedule.GROWTH], estimates[LARGE_FRAMES], scene.transport()
    error = relative_error(usual, known)
    assert relative_error(grown, known) < 1.1 * error
    # Seeds are a 64th of the rows.
    assert 1 / 64 < grown.diagnostics[SEARCHED].mean() < 0.2
    assert grown.summary()["rows_searched_everywhere"] == grown.diagnostics[SEARCHED].mean()
    assert grown.provenance["solver_parameters"]["spacings"] == [8, 4, 1]


def test_frames_between_small_and_large_ones_are_as_good_as_small_ones(
    scene: Truth, estimates: dict[schedule.Growth, LightTransport]
) -> None:
    usual, between, known = estimates[schedule.GROWTH], estimates[BETWEEN], scene.transport()
    assert relative_error(between, known) < 1.02 * relative_error(usual, known)
    # Seeds are a quarter of the rows, and all rows are tested.
    assert 0.25 <= between.diagnostics[SEARCHED].mean() < 0.3
    stated = [each.diagnostics["estimated_error"] for each in (usual, between)]
    assert np.array_equal(np.isfinite(stated[0]), np.isfinite(stated[1]))
    assert np.nanmedian(stated[1]) < 1.1 * np.nanmedian(stated[0])


@pytest.mark.parametrize("growth", [LARGE_FRAMES, BETWEEN])
def test_what_no_seed_sees_is_found(
    scene: Truth, growth: schedule.Growth, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few camera pixels between seeds look at another place than all around them."""
    monkeypatch.setattr(schedule, "GROWTH", growth)
    rows = np.arange(CAMERA[0] * CAMERA[1]).reshape(CAMERA)
    side = 3 if growth is LARGE_FRAMES else 1
    odd = rows[17 : 17 + side, 21 : 21 + side].ravel()
    changed = scene.matrix.tolil()
    places = 40 * np.arange(3, 3 + side)[:, None] + np.arange(33, 33 + side)
    for row, place in zip(odd, places.ravel(), strict=True):
        changed[row] = 0
        changed[row, place] = 0.5
    matrix = csr_array(changed.tocsr())
    truth = Truth(matrix, matrix.data, CAMERA, scene.projector_shape, {})
    estimate = CoherentEstimator().estimate(photographed(truth))
    assert estimate.diagnostics[SEARCHED][odd].any()
    strongest = np.asarray(estimate.sparse[odd].argmax(axis=1)).ravel()
    assert np.array_equal(strongest, places.ravel())


@pytest.mark.parametrize("growth", [LARGE_FRAMES, BETWEEN])
def test_tiles_and_interruptions_do_not_matter(
    scene: Truth,
    growth: schedule.Growth,
    estimates: dict[schedule.Growth, LightTransport],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(schedule, "GROWTH", growth)
    capture = photographed(scene)
    estimator = CoherentEstimator(tile_rows=477)

    def interrupt(done: int, total: int) -> None:
        if done > 0.6 * total:
            raise KeyboardInterrupt

    target = tmp_path / "scene.zarr"
    with pytest.raises(KeyboardInterrupt):
        estimator.estimate(capture, output=target, progress=interrupt)
    reached: list[int] = []
    again = estimator.estimate(
        capture, output=target, progress=lambda done, _: reached.append(done)
    )
    assert min(reached) > 0.4 * len(scene.matrix.indptr)
    assert reached == sorted(reached)
    assert same(again, estimates[growth])


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_grid_has_every_so_manieth_pixel(channels: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    frames = random.integers(0, 255, (6, 11, 10, *channels)).astype(np.uint8)
    mask = random.random((11, 10, *channels)) > 0.2
    capture = Capture.from_arrays(BernoulliPatterns((8, 8), 6), frames, Sensor(), mask=mask)
    grid, whole = CameraGrid(capture, 4), CameraGrid(capture)
    index = np.arange(whole.count).reshape(11, 10, -1)[::4, ::4].ravel()
    assert grid.camera == (3, 3, *(channels or (1,)))
    wanted, estimate = whole.samples(0, whole.count).rows(index), grid.samples(0, grid.count)
    for name in ("values", "clipped"):
        assert np.array_equal(getattr(wanted, name), getattr(estimate, name))
    assert np.array_equal(wanted.weights_of_all(), estimate.weights_of_all())
    entries = csr_array(random.random((grid.count, 5)) * (random.random((grid.count, 5)) > 0.5))
    facts = {"number": np.arange(grid.count)}
    grown = whole.spread(grid, SparseRows(entries, random.random((grid.count, 1)), facts))
    assert (grown.coefficients[index] != entries).nnz == 0
    assert grown.coefficients.nnz == entries.nnz
    assert np.array_equal(grown.diagnostics["number"][index], facts["number"])
    moved = random.random((grid.count, 4)).astype(np.float32)
    finer = whole.refine_jacobian(grid, moved).reshape(*whole.camera, 4)
    assert np.array_equal(finer[5, 9], moved.reshape(*grid.camera, 4)[1, 2] / 4)


@pytest.mark.parametrize("count", [6, 70])
def test_narrow_atoms_are_right_to_a_hundred_thousandth(count: int) -> None:
    patterns = BernoulliPatterns((12, 9), count, seed=3)
    wide, narrow = (AtomPatterns(patterns, (0.0, 0.7, 1.4), narrow=n) for n in (False, True))
    index = np.arange(wide.pixels)
    exact = wide.prepared.columns(index)
    np.testing.assert_allclose(exact, wide.dense().T, atol=1e-6)
    np.testing.assert_allclose(narrow.prepared.columns(index), exact, atol=1e-5)
    e = np.random.default_rng(0).standard_normal((3, count))
    scores, bounds = narrow.prepared.scores(e)
    unit, offset, up, down = bounds.reshape(-1, 4, 1).transpose(1, 0, 2)
    for columns in (exact, narrow.prepared.columns(index)):
        correlations = e @ columns.T.astype(np.float64)
        assert (correlations <= unit * (scores + offset + up) + 1e-6).all()
        assert (correlations >= unit * (scores + offset - down) - 1e-6).all()


def test_a_projector_in_parts_gives_the_same(
    scene: Truth,
    estimates: dict[schedule.Growth, LightTransport],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Atoms on sheets, made for some camera pixels each, find what all atoms find."""
    monkeypatch.setattr(schedule, "GROWTH", LARGE_FRAMES)
    monkeypatch.setattr(row_solver, "KEPT_PIXELS", 0)
    monkeypatch.setattr(row_solver, "_SQUARE", 24)
    parts = CoherentEstimator(tile_rows=400).estimate(photographed(scene))
    whole, known = estimates[LARGE_FRAMES], scene.transport()
    assert relative_error(parts, known) < 1.01 * relative_error(whole, known)
    for name in ("estimated_error", "prediction_error"):
        stated = [np.nanmedian(each.diagnostics[name]) for each in (parts, whole)]
        assert stated[0] == pytest.approx(stated[1], rel=0.02)


def test_rows_search_where_rows_around_them_see_light(
    scene: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All squares tell what the best one does; rows in the dark search all of them."""
    monkeypatch.setattr(row_solver, "KEPT_PIXELS", 0)
    monkeypatch.setattr(row_solver, "_SQUARE", 16)
    capture = photographed(scene)
    solver = CoherentEstimator().row_solver(capture)
    samples = capture.samples(0, capture.rows)
    everywhere = solver.everywhere(samples, solver.sought).rows
    squares = np.broadcast_to(np.eye(9, dtype=bool)[:, None], (9, capture.rows, 9))
    each = [solver.everywhere(samples, solver.sought, squares=square).rows for square in squares]
    best = np.argmin([rows.diagnostics["objective"] for rows in each], axis=0)
    for number in np.unique(best):
        rows = np.flatnonzero(best == number)
        assert (each[number].rows(rows).coefficients != everywhere.rows(rows).coefficients).nnz == 0
    mixed = solver.everywhere(samples, solver.sought, squares=np.arange(9) == best[:, None]).rows
    assert (mixed.coefficients != everywhere.coefficients).nnz == 0

    # Only the upper rows of camera pixels see light: some squares of the projector.
    light = everywhere.coefficients
    light.data[np.repeat(np.arange(capture.rows), np.diff(light.indptr)) >= 4 * 36] = 0
    light.eliminate_zeros()
    near = Neighbourhood(everywhere, CameraGrid(capture).camera, solver.atoms)
    seen = solver.squares_seen(np.array([0, 15 * 36, 30 * 36]), near)
    assert seen is not None
    row, col = np.divmod(light.indices % solver.atoms.single.pixels, 40)
    lit = np.bincount(row // 16 * 3 + col // 16, minlength=9) > 0
    assert not lit.all()
    assert (seen.any(axis=0) >= lit).all()
    assert [each.all() for each in seen] == [False, False, True]


@pytest.mark.parametrize("lit", [0, 8])
def test_parts_that_see_no_light_are_solved(
    scene: Truth, monkeypatch: pytest.MonkeyPatch, lit: int
) -> None:
    """Camera pixels of which no neighbour holds light have no atoms on a sheet."""
    monkeypatch.setattr(schedule, "GROWTH", LARGE_FRAMES)
    monkeypatch.setattr(row_solver, "KEPT_PIXELS", 0)
    capture = photographed(scene, 16)
    dark = np.stack([capture.frame(k) for k in range(16)])
    dark[:, lit:] = 0
    capture = Capture.from_arrays(capture.patterns, dark, Sensor(0.8, 0.0, 0.003, 0.0, 8))
    found = CoherentEstimator(tile_rows=400, judged=False).estimate(capture)
    assert (found.sparse.nnz > 0) == (lit > 0)
