"""Compensation: optimal by its definition, within [0, 1], honest about what cannot be reached."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.optimize import lsq_linear
from scipy.sparse import csr_array, kron

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.files.images import fitted
from lightmatrix.simulation.truth import Truth, binned
from lightmatrix.uses.compensation import BoundedFit, JointLight, Reach, compensator, joint_light


def _scene(
    camera: tuple[int, ...] = (6, 7), projector: tuple[int, int] = (5, 8), seed: int = 0
) -> lm.LightTransport:
    """A random scene: sharp direct light, some more anywhere, and a smooth background."""
    random = np.random.default_rng(seed)
    samples, pixels = int(np.prod(camera)), int(np.prod(projector))
    dense = random.random((samples, pixels)) * (random.random((samples, pixels)) < 0.1) * 0.05
    dense[np.arange(samples), random.integers(0, pixels, samples)] += 0.3 + random.random(samples)
    background = random.random((samples, 4)).astype(np.float32) * 0.1
    return lm.LightTransport(
        csr_array(dense.astype(np.float32)), background, camera, projector, (2, 2)
    )


def _dense(transport: lm.LightTransport) -> Any:
    return transport.to_matrix(dense_background=True).toarray().astype(np.float64)


@pytest.fixture(scope="module")
def known() -> lm.LightTransport:
    return binned(lm.truth("l_objects"), 2).transport()


def _ramp(shape: tuple[int, int] = (32, 32)) -> Any:
    return np.tile(np.linspace(0.2, 1, shape[1]), (shape[0], 1))


@pytest.mark.parametrize("projectors", [1, 2, 3])
@pytest.mark.parametrize("camera", [(6, 7), (1, 1), (4, 3, 3)])
def test_the_operator_has_its_adjoint(camera: tuple[int, ...], projectors: int) -> None:
    sizes = [(5, 8), (3, 2), (4, 4)][:projectors]
    light = joint_light([_scene(camera, size, seed) for seed, size in enumerate(sizes)])
    random = np.random.default_rng(0)
    p = random.random(sum(rows * cols for rows, cols in sizes), np.float32)
    c = random.random(int(np.prod(camera)), np.float32)
    assert light.forward(p) @ c == pytest.approx(p @ light.adjoint(c), rel=1e-5)
    dense = np.hstack([_dense(matrix) for matrix in light.matrices])
    np.testing.assert_allclose(light.forward(p), dense @ p, rtol=1e-5)
    assert [part.shape for part in light.split(p)] == sizes


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 1000), level=st.floats(0.1, 2))
def test_it_is_the_bounded_least_squares_solution(seed: int, level: float) -> None:
    """Held against SciPy's active-set solver on the dense matrix with the ridge as more rows."""
    transport = _scene(seed=seed)
    random = np.random.default_rng(seed)
    weights = (random.random(42) < 0.8).astype(np.float32)
    samples = (level * random.random(42)).astype(np.float32)
    fit = BoundedFit(JointLight((transport,)), weights)
    pattern = fit.solve(samples, np.full(40, 0.5, np.float32), 3000)
    root = np.sqrt(weights.astype(np.float64))[:, None]
    rows = np.vstack([root * _dense(transport), np.sqrt(fit.ridge) * np.eye(40)])
    right = np.concatenate([root[:, 0] * samples, np.zeros(40)])
    best = lsq_linear(rows, right, (0, 1), method="bvls", tol=1e-12)

    def cost(p: Any) -> float:
        return 0.5 * float(np.sum((rows @ p - right) ** 2))

    assert pattern.min() >= 0
    assert pattern.max() <= 1
    assert cost(pattern.astype(np.float64)) <= best.cost + 1e-5 * max(best.cost, 1e-3)


def test_negative_entries_keep_the_steps_safe() -> None:
    transport = _scene()
    signs = np.where(np.random.default_rng(1).random(transport.sparse.nnz) < 0.3, -1, 1)
    sparse = csr_array(
        (transport.sparse.data * signs, transport.sparse.indices, transport.sparse.indptr),
        shape=transport.shape,
    )
    signed = lm.LightTransport(
        sparse.astype(np.float32), transport.background, (6, 7), (5, 8), (2, 2)
    )
    fit = BoundedFit(JointLight((signed,)), np.ones(42, np.float32))
    samples = np.full(42, 0.3, np.float32)
    few, many = (fit.solve(samples, np.full(40, 0.5, np.float32), n) for n in (1000, 3000))
    np.testing.assert_allclose(few, many, atol=1e-3)
    # Optimal: a step along the gradient leads nowhere within the bounds.
    moved = np.clip(many - fit.gradient(many, samples), 0, 1)
    np.testing.assert_allclose(moved, many, atol=1e-3)


def test_it_is_better_than_gains_of_single_pixels(known: lm.LightTransport) -> None:
    shared = compensator(known)
    found = lm.compensate(known, _ramp())
    gains = known.relight(shared.start(found.target.ravel()).reshape(32, 32))
    lit = shared.lit.reshape(32, 32)

    def squares(image: Any) -> float:
        return float(np.mean((image - found.target)[lit] ** 2))

    np.testing.assert_allclose(known.relight(found.pattern), found.predicted, rtol=1e-4, atol=1e-6)
    assert squares(found.predicted) < 0.6 * squares(gains)
    near = found.reachable
    missed = [np.mean((image - found.target)[near] ** 2) for image in (found.predicted, gains)]
    assert missed[0] < 0.25 * missed[1]
    assert found.psnr == pytest.approx(-10 * np.log10(squares(found.predicted) / found.scale**2))


def test_rows_that_state_large_errors_do_not_spoil_their_neighbours() -> None:
    known = lm.truth("l_objects").transport()
    random = np.random.default_rng(0)
    wrong = random.random(4096) < 0.1
    gains = np.where(wrong, random.uniform(0.3, 3, 4096), 1).astype(np.float32)
    sparse = csr_array(known.sparse.multiply(gains[:, None]), dtype=np.float32)
    fits = lm.compensate(known, _ramp((64, 64))).reachable.ravel() & ~wrong
    missed = {}
    for name, stated in (("none", 0.0), ("wrong ones", np.where(wrong, 1.0, 0.0))):
        errors = np.broadcast_to(np.asarray(stated, np.float32), 4096)
        found = lm.compensate(
            replace(known, sparse=sparse, diagnostics={"estimated_error": errors}), _ramp((64, 64))
        )
        away = (known.relight(found.pattern) - found.target).ravel()[fits]
        missed[name] = float(np.mean(away**2)) / found.scale**2
    assert missed["wrong ones"] < 0.3 * missed["none"]


def test_errors_of_several_projectors_add_up_as_independent_ones() -> None:
    first, second = _scene(), _scene(projector=(3, 4), seed=1)
    errors = np.linspace(0, 1, 42).astype(np.float32)
    errors[3] = np.nan
    light = joint_light([replace(first, diagnostics={"estimated_error": errors}), second])
    shares = [_dense(matrix).sum(axis=1) for matrix in (first, second)]
    expected = np.nan_to_num(errors) * shares[0] / (shares[0] + shares[1])
    np.testing.assert_allclose(light.errors, expected, rtol=1e-5)
    both = joint_light([replace(first, diagnostics={"estimated_error": errors})] * 2)
    np.testing.assert_allclose(both.errors, np.nan_to_num(errors) / np.sqrt(2), rtol=1e-5)
    # Samples count half at 0.07.
    even = replace(first, diagnostics={"estimated_error": np.full(42, 0.07, np.float32)})
    for weights in (compensator(even).fit.weights, compensator(second).fit.weights / 2):
        np.testing.assert_allclose(weights[weights > 0], 0.5, rtol=1e-5)


def test_the_map_says_what_is_not_reached() -> None:
    """Four camera pixels: one in shadow, one masked, one that wants too much, one that is right."""
    matrix = csr_array(np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]).astype(np.float32))
    transport = lm.LightTransport.from_matrix(matrix, (2, 3), (2, 3))
    wanted = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 0.2]])
    ambient = np.array([[0, 0, 0], [0, 0, 0.9]])
    mask = np.array([[1, 0, 1], [1, 1, 1]])
    found = lm.compensate(transport, wanted, mask=mask, ambient=ambient, brightness=1.5)
    reach = Reach
    expected = [
        [reach.SHADOW, reach.MASKED, reach.TOO_DARK],
        [reach.REACHED, reach.REACHED, reach.TOO_BRIGHT],
    ]
    np.testing.assert_array_equal(found.reach, expected)
    np.testing.assert_array_equal(found.reachable, np.array(expected) == reach.REACHED)
    np.testing.assert_allclose(found.predicted[1], [0.75, 0.75, 0.9], atol=0.01)
    assert found.scale == pytest.approx(1.5)
    # White gives 1, which clips.
    assert found.clipped[0, 2]
    shares = found.as_dict()
    assert sum(shares[each.name.lower()] for each in reach) == pytest.approx(1)
    assert shares["too_dark"] == pytest.approx(1 / 6)


def test_automatic_brightness_lets_one_in_50_ask_for_more_than_white(
    known: lm.LightTransport,
) -> None:
    found = lm.compensate(known, _ramp())
    white = known.relight(np.ones((32, 32)))
    lit = compensator(known).lit.reshape(32, 32)
    assert (found.target > white)[lit].mean() == pytest.approx(0.02, abs=0.002)
    given = lm.compensate(known, _ramp(), brightness=found.brightness)
    np.testing.assert_allclose(given.pattern, found.pattern, atol=1e-6)
    bright, dim = (lm.compensate(known, _ramp(), brightness=b) for b in (1.0, 0.3))
    assert bright.scale == pytest.approx(dim.scale / 0.3)
    assert dim.psnr > bright.psnr


def test_ambient_light_is_taken_off(known: lm.LightTransport) -> None:
    room = np.full((32, 32), 0.05 * known.relight(np.ones((32, 32))).mean(), np.float32)
    without = lm.compensate(known, _ramp(), brightness=0.5)
    with_room = lm.compensate(known, _ramp(), brightness=0.5, ambient=room)
    assert with_room.pattern.mean() < without.pattern.mean()
    light = known.relight(with_room.pattern) + room
    np.testing.assert_allclose(light, with_room.predicted, rtol=1e-4, atol=1e-6)
    assert with_room.psnr > without.psnr - 1


def test_colour_is_compensated_jointly() -> None:
    """Overlapping filters: each primary reaches all channels of the camera."""
    truth, size = binned(lm.truth("l_objects"), 2), (32, 32)
    filters = np.array([[0.9, 0.2, 0.05], [0.15, 0.8, 0.2], [0.05, 0.25, 0.9]], np.float32)
    matrices = [
        lm.LightTransport.from_matrix(
            csr_array(kron(truth.matrix, filters[:, [primary]])), (*size, 3), size
        )
        for primary in range(3)
    ]
    wanted = np.stack([_ramp(), _ramp()[:, ::-1], np.full(size, 0.5)], axis=-1)
    joint = lm.compensate(matrices, wanted, brightness=0.5)
    assert joint.pattern.shape == (*size, 3)
    np.testing.assert_allclose(
        lm.relight(matrices, joint.pattern), joint.predicted, rtol=1e-3, atol=1e-5
    )
    # Each primary by itself, as if it reached its own channel only.
    alone = np.stack(
        [
            lm.compensate(
                matrices[c], wanted, brightness=0.5, mask=np.tile(np.arange(3) == c, (*size, 1))
            ).pattern
            for c in range(3)
        ],
        axis=-1,
    )
    missed = (lm.relight(matrices, alone) - joint.target) / joint.scale
    assert joint.psnr > -10 * np.log10(np.mean(missed**2)) + 2
    # Grey is the colour of the scene under white light.
    plain = lm.compensate(matrices, np.full(size, 0.5), brightness=0.5)
    ratios = np.median(plain.target, axis=(0, 1)) / np.median(
        lm.relight(matrices, np.ones(size)), axis=(0, 1)
    )
    np.testing.assert_allclose(ratios, ratios[0], rtol=0.05)


def test_the_folder_of_a_colour_projector_stands_for_its_primaries(
    known: lm.LightTransport, tmp_path: Path
) -> None:
    parts = [replace(known, sparse=known.sparse * np.float32(gain)) for gain in (0.5, 0.3, 0.2)]
    lm.save_colour(tmp_path / "scene", lm.ColourTransport(*parts))
    found = lm.compensate(tmp_path / "scene", _ramp(), output=tmp_path / "shown.png")
    assert lm.read_image(tmp_path / "shown.png").shape == (32, 32, 3)
    # Three projectors whose patterns have one shape are not the primaries of one.
    three = lm.compensate(parts, _ramp(), output=tmp_path / "three.png")
    np.testing.assert_array_equal(found.pattern, three.pattern)
    for number, pattern in enumerate(three.encoded, start=1):
        shown = lm.read_image(tmp_path / f"three-{number}.png")
        np.testing.assert_array_equal(shown, np.rint(255 * pattern))
    of_primaries = [
        replace(part, provenance={**part.provenance, "primary": name})
        for part, name in zip(parts, ("red", "green", "blue"), strict=True)
    ]
    lm.compensate(of_primaries, _ramp(), output=tmp_path / "one.png")
    assert lm.read_image(tmp_path / "one.png").shape == (32, 32, 3)
    uses: tuple[Callable[[], Any], ...] = (
        lambda: lm.cancel_global(tmp_path / "scene"),
        lambda: lm.compensate_video(tmp_path / "scene", [_ramp()]),
    )
    for use in uses:
        with pytest.raises(lm.InputError, match="3 matrices, for a use that takes one"):
            use()


def test_two_projectors_blend_into_each_other(tmp_path: Path) -> None:
    """Two projectors of different sizes, each on two thirds of a wall."""
    wall = np.zeros((12, 12, 4, 8), np.float32)
    other = np.zeros((12, 12, 3, 8), np.float32)
    for col in range(8):
        wall[:, col, :, col] = 0.5 / 4
        other[:, col + 4, :, col] = 0.4 / 3
    first = lm.LightTransport.from_matrix(csr_array(wall.reshape(144, -1)), (12, 12), (4, 8))
    second = lm.LightTransport.from_matrix(csr_array(other.reshape(144, -1)), (12, 12), (3, 8))
    output = tmp_path / "shown.png"
    found = lm.compensate([first, second], np.full((12, 12), 0.8), brightness=0.9, output=output)
    assert [pattern.shape for pattern in found.patterns] == [(4, 8), (3, 8)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shown-1.png", "shown-2.png"]
    seen = first.relight(found.patterns[0]) + second.relight(found.patterns[1])
    np.testing.assert_allclose(seen, found.target, atol=0.02)
    with pytest.raises(lm.InputError, match="differ in size"):
        _ = found.pattern


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wanted": np.ones((16, 32))}, "shape .16, 32., for a camera of 32 x 32"),
        ({"wanted": np.zeros((32, 32))}, "all black"),
        ({"wanted": np.full((32, 32), 255)}, "values from 255 to 255"),
        ({"wanted": np.full((32, 32), np.nan)}, "values from nan"),
        ({"wanted": np.full((32, 32), "x")}, "picture of type <U1"),
        ({"mask": np.zeros((32, 32))}, "mask leaves no camera pixel"),
        ({"mask": np.ones((3, 3))}, "mask has shape"),
        ({"ambient": np.full((32, 32), -1.0)}, "ambient light has values from -1"),
        ({"ambient": np.ones((3, 3))}, "ambient light has shape"),
        ({"projector_mask": np.ones((3, 3))}, "mask has shape .3, 3., for a projector of 32 x 32"),
        ({"fit": "fill"}, "a fit of 'fill'"),
        ({"brightness": 0}, "brightness of 0"),
        ({"brightness": 70}, "brightness of 70"),
        ({"brightness": float("nan")}, "brightness of nan"),
        ({"gamma": 0}, "gamma of 0"),
        ({"transport": []}, "no light transport matrix"),
        ({"transport": csr_array((1024, 4))}, "csr_array in place of a light transport matrix"),
        ({"transport": [_scene(), _scene((4, 4))]}, "cameras of shapes"),
        (
            {"transport": lm.LightTransport.from_matrix(csr_array((1024, 4)), (32, 32), (2, 2))},
            "lights no camera pixel",
        ),
    ],
)
def test_bad_input_is_refused(
    changed: dict[str, Any], words: str, known: lm.LightTransport
) -> None:
    arguments: dict[str, Any] = {"transport": known, "wanted": _ramp(), **changed}
    with pytest.raises(lm.InputError, match=words):
        lm.compensate(**arguments)


@pytest.mark.parametrize("part", ["sparse", "background"])
def test_entries_that_are_not_finite_are_refused(part: str) -> None:
    transport = _scene()
    (transport.sparse.data if part == "sparse" else transport.background.reshape(-1))[3] = np.nan
    uses: tuple[Callable[[], Any], ...] = (
        lambda: lm.compensate(transport, np.ones(transport.camera_shape)),
        lambda: lm.separate(transport),
    )
    for use in uses:
        with pytest.raises(lm.InputError, match="not all finite"):
            use()


def test_a_picture_that_is_black_where_there_is_light_is_refused() -> None:
    matrix = csr_array(np.diag([0.0, 1.0]).astype(np.float32))
    transport = lm.LightTransport.from_matrix(matrix, (1, 2), (1, 2))
    with pytest.raises(lm.InputError, match="black where the projector lights"):
        lm.compensate(transport, np.array([[1.0, 0.0]]))


def test_pictures_are_read_fitted_and_made_linear(known: lm.LightTransport, tmp_path: Path) -> None:
    """A photograph in colour of twice the size; whole levels have a gamma, floats are light."""
    grey = np.rint(255 * np.kron(_ramp(), np.ones((2, 2)))).astype(np.uint8)
    lm.write_image(tmp_path / "wanted.png", np.stack([grey] * 3, axis=-1))
    lm.write_image(tmp_path / "wanted.npy", (grey / 255) ** 2.2)
    for name in ("wanted.png", "wanted.npy"):
        found = lm.compensate(known, tmp_path / name, fit="cover", brightness=0.5)
        expected = found.scale * (np.rint(255 * _ramp()) / 255) ** 2.2
        np.testing.assert_allclose(found.target, expected, rtol=1e-4)
    with pytest.raises(lm.InputError, match="fit="):
        lm.compensate(known, tmp_path / "wanted.png")


def test_a_colour_jpeg_of_a_phone_is_seen_upright_in_its_luminance(
    known: lm.LightTransport, tmp_path: Path
) -> None:
    """Red above blue; the file holds it lying, and says that the camera was turned."""
    colours = np.zeros((32, 32, 3), np.uint8)
    colours[:, :16, 0] = colours[:, 16:, 2] = 255
    tags = Image.Exif()
    tags[0x0112] = 6
    Image.fromarray(colours).save(tmp_path / "phone.jpg", exif=tags, quality=100, subsampling=0)
    with pytest.warns(lm.LightMatrixWarning, match="its luminance is taken"):
        found = lm.compensate(known, tmp_path / "phone.jpg", brightness=0.5)
    assert found.target[5, 5] / found.scale == pytest.approx(0.2126, abs=0.01)
    assert found.target[25, 25] / found.scale == pytest.approx(0.0722, abs=0.01)
    assert abs(found.target[5] - found.target[5, 5]).max() < 0.01


@pytest.mark.parametrize(
    ("fit", "expected"),
    [
        # A picture of 2 x 4 in a frame of 4 x 4.
        ("cover", [[2, 2, 3, 3]] * 2 + [[6, 6, 7, 7]] * 2),
        ("contain", [[0] * 4, [1, 2, 3, 4], [5, 6, 7, 8], [0] * 4]),
        ("stretch", [[1, 2, 3, 4]] * 2 + [[5, 6, 7, 8]] * 2),
    ],
)
def test_the_ways_to_fit_a_picture(fit: str, expected: list[list[int]]) -> None:
    picture = np.arange(1, 9, dtype=np.float32).reshape(2, 4) / np.float32(8)
    one = fitted(picture, (4, 4), fit)
    # Enlarging is smooth: rows and columns in between are mixtures.
    np.testing.assert_allclose(one, np.array(expected) / 8, atol=0.2 if fit != "contain" else 1e-6)
    # All ways agree where nothing is left to fit, and colours stay together.
    three = fitted(np.stack([picture] * 3, axis=-1), (2, 4), fit)
    np.testing.assert_allclose(three, np.stack([picture] * 3, axis=-1), atol=1e-6)


def test_the_command_states_the_predicted_psnr(
    known: lm.LightTransport, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lm.save(tmp_path / "s.zarr", known)
    lm.write_image(tmp_path / "ramp.png", _ramp())
    words = ["compensate", str(tmp_path / "s.zarr"), str(tmp_path / "ramp.png")]
    assert main([*words, "-o", str(tmp_path / "shown.png")]) == 0
    stated = capsys.readouterr().out
    decibels = lm.compensate(known, tmp_path / "ramp.png").psnr
    assert f"predicted PSNR {decibels:.1f} dB, " in stated


def test_a_pattern_of_another_size_is_named(known: lm.LightTransport, tmp_path: Path) -> None:
    lm.write_image(tmp_path / "small.png", np.ones((5, 7)))
    with pytest.raises(lm.InputError, match=r"small\.png: the pattern has shape \(5, 7\)"):
        lm.cancel_global(known, tmp_path / "small.png")


def test_pixels_that_the_mask_of_the_projector_leaves_out_stay_black(
    known: lm.LightTransport,
) -> None:
    mask = np.ones((32, 32))
    mask[:, 20:] = 0
    found = lm.compensate(known, _ramp(), projector_mask=mask)
    assert not found.pattern[:, 20:].any()
    assert found.pattern[:, :20].max() > 0.5
    # What only those pixels light is in their shadow now.
    assert (found.reach[:, 22:] == Reach.SHADOW).mean() > 0.9


def test_it_says_how_the_picture_would_look_as_it_is(known: lm.LightTransport) -> None:
    found = lm.compensate(known, _ramp())
    assert found.uncompensated_psnr is not None
    assert found.psnr > found.uncompensated_psnr + 10
    # On a white wall there is nothing to compensate.
    wall = lm.LightTransport.from_matrix(csr_array(np.eye(64, dtype=np.float32)), (8, 8), (8, 8))
    same = lm.compensate(wall, _ramp((8, 8))).uncompensated_psnr
    assert same is not None
    assert same > 60


def test_a_video_file_is_compensated(known: lm.LightTransport, tmp_path: Path) -> None:
    with av.open(str(tmp_path / "film.mp4"), "w") as film:
        stream = film.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 96, 64, "yuv420p", 4_000_000
        for k in range(3):
            level = np.full((64, 96, 3), 60 + 60 * k, np.uint8)
            film.mux(stream.encode(av.VideoFrame.from_ndarray(level, "rgb24")))
        film.mux(stream.encode())
    words = ["compensate", str(tmp_path / "s.zarr"), str(tmp_path / "film.mp4")]
    lm.save(tmp_path / "s.zarr", known)
    assert main([*words, "-o", str(tmp_path / "out"), "--projector-response", "linear"]) == 0
    patterns = lm.read_patterns(tmp_path / "out").images()
    assert patterns.shape == (3, 32, 32)
    means = patterns.mean(axis=(1, 2))
    assert means[1] / means[0] == pytest.approx(2**2.2, rel=0.15)
    (tmp_path / "no.mp4").write_bytes(b"nothing")
    with pytest.raises(lm.InputError, match="cannot be read as a video"):
        lm.compensate_video(known, tmp_path / "no.mp4")


def test_a_video_keeps_its_brightness_and_its_errors_low(
    known: lm.LightTransport, tmp_path: Path
) -> None:
    frames = np.stack([np.roll(_ramp(), 2 * k, axis=1) for k in range(4)])
    frames[2] = 0
    video = lm.compensate_video(
        known, frames, projector_response="linear", output=tmp_path / "patterns"
    )
    for k in (0, 1, 3):
        single = lm.compensate(known, frames[k], brightness=video.brightness)
        assert video.predicted_psnr[k] > single.psnr - 0.2
    # What is left of the frame before a black one lights nothing that the camera sees.
    assert known.relight(video.patterns[2]).mean() < 0.002 * video.scale
    written = lm.read_patterns(tmp_path / "patterns")
    np.testing.assert_allclose(written.images(0, 4), video.patterns, atol=0.5 / 255 + 1e-6)
    with pytest.raises(lm.InputError, match="without frames"):
        lm.compensate_video(known, [])


def test_frames_that_are_solved_together_come_close_to_the_best(known: lm.LightTransport) -> None:
    """Also across a cut, from one batch to the next, and as the video states it."""
    moving = [np.roll(_ramp(), 2 * k, axis=1) for k in range(20)]
    frames = np.stack([one if k < 12 else one.T for k, one in enumerate(moving)])
    video = lm.compensate_video(known, frames)
    shared = compensator(known)
    for k in (0, 1, 8, 11, 12, 16, 17, 19):
        best = shared.solve(frames[k].ravel(), video.brightness, iterations=300)
        own = best.psnr_of(known.relight(video.patterns[k]))
        assert own == pytest.approx(video.predicted_psnr[k], abs=0.01)
        assert own > best.psnr - 0.3


# The pattern under which the camera sees direct light only.


@pytest.fixture(scope="module")
def corner() -> Truth:
    return binned(lm.truth("corner"), 2)


def _direct(corner: Truth) -> lm.LightTransport:
    return lm.LightTransport.from_matrix(corner.direct, corner.camera_shape, corner.projector_shape)


def _residue(corner: Truth, pattern: Any, wanted: Any) -> float:
    direct = corner.direct @ wanted.ravel()
    missed = corner.matrix @ pattern.ravel() - direct
    return float(np.linalg.norm(missed) / np.linalg.norm(direct))


def test_known_global_light_is_cancelled(corner: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    """0.288 of the direct light before."""
    white = np.ones(corner.projector_shape, np.float32)
    known = SimpleNamespace(direct=_direct(corner))
    monkeypatch.setattr("lightmatrix.uses.compensation.separate", lambda _: known)
    found = lm.cancel_global(corner.transport())
    assert _residue(corner, white, white) > 0.25
    assert _residue(corner, found.pattern, white) < 0.06
    assert found.pattern.min() >= 0
    assert found.pattern.max() <= 1
    expected = (corner.direct @ white.ravel()).reshape(corner.camera_shape)
    np.testing.assert_allclose(found.target, expected, rtol=1e-4, atol=1e-6)


def test_global_light_that_separation_finds_is_cancelled(corner: Truth) -> None:
    stripes = np.zeros(corner.projector_shape, np.float32)
    stripes[:, ::4] = stripes[:, 1::4] = 1
    found = lm.cancel_global(corner.transport(), stripes)
    before = _residue(corner, stripes, stripes)
    assert _residue(corner, found.pattern, stripes) < 0.6 * before


def test_what_does_not_fit_is_refused(corner: Truth, tmp_path: Path) -> None:
    known = corner.transport()
    faults: dict[str, dict[str, Any]] = {
        "gives no direct light": {"pattern": np.zeros((32, 32))},
        "pattern has shape": {"pattern": np.ones((8, 8))},
        "pattern of shape": {"pattern": np.ones((32, 32, 3))},
    }
    for words, arguments in faults.items():
        with pytest.raises(lm.InputError) as caught:
            lm.cancel_global(known, output=tmp_path / "new.png", **arguments)
        assert words in f"{caught.value} {caught.value.hint}"
    assert not list(tmp_path.iterdir())


def test_the_pattern_is_encoded_for_the_projector(
    known: lm.LightTransport,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A projector of gamma 2.2 that is sent what was written shows the light that was found."""
    monkeypatch.chdir(tmp_path)
    response = lm.ProjectorResponse.of_gamma(2.2)
    response.save("projector.json")
    capture = {"capture_description": response.as_provenance}
    of_capture = replace(known, provenance=capture)
    lm.save("scene.zarr", of_capture)
    lm.write_image("wanted.png", np.rint(255 * _ramp()).astype(np.uint8))

    def missed(stated: Any, transport: lm.LightTransport = known) -> float:
        found = lm.compensate(
            transport, _ramp(), output="p.png", projector_response=stated, overwrite=True
        )
        shown = response.light_of(lm.read_image("p.png") / 255)
        return float(np.abs(shown - found.pattern).max())

    for curve in (response, "projector.json", "gamma:2.2"):
        assert missed(curve) < 0.01
    # A projector of which nothing is known is taken for one of gamma 2.2.
    assert max(missed(None), missed(None, of_capture)) < 0.01
    assert min(missed("linear"), missed("linear", of_capture)) > 0.1
    video = lm.compensate_video(of_capture, [_ramp()], output="video")
    sent = lm.read_patterns("video").images()
    assert np.abs(response.light_of(sent) - video.patterns).max() < 0.01

    def said(*words: str) -> str:
        arguments = ["compensate", "scene.zarr", "wanted.png", "-o", "q.png", "--overwrite"]
        assert main([*arguments, *words]) == 0
        return capsys.readouterr().out

    assert "gamma 2.2, by the capture of T" in said()
    assert "it holds light" in said("--projector-response", "linear")
    lm.save("unknown.zarr", known)
    assert main(["compensate", "unknown.zarr", "wanted.png", "-o", "u.png"]) == 0
    assert "gamma 2.2, which is assumed" in capsys.readouterr().out
    other = lm.ProjectorResponse.of_gamma(1.8)
    lm.RigMeasurements({}, {}, response=other).save("rig.json")
    assert "gamma 1.8, by rig.json" in said()
    assert "gamma 2, by gamma:2" in said("--projector-response", "gamma:2")
    with pytest.raises(lm.InputError, match="a gamma of 20"):
        missed("gamma:20")
    with pytest.raises(lm.InputError, match=r"nowhere\.json"):
        missed("nowhere.json")
    for wrong in ("2.2", "gamma:2,2", "linear:3"):
        with pytest.raises(lm.InputError, match="projector's response") as refused:
            missed(wrong)
        assert "gamma:2.2, linear, or a file" in (refused.value.hint or "")
    arguments = ["compensate", "scene.zarr", "wanted.png", "-o", "r.png", "--rig", "virtual:metal"]
    assert main([*arguments, "--projector-response", "gamma:2.2"]) == 2
    assert "`lightmatrix rig response` measures" in capsys.readouterr().err


def test_a_capture_tells_the_response_of_its_projector(tmp_path: Path) -> None:
    patterns = lm.ImagePatterns(np.random.default_rng(0).random((6, 4, 4), np.float32))
    lm.simulate(lm.ProceduralScene((4, 4), (4, 4)).truth(), patterns).save(tmp_path / "c")
    response = lm.ProjectorResponse.of_gamma(2.2)
    response.save(tmp_path / "projector.json")
    settings = lm.ReadSettings(projector_response=tmp_path / "projector.json")
    place = tmp_path / "c"
    lm.write_patterns(place / "shown", patterns)
    capture = lm.Capture.from_folders(place / "shown", place / "images", settings)
    kept = {"capture_description": capture.description}
    read = lm.ProjectorResponse.of_provenance(json.loads(json.dumps(kept)))
    assert read is not None
    assert read.gamma == pytest.approx(2.2, abs=0.01)
    found = lm.ProjectorResponse.of_provenance({"found_response": {"projector_gamma": 1.8}})
    assert found is not None
    assert found.gamma == 1.8
    assert lm.ProjectorResponse.of_provenance({}) is None
