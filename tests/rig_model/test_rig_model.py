"""What a rig did wrong is found in its photographs, named, and taken out of T."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import shift

import lightmatrix as lm
from lightmatrix.capture.capture import capture_of_samples
from lightmatrix.capture.correction import Correction
from lightmatrix.capture.samples import Samples
from lightmatrix.rig_model.choice import Regression
from lightmatrix.rig_model.model import RigModel, _between
from lightmatrix.rig_model.prediction import INNER, MARGIN, Prediction, displaced, slopes
from lightmatrix.rig_model.terms import TERMS
from lightmatrix.simulation.simulate import SimulatedCapture

PATTERNS = lm.BernoulliPatterns((64, 64), 32)


def photographed(**faults: float) -> SimulatedCapture:
    """The middle of a scene, 64 x 24 camera pixels, photographed by a rig with faults."""
    known = {name.replace("_", "-"): amount for name, amount in faults.items()}
    # A black frame is taken in a room of some light.
    room = 0.1 if "black" in known else 0.0
    whole = lm.simulate("l_objects", PATTERNS, exposure=0.4, ambient=room, faults=known)
    return whole.crop((0, 24), (64, 24))


def error(transport: lm.LightTransport, capture: SimulatedCapture) -> float:
    return lm.evaluate(transport, capture.truth).relative_error


@pytest.fixture(scope="module")
def intact() -> tuple[SimulatedCapture, lm.LightTransport]:
    capture = photographed()
    return capture, lm.estimate(capture, check=False, progress=False)


def test_an_intact_capture_gets_no_name(intact: tuple[SimulatedCapture, lm.LightTransport]) -> None:
    capture, transport = intact
    assert lm.fit_rig(capture, transport).names == ()
    assert "rig" not in transport.provenance


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
@pytest.mark.parametrize(
    ("fault", "amount", "name", "times"),
    [
        ("ambient", 0.05, "ambient", 1.25),
        ("previous", 0.1, "previous", 1.25),
        ("rows", 0.1, "rows", 1.5),
        ("shake", 0.1, "shift", 2.0),
        ("torn", 0.2, "previous", 1.25),
        ("black", 1.0, "black", 1.25),
        pytest.param("camera_curve", 1.1, "camera-curve", 1.25, marks=pytest.mark.slow),
        pytest.param("crosstalk", 0.1, "crosstalk", 1.25, marks=pytest.mark.slow),
        # The camera's brightness was that of the whole picture, of which this is a part.
        pytest.param("tone_mapping", 0.2, "tone-mapping", 3.0, marks=pytest.mark.slow),
    ],
)
def test_a_fault_is_named_and_taken_out(
    intact: tuple[SimulatedCapture, lm.LightTransport],
    fault: str,
    amount: float,
    name: str,
    times: float,
) -> None:
    capture = photographed(**{fault: amount})
    transport = lm.estimate(capture, check=False, progress=False)
    assert RigModel.of(transport).names == (name,)
    assert error(transport, capture) < times * error(intact[1], intact[0])


@pytest.mark.parametrize(("torn", "least", "most"), [(0.0, 0.0, 0.0), (0.1, 0.08, 0.13)])
def test_late_rows_are_found_in_sixteen_photographs(torn: float, least: float, most: float) -> None:
    """Pixels then follow some projector pixel in the wrong order too, at a correlation of 0.8."""
    patterns = lm.BernoulliPatterns((64, 64), 16)
    capture = lm.simulate("metal", patterns, exposure=0.3, faults={"torn": torn} if torn else {})
    plain = lm.estimate(capture, check=False, progress=False, correct="none")
    found = TERMS["torn"]().found(Prediction.of(capture, capture, plain))
    late = 0.0 if found is None else float((found != 0).mean())
    assert least <= late <= most


def test_the_numbers_are_those_of_the_fault() -> None:
    model = lm.fit_rig(photographed(previous=0.1))
    assert model.names == ("previous",)
    assert model.values["previous"][0] == pytest.approx(0.1, abs=0.008)
    assert model.sentences[0].endswith("% of the picture before it")


def test_the_store_keeps_what_was_corrected(tmp_path: Path) -> None:
    capture = photographed(exposure=0.2)
    with pytest.warns(lm.LightMatrixWarning, match="exposure changed by .* before frame 16"):
        transport = lm.estimate(capture, check=False, output=tmp_path / "t.zarr")
    stored = lm.open(tmp_path / "t.zarr")
    assert RigModel.of(stored).names == ("exposure",)
    assert (stored.sparse != transport.sparse).nnz == 0
    # The exposure of T is that of the first frame.
    assert error(stored, capture) < 0.03


@pytest.mark.parametrize("frame", [0, 7])
def test_a_frame_of_other_light_is_named_and_sets_no_exposure(frame: int) -> None:
    capture = photographed()
    frames = np.stack([capture.frame(k) for k in range(capture.count)])
    frames[frame] //= 2
    changed = lm.Capture.from_arrays(capture.patterns, frames, capture.sensor)
    words = f"not that of the other frames in frame {frame} \\(-(49|50|51) %\\)"
    with pytest.warns(lm.LightMatrixWarning, match=words):
        transport = lm.estimate(changed, check=False)
    assert error(transport, capture) < 0.04


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_only_what_is_allowed_is_corrected() -> None:
    capture = photographed(previous=0.1).crop((20, 0), (24, 24))
    plain = lm.estimate(capture, check=False, progress=False, correct="none")
    other = lm.estimate(capture, check=False, progress=False, correct=["shift"])
    assert "previous" not in RigModel.of(other).names
    assert not RigModel.of(plain).names
    with pytest.raises(lm.InputError, match="no correction is called shiver"):
        lm.estimate(capture, correct="shiver")


def test_the_normal_equations_are_those_of_least_squares(
    intact: tuple[SimulatedCapture, lm.LightTransport],
) -> None:
    capture, transport = intact
    seen = Prediction.of(capture, capture, transport)
    terms = [TERMS[name]() for name in ("gain", "ambient", "previous", "crosstalk")]
    regressors = {term.name: term.regressors(seen) for term in terms}
    per_frame = {term.name: term.per_frame for term in terms}
    weight = np.random.default_rng(0).uniform(0.5, 2, len(seen.left))
    regression = Regression(seen, regressors, per_frame, weight)  # type: ignore[arg-type]
    found, _, explained = regression.solve(["gain", "previous", "crosstalk"])
    columns = [
        seen.projected(np.where(np.arange(32) == k, each, 0))
        for each in regressors["gain"]  # type: ignore[union-attr]
        for k in range(32)
    ]
    for name in ("previous", "crosstalk"):
        columns += [seen.projected(each) for each in regressors[name]]  # type: ignore[union-attr]
    root = np.sqrt(weight)[:, None]
    matrix = np.stack([(root * each).ravel() for each in columns], axis=1)
    side = (root * seen.left).ravel()
    # The penalty on the mean gain, which T holds.
    numbers = np.concatenate([each.ravel() for each in found.values()])
    slope = matrix.T @ (side - matrix @ numbers)
    assert np.ptp(slope[:32]) < 1e-6 * np.linalg.norm(matrix.T @ side)
    assert np.abs(slope[32:]).max() < 1e-6 * np.linalg.norm(matrix.T @ side)
    best = np.linalg.norm(side) ** 2 - np.linalg.norm(side - matrix @ numbers) ** 2
    assert explained == pytest.approx(best, rel=1e-3)


# Those that are found without a regressor, and one that changes no pixel by itself.
_OTHERS = ("dynamic-contrast", "torn", "black", "camera-blur")


@pytest.mark.parametrize("name", [name for name in TERMS if name not in _OTHERS])
def test_what_a_term_takes_out_is_its_regressor(
    intact: tuple[SimulatedCapture, lm.LightTransport], name: str
) -> None:
    """Photographs of T under a small fault are those of T once it is taken out."""
    transport = intact[1]
    patterns: lm.PatternSet = PATTERNS
    if name in ("projector-curve", "sharpening"):
        greys = np.random.default_rng(1).random((32, 64, 64)).astype(np.float32)
        patterns = lm.ImagePatterns(greys)
    still = transport.relight(patterns.images()).reshape(32, -1).T

    def of(values: np.ndarray) -> lm.Capture:
        level = np.full(32, 10, np.float32)
        samples = Samples(values.astype(np.float32), np.zeros(values.shape, bool), level)
        return capture_of_samples(patterns, samples, (64, 24), 1.0)

    seen = Prediction.of(of(still), of(still), transport)
    term = TERMS[name]()
    regressors = term.regressors(seen)
    assert regressors is not None
    generator = np.random.default_rng(2)
    shape = (len(regressors), 32) if term.per_frame else (len(regressors),)
    # Sharpening is not linear: the regressor is the change by half its strength.
    numbers = 0.01 * generator.uniform(0.5, 1, shape)
    if name in ("sharpening", "camera-sharpening"):
        numbers = np.array([0.5, 0, 0])
    along = "pmk,pk->mk" if term.per_frame else "pmk,p->mk"
    change = np.einsum(along, regressors, numbers)
    wrong = still.astype(np.float64)
    wrong[seen.rows] += change
    capture = replace(of(still), known=of(wrong).known)
    right = RigModel({name: numbers}).corrected(capture, transport)
    shown = transport.relight(right.patterns.images()).reshape(32, -1).T
    samples = right.samples().values
    left = (samples - shown)[seen.rows]
    # A curve is told by the decoder, which these samples do not pass.
    if name == "camera-curve":
        assert right.decoder.response.name == f"gamma:{1 + numbers[0]:.4f}"
    else:
        assert np.linalg.norm(left) < 0.1 * np.linalg.norm(change)


def test_corrections_of_parts_are_parts_of_the_correction() -> None:
    generator = np.random.default_rng(0)
    shape = (6, 5)
    samples = Samples(
        generator.random((30, 8)).astype(np.float32),
        np.zeros((30, 8), bool),
        np.ones(8, np.float32),
    )
    whole = Correction(
        generator.uniform(0.9, 1.1, 8),
        generator.uniform(0, 0.1, 8),
        generator.uniform(0.9, 1.1, (6, 8)),
        generator.normal(0, 0.01, (30, 8)),
    )
    right = whole.applied(samples, 0, shape).values
    frames = np.array([5, 1, 3])
    few = whole.select(frames).applied(samples.frames(frames), 0, shape).values
    assert np.array_equal(few, right[:, frames])
    rows, cols = slice(2, 5), slice(1, 4)
    index = np.arange(30).reshape(shape)[rows, cols].ravel()
    part = whole.window(rows, cols, shape).applied(samples.rows(index), 0, (3, 3)).values
    assert np.array_equal(part, right[index])
    assert np.array_equal(whole.applied(samples.rows(slice(7, 20)), 7, shape).values, right[7:20])


def test_a_part_of_a_corrected_capture_is_corrected_alike() -> None:
    generator = np.random.default_rng(0)
    frames = generator.integers(1, 200, (8, 6, 5)).astype(np.uint8)
    capture = lm.Capture.from_arrays(lm.BernoulliPatterns((4, 4), 8), frames, lm.Sensor())
    added = generator.normal(0, 0.01, (30, 8)).astype(np.float32)
    profile = generator.uniform(0.9, 1.1, (6, 8))
    whole = replace(capture, correction=Correction(np.ones(8), np.zeros(8), profile, added))
    index = np.arange(30).reshape(6, 5)[2:5, 1:4].ravel()
    wanted = whole.samples().values[index]
    assert np.array_equal(whole.crop((2, 1), (3, 3)).samples().values, wanted)
    assert np.array_equal(whole.window(slice(2, 5), slice(1, 4)).samples().values, wanted)


def test_slopes_of_a_plane_are_exact_away_from_its_border() -> None:
    rows, cols = np.meshgrid(np.arange(32.0), np.arange(34.0), indexing="ij")
    plane = (3 * rows - 2 * cols)[None, :, :, None, None]
    first, second = slopes(plane)
    assert first.shape == (2, 1, 32 - 2 * MARGIN, 34 - 2 * MARGIN, 1, 1)
    assert np.allclose(first, np.array([3, -2])[:, None, None, None, None, None], atol=2e-3)
    assert np.allclose(second, 0, atol=2e-3)


def test_detail_between_pixels_is_told_by_the_four_neighbours() -> None:
    generator = np.random.default_rng(0)
    light = generator.random((1, 6 + 2 * MARGIN, 5 + 2 * MARGIN, 1, 32)).astype(np.float32)
    moves = generator.normal(0, 0.1, (2, 32))
    here, below = light[INNER], np.roll(light, -1, 1)[INNER]
    missed = (0.3 * moves[0] * (below - here)).astype(np.float32)
    exact = generator.random(missed.shape) < 0.9
    noise = generator.normal(0, 0.1 * missed.std(), missed.shape).astype(np.float32)
    told = _between(light, (missed + noise) * exact, exact, moves) * exact
    assert np.linalg.norm(told - missed * exact) < 0.1 * np.linalg.norm(missed)
    # Noise alone is hardly believed.
    told = _between(light, noise * exact, exact, moves)
    assert np.linalg.norm(told) < 0.25 * np.linalg.norm(noise)


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_pictures_are_moved_as_scipy_moves_them(down: float, right: float) -> None:
    image = np.random.default_rng(0).random((40, 30))
    here = displaced(image[None, :, :, None, None], np.array([[down], [right]]))[0, :, :, 0, 0]
    there = shift(image, (down, right), order=3, mode="nearest")[MARGIN:-MARGIN, MARGIN:-MARGIN]
    assert np.abs(here - there).max() < 2e-3


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_the_report_says_what_was_corrected(tmp_path: Path) -> None:
    capture = photographed(gain=0.05)
    transport = lm.estimate(capture, check=False, progress=False)
    lm.report(tmp_path / "report", transport, capture, held_out=False)
    page = (tmp_path / "report" / "report.html").read_text()
    assert "The light varied by" in page
    assert "Light per frame, relative to the first" in page


@pytest.mark.parametrize(("ambient", "leak"), [(0.02, 0.0), (0.0, 0.002)])
def test_a_noisy_black_frame_is_not_accused(ambient: float, leak: float) -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    capture = lm.simulate(
        "metal", patterns, exposure=0.15, noise=0.01, black_level=0.05, ambient=ambient, leak=leak
    )
    assert lm.fit_rig(capture.crop((0, 0), (40, 40))).names == ()
