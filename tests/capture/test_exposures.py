"""Several exposures in one capture: shares, order, samples, and what it is worth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.harness import benchmark_exposure
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import (
    exposure_sequence,
    lit_samples,
    parse_exposures,
    share_of_white,
)
from lightmatrix.capture.sensor import Sensor
from lightmatrix.check.refusals import refuse_unordered
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.judgement.metrics import relative_error, unclipped_rows
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.mix import MixedPatterns, default_mix, interleave
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.library import truth
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers import ActiveSet


@given(st.lists(st.floats(0.01, 1), min_size=1, max_size=5), st.integers(0, 200))
@settings(max_examples=60, deadline=None)
def test_every_prefix_has_about_the_shares(shares: list[float], count: int) -> None:
    kinds = interleave(shares, count)
    given_ = np.bincount(kinds, minlength=len(shares))
    assert given_.sum() == count
    # Webster's rule, from its definition: no kind would rather have another one's last frame.
    claim = np.array(shares) / (2 * given_ + 1)
    quotients = [s / (2 * n - 1) if n else np.inf for s, n in zip(shares, given_, strict=True)]
    assert claim.max() <= min(quotients) * (1 + 1e-9)
    np.testing.assert_array_equal(interleave(shares, count + 7)[:count], kinds)


def test_every_exposure_sees_every_kind_of_pattern() -> None:
    patterns = MixedPatterns((64, 64), 128, default_mix((64, 64), 128))
    for text in ("1:0.75,0.25:0.25", "1:0.25,0.5:0.25,0.25:0.25,0.125:0.25", "2:0.5,1:0.5"):
        wanted = parse_exposures(text)
        exposures = np.asarray(exposure_sequence(wanted, patterns))
        for value, share in wanted:
            for kind in range(3):
                frequency = (exposures[patterns.kinds == kind] == value).mean()
                assert frequency == pytest.approx(share, abs=1e-9)
    assert exposure_sequence([(0.7, 1.0)], patterns) == 0.7
    some = np.asarray(
        exposure_sequence(parse_exposures("1:0.75,0.25:0.25"), BernoulliPatterns((4, 4), 8))
    )
    assert some.tolist() == [1, 1, 0.25, 1, 1, 1, 0.25, 1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "an exposure of ''"),
        ("fast", "'fast'"),
        ("-1", "'-1'"),
        ("nan:1", "'nan'"),
        ("1:0.75,0.25:0.3", "sum to 1.05"),
        ("1:1.5,0.25:-0.5", "positive shares"),
        ("1,0.25", "for example"),
    ],
)
def test_malformed_exposures_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_exposures(text)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated capture with black frame, pedestal, two exposures and a mix."""
    folder = tmp_path_factory.mktemp("mixed")
    ProceduralScene((8, 9), (8, 8), background=0).truth().save(folder / "T.npz")
    patterns = f"patterns mix --mix fine:0.75,2x2:0.25 -k 48 --size 8x8 -o {folder}/patterns"
    simulate = (
        f"simulate {folder}/T.npz --patterns {folder}/patterns --exposure 4:0.75,1:0.25 "
        f"--leak 0.01 --ambient 0.02 --black-level 6 --bits 12 --noise 0.0005 -o {folder}/capture"
    )
    for line in (patterns, simulate):
        assert main(line.split()) == 0
    return folder


def test_samples_of_all_exposures_are_in_one_unit(mixed: Path) -> None:
    capture = Capture.open(mixed / "capture")
    light = irradiance(Truth.load(mixed / "T.npz").matrix, capture.patterns)
    samples = capture.samples()
    expected = 0.99 * light
    level = np.broadcast_to(samples.clip_level, light.shape)
    assert sorted(set(capture.exposures)) == [1.0, 4.0]
    # Room light and leak take a little of each frame's range, the same share of it.
    np.testing.assert_allclose(level, np.broadcast_to(1 / capture.exposures, light.shape), rtol=0.1)
    free = ~samples.clipped
    tolerance = (6 * 0.0005 + 2 / 4089) / capture.exposures
    assert (np.abs(samples.values - expected) < tolerance)[free].all()
    assert (expected >= samples.values - tolerance)[samples.clipped].all()
    short = capture.exposures < 2
    assert samples.clipped[:, ~short].mean() > 2 * samples.clipped[:, short].mean() > 0


@pytest.mark.usefixtures("unchecked")
def test_estimates_from_disk_use_every_exposure(
    mixed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole way by commands; the short frames alone know the brightest entries."""
    errors = {}
    for name in ("capture", "long"):
        source = mixed / name
        if name == "long":
            line = f"simulate {mixed}/T.npz --patterns {mixed}/patterns --exposure 4 --bits 12"
            assert main([*line.split(), "--noise", "0.0005", "-o", str(source)]) == 0
        store = mixed / f"{name}.zarr"
        assert (
            main(
                [
                    "estimate",
                    str(source),
                    "-o",
                    str(store),
                    "--regularization",
                    "0.02",
                    "--no-check",
                ]
            )
            == 0
        )
        capsys.readouterr()
        assert main(["evaluate", str(store), "--truth", str(mixed / "T.npz"), "--json"]) == 0
        errors[name] = json.loads(capsys.readouterr().out)["relative_error"]
    assert errors["capture"] < 0.5 * errors["long"]


def test_exposures_and_black_frame_are_written_down(mixed: Path) -> None:
    content = json.loads((mixed / "capture" / "capture.json").read_text())
    assert len(content["exposure"]) == 48
    assert content["black"]["exposure"] == 4


def _capture(patterns: PatternSet, known: Truth, exposure: object) -> Capture:
    sensor = Sensor(exposure, read_noise=0.003)  # type: ignore[arg-type]
    frames = sensor.expose(irradiance(known.matrix, patterns), seed=1)
    stack = np.ascontiguousarray(frames.T).reshape(patterns.count, *known.camera_shape)
    return Capture.from_arrays(patterns, stack, sensor)


def test_frames_of_several_exposures_are_in_order() -> None:
    known = truth("metal")
    e = benchmark_exposure(known.transport())
    patterns = MixedPatterns((64, 64), 64, default_mix((64, 64), 64), seed=1)
    wanted = [(e, 0.5), (e / 4, 0.25), (e / 8, 0.25)]
    capture = _capture(patterns, known, exposure_sequence(wanted, patterns))
    capture = capture.crop((16, 16), (32, 32))
    refuse_unordered(capture)
    swapped = [0, 9, *range(2, 9), 1, *range(10, 64)]
    with pytest.raises(InputError, match="order"):
        refuse_unordered(replace(capture, frames=capture.frames.select(swapped)))


@pytest.mark.parametrize("scene", [pytest.param("l_objects", marks=pytest.mark.slow), "metal"])
def test_a_quarter_of_short_frames_lowers_the_error(scene: str) -> None:
    """64 frames of 64 x 64 pixels: over all rows, and over those that do not clip singly too."""
    known = truth(scene)
    e = benchmark_exposure(known.transport())
    patterns = BernoulliPatterns((64, 64), 64)
    rows = np.arange(0, 4096, 4)
    part = Truth(known.matrix[rows], known.direct_data[:0], (len(rows), 1), (64, 64)).transport()
    plain = np.flatnonzero(unclipped_rows(part, e))
    errors = []
    for exposures in ([(e, 1.0)], [(e, 0.75), (e / 4, 0.25)]):
        some = replace(known, matrix=known.matrix[rows], camera_shape=(len(rows), 1))
        capture = _capture(patterns, some, exposure_sequence(exposures, patterns))
        estimate = PlainEstimator(ActiveSet(tolerance=1e-3)).estimate(capture)
        errors.append([relative_error(estimate, part), relative_error(estimate, part, plain)])
    one, two = np.array(errors)
    assert two[0] < 0.75 * one[0]
    assert two[1] < one[1]


def test_dark_and_clipped_samples_are_not_lit() -> None:
    black = np.full(200, 10.0)
    white = np.full(200, 110.0)
    white[0] = 255.0  # clips
    white[1] = 246.0  # is just below 98 % of 255, 249.9
    white[2] = 19.0  # has 9 % of the light
    white[3] = 35.0
    lit = lit_samples(white, black, 255.0)
    assert np.flatnonzero(~lit).tolist() == [0, 2]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 1.2])
def test_the_share_is_that_of_the_lit_samples(share: float) -> None:
    generator = np.random.default_rng(0)
    black = generator.uniform(5, 20, 50)
    white = black + generator.uniform(50, 200, 50)
    lit = np.arange(50) < 30
    frame = black + share * (white - black)
    frame[~lit] = 0
    assert share_of_white(frame, white, black, lit) == pytest.approx(share)
