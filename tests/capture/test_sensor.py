"""The sensor: raw levels and back, noise that does not depend on tiling, binning that is true."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.samples import Samples, bin_samples
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError

seeds = st.integers(0, 2**32)
small = st.integers(1, 9)


@st.composite
def sensors(draw: st.DrawFn) -> Sensor:
    bits = draw(st.sampled_from([8, 10, 12, 16, None]))
    full = 1.0 if bits is None else 2.0**bits - 1
    clip = draw(st.sampled_from([None, round(0.9 * full, 1)]))
    black = draw(st.sampled_from([0.0, round(0.05 * full, 1)]))
    return Sensor(draw(st.floats(0.2, 5)), black, bits=bits, clip=clip)


@given(sensors(), small, small, seeds)
@settings(max_examples=100, deadline=None)
def test_levels_decode_to_the_light_and_to_its_clip_state(
    sensor: Sensor, rows: int, frames: int, seed: int
) -> None:
    light = np.random.default_rng(seed).random((rows, frames)) * 2 / float(sensor.exposure)
    raw = sensor.expose(light)
    assert raw.dtype == sensor.dtype
    decoded = sensor.decoder().decode(raw)
    exposed = light * float(sensor.exposure)
    # Two quanta: rounding of the level, and a clip level between two levels.
    step = 2 / (sensor.clip_level - sensor.black_level) if sensor.bits else 1e-6
    np.testing.assert_allclose(decoded.clip_level * sensor.exposure, 1, rtol=1e-6)
    np.testing.assert_array_equal(decoded.clipped[exposed >= 1], True)
    np.testing.assert_array_equal(decoded.clipped[exposed < 1 - step], False)
    values = decoded.values * float(sensor.exposure)
    np.testing.assert_allclose(values, np.minimum(exposed, 1), atol=step)
    level = np.broadcast_to(decoded.clip_level, raw.shape)
    np.testing.assert_array_equal(decoded.values[decoded.clipped], level[decoded.clipped])
    assert (decoded.values[~decoded.clipped] < level[~decoded.clipped]).all()


@given(st.integers(1, 12), st.integers(1, 6), st.integers(0, 2**64 - 1), st.data())
@settings(max_examples=80, deadline=None)
def test_noise_does_not_depend_on_the_tiling(
    rows: int, frames: int, seed: int, data: st.DataObject
) -> None:
    sensor = Sensor(np.linspace(0.5, 2, frames), 10, read_noise=0.1, shot_noise=0.2, bits=12)
    light = np.random.default_rng(1).random((rows, frames))
    whole = sensor.expose(light, seed=seed)
    row, frame = data.draw(st.integers(0, rows)), data.draw(st.integers(0, frames))
    for r in (slice(0, row), slice(row, rows)):
        for k in (slice(0, frame), slice(frame, frames)):
            tile = sensor.expose(light[r, k], seed=seed, first_row=r.start, first_frame=k.start)
            np.testing.assert_array_equal(tile, whole[r, k])


def test_noise_has_the_stated_size_and_is_fresh_for_every_frame_and_seed() -> None:
    sensor = Sensor(2.0, 0.2, read_noise=0.01, shot_noise=0.05, bits=None)
    light = np.full((40000, 2), 0.125)
    samples = (sensor.expose(light, seed=3) - 0.2) / 0.8
    other = (sensor.expose(light, seed=4) - 0.2) / 0.8
    expected = np.hypot(0.01, 0.05 * np.sqrt(0.25))
    np.testing.assert_allclose(samples.std(axis=0), expected, rtol=0.02)
    np.testing.assert_allclose(samples.mean(axis=0), 0.25, atol=4 * expected / 200)
    for second in (samples[:, 1], other[:, 0]):
        assert abs(np.corrcoef(samples[:, 0], second)[0, 1]) < 0.02


def test_noise_is_clipped_with_the_light() -> None:
    raw = Sensor(read_noise=0.05, bits=8).expose(np.full((1000, 1), 1.5))
    assert (raw == 255).all()


@pytest.mark.parametrize("name", ["gamma:2.2", "gamma:1.8", "srgb"])
def test_a_response_is_undone_before_the_black_level(name: str) -> None:
    light = np.linspace(0, 1, 200)[:, None]
    if name == "srgb":
        curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    else:
        curve = light ** (1 / float(name.partition(":")[2]))
    raw = np.rint(curve * 65535).astype(np.uint16)
    decoder = Decoder(65535, 65535, response=Response.parse(name))
    np.testing.assert_allclose(decoder.decode(raw).values, light, atol=1e-4)
    black = raw[20, 0]
    decoder = Decoder(65535, 65535, float(black), response=Response.parse(name))
    expected = (light - light[20]) / (1 - light[20])
    np.testing.assert_allclose(decoder.decode(raw).values, expected, atol=1e-4)


@pytest.mark.parametrize(
    "text", ["0 0\n100 0.25\n255 1\n", "# level, light\n0,0\n100,5\n255,20\n", None]
)
def test_a_response_curve_from_a_file(tmp_path: Path, text: str | None) -> None:
    file = tmp_path / ("curve.txt" if text else "curve.npy")
    if text:
        file.write_text(text)
    else:
        np.save(file, np.array([[0, 0], [100, 1], [255, 4]]))
    decoder = Decoder(255, 255, response=Response.parse(f"curve:{file}"))
    raw = np.array([[0, 50, 100, 255]], np.uint8)
    np.testing.assert_allclose(decoder.decode(raw).values, [[0, 0.125, 0.25, 1]], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gamma", "a response of 'gamma'"),
        ("gamma:0", "a response of 'gamma:0'"),
        ("gamma:two", "a response of 'gamma:two'"),
        ("rec709", "a response of 'rec709'"),
        ("curve:nothing.txt", "no such file"),
    ],
)
def test_unknown_responses(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Response.parse(text)


def test_a_black_frame_is_subtracted_and_lowers_the_clip_level() -> None:
    sensor = Sensor(bits=12, black_level=100)
    ambient = np.array([0.0, 0.1, 0.5])
    light = np.array([0.05, 0.2, 0.9])[:, None]
    black_frame = sensor.expose(ambient[:, None])[:, 0]
    decoder = Decoder(4095, 4095, 100, black_frame=black_frame)
    decoded = decoder.decode(sensor.expose(light + ambient[:, None]))
    np.testing.assert_array_equal(decoded.clipped[:, 0], [False, False, True])
    np.testing.assert_allclose(decoded.values[:2], light[:2], atol=1e-3)
    np.testing.assert_allclose(decoded.clip_level[:, 0], 1 - ambient, atol=1e-3)
    np.testing.assert_allclose(decoded.values[2], 0.5, atol=1e-3)
    tile = decoder.decode(sensor.expose(light + ambient[:, None])[1:], first_row=1)
    np.testing.assert_array_equal(tile.values, decoded.values[1:])


def test_ambient_light_of_a_black_frame_grows_with_the_exposure() -> None:
    exposure = np.array([0.5, 2.0])
    sensor = Sensor(exposure, 200, bits=16)
    ambient, light = 0.1, np.array([[0.3, 0.3]])
    black_frame = Sensor(0.25, 200, bits=16).expose(np.array([[ambient]]))[:, 0]
    decoder = Decoder(
        65535, 65535, 200, exposure=exposure, black_frame=black_frame, black_exposure=0.25
    )
    decoded = decoder.decode(sensor.expose(light + ambient))
    np.testing.assert_allclose(decoded.values, light, atol=1e-3)
    np.testing.assert_allclose(decoded.clip_level, [[1.9, 0.4]], atol=1e-3)
    with pytest.raises(InputError, match="black frame of unknown exposure"):
        Decoder(65535, 65535, 200, exposure=exposure, black_frame=black_frame)


def test_pixels_that_clip_in_the_black_frame_are_hot() -> None:
    decoder = Decoder(250, 255, black_frame=np.array([3, 250, 255, 249]))
    np.testing.assert_array_equal(decoder.hot, [False, True, True, False])


def test_levels_per_frame() -> None:
    decoder = Decoder(
        np.array([200, 100]), 255, np.array([0.0, 20.0]), exposure=np.array([1.0, 0.5])
    )
    decoded = decoder.decode(np.array([[100, 60], [200, 100]], np.uint8))
    np.testing.assert_allclose(decoded.values, [[0.5, 1.0], [1.0, 2.0]], rtol=1e-6)
    np.testing.assert_array_equal(decoded.clipped, [[False, False], [True, True]])
    np.testing.assert_allclose(decoded.clip_level, [1, 2])
    second = decoder.decode(np.array([[60]], np.uint8), first_frame=1)
    np.testing.assert_allclose(second.values, [[1.0]], rtol=1e-6)
    with pytest.raises(InputError, match="2 clip levels for 3 frames"):
        decoder.decode(np.zeros((1, 3), np.uint8))


@given(
    st.tuples(st.integers(1, 7), st.integers(1, 7)),
    st.sampled_from([(), (3,)]),
    st.tuples(st.integers(1, 4), st.integers(1, 4)),
    st.booleans(),
    seeds,
)
@settings(max_examples=120, deadline=None)
def test_binning_keeps_the_truth(
    size: tuple[int, int],
    channels: tuple[int, ...],
    block: tuple[int, int],
    per_pixel: bool,
    seed: int,
) -> None:
    generator = np.random.default_rng(seed)
    shape, frames = (*size, *channels), 2
    count = int(np.prod(shape))
    values = generator.random((count, frames)).astype(np.float32)
    clipped = generator.random((count, frames)) < 0.2
    level = generator.random((count, 1) if per_pixel else (frames,)).astype(np.float32)
    valid = generator.random(count) < 0.7
    binned = bin_samples(Samples(values, clipped, level), valid, shape, block)

    grid = (*size, channels[0] if channels else 1)
    row = 0
    for r in range(0, size[0], block[0]):
        for c in range(0, size[1], block[1]):
            for channel in range(grid[2]):
                index = (
                    np.arange(count)
                    .reshape(grid)[r : r + block[0], c : c + block[1], channel]
                    .ravel()
                )
                index = index[valid[index]]
                if len(index):
                    np.testing.assert_allclose(
                        binned.values[row], values[index].mean(axis=0), rtol=1e-5
                    )
                    np.testing.assert_array_equal(binned.clipped[row], clipped[index].any(axis=0))
                    if per_pixel:
                        expected = level[index].mean()
                        np.testing.assert_allclose(binned.clip_level[row], expected, rtol=1e-5)
                else:
                    assert not binned.clipped[row].any()
                    assert not binned.values[row].any()
                row += 1
    assert row == len(binned.values)
    if not per_pixel:
        np.testing.assert_array_equal(binned.clip_level, level)


def test_a_binned_clipped_sample_is_a_lower_bound() -> None:
    sensor = Sensor(bits=8)
    light = np.random.default_rng(0).random((64, 5)) * 1.2
    decoded = sensor.decoder().decode(sensor.expose(light))
    binned = bin_samples(decoded, None, (8, 8), (2, 4))
    truth = bin_samples(
        Samples(light.astype(np.float32), decoded.clipped, decoded.clip_level), None, (8, 8), (2, 4)
    )
    assert binned.clipped.any()
    assert not binned.clipped.all()
    assert (binned.values <= truth.values + 1 / 255).all()
    np.testing.assert_allclose(
        binned.values[~binned.clipped], truth.values[~binned.clipped], atol=1 / 255
    )


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"bits": 9}, "a camera of 9 bits"),
        ({"exposure": 0.0}, "an exposure of 0"),
        ({"exposure": np.array([1, np.nan])}, "an exposure of"),
        ({"read_noise": -0.1}, "read noise of -0.1"),
        ({"shot_noise": np.inf}, "shot noise of inf"),
        ({"clip": -5}, "a clip level of -5"),
        ({"clip": 256}, "a clip level of 256"),
        ({"black_level": 255}, "a black level of 255"),
        ({"black_level": -1}, "a black level of -1"),
    ],
)
def test_impossible_sensors(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Sensor(**parameters)
