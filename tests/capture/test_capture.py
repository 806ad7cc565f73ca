"""Captures: reading and writing folders, decoding tiles, binning and masks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

import lightmatrix as lm
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.folder import check_depth, write_capture
from lightmatrix.capture.frames import ArrayStack, PixelFrames
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import KEYS, ReadSettings
from lightmatrix.check.refusals import refuse_unusable
from lightmatrix.errors import InputError, LightMatrixWarning, OutputError
from lightmatrix.files.images import read_image, write_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.folder import read_patterns, write_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.resources import memory
from tests.helpers.captures import (
    COUNT,
    SETS,
    SHAPE,
    light,
    photographs,
    write_folders,
    write_plain,
)


@pytest.mark.parametrize("patterns", SETS, ids=lambda patterns: type(patterns).__name__)
def test_patterns_come_back_as_the_operator_they_were(tmp_path: Path, patterns: PatternSet) -> None:
    write_patterns(tmp_path / "patterns", patterns)
    read = read_patterns(tmp_path / "patterns")
    assert type(read) is type(patterns)
    assert read.digest == patterns.digest
    np.testing.assert_array_equal(read.dense(), patterns.dense())


def test_images_override_their_description(tmp_path: Path) -> None:
    write_patterns(tmp_path / "patterns", SETS[0])
    changed = SETS[0].images()
    changed[4, 2, 3] = 1 - changed[4, 2, 3]
    write_image(tmp_path / "patterns" / "pattern_0004.png", changed[4], overwrite=True)
    with pytest.warns(LightMatrixWarning, match=r"pattern_0004\.png is not among"):
        read = read_patterns(tmp_path / "patterns")
    np.testing.assert_array_equal(read.images(), changed)
    (tmp_path / "patterns" / "pattern_0004.png").unlink()
    with pytest.warns(LightMatrixWarning, match="its 8 images are not"):
        assert read_patterns(tmp_path / "patterns").count == COUNT - 1


def test_a_damaged_description_is_named(tmp_path: Path) -> None:
    write_patterns(tmp_path / "patterns", SETS[0])
    file = tmp_path / "patterns" / "patterns.json"
    content = json.loads(file.read_text())

    def described(**change: Any) -> str:
        return json.dumps({**content, "description": {**content["description"], **change}})

    for text, message in (
        ("{", "cannot be read"),
        ("{}", "is not a lightmatrix-patterns file"),
        (json.dumps({**content, "version": 2}), "format version 2"),
        (json.dumps({**content, "description": None}), "holds no description"),
        (json.dumps({**content, "description": {"kind": "moire"}}), "'moire' are unknown"),
        (described(seed="0"), "a seed of '0'"),
        (described(seed=-1), "a seed of -1"),
        (described(density=2), "a density of 2"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=rf"patterns\.json: .*{message}"):
            read_patterns(tmp_path / "patterns")


@pytest.mark.parametrize("camera", [(5, 7), (4, 3, 3), (1, 1)])
@pytest.mark.parametrize("bits", [8, 12, 16, None])
def test_a_written_capture_comes_back(
    tmp_path: Path, bits: int | None, camera: tuple[int, ...]
) -> None:
    patterns = SETS[0]
    black = 0.05 if bits is None else 2.0**bits // 20
    exposure = np.linspace(0.5, 1.5, COUNT)
    sensor = Sensor(exposure, black, read_noise=0.002, bits=bits)
    frames = photographs(patterns, sensor, camera)
    write_capture(
        tmp_path / "c", patterns, frames, sensor=sensor, camera_shape=camera, provenance={"seed": 1}
    )
    capture = Capture.open(tmp_path / "c")
    assert isinstance(capture.patterns, BernoulliPatterns)
    assert (capture.camera_shape, capture.projector_shape) == (camera, SHAPE)
    assert capture.description["seed"] == 1
    assert capture.reference_level == pytest.approx(1 / 1.5)
    memory = Capture.from_arrays(patterns, frames, sensor)
    assert capture.digest == memory.digest
    samples = capture.samples()
    assert samples.clipped.any() or capture.rows == 1
    truth = light(patterns, camera)
    open_ = ~samples.clipped
    step = 0.004 if bits == 8 else 0.002
    error = np.abs(samples.values - truth) * exposure
    assert error[open_].max() < step + 5 * 0.002
    np.testing.assert_allclose(samples.clip_level, 1 / exposure, rtol=1e-6)
    assert samples.weights is not None
    # Misfit of 3 % of the longest exposure's range and noise of 0.3 % of each frame's.
    variance = 0.03**2 + (0.003 * 1.5 / exposure) ** 2
    np.testing.assert_allclose(samples.weights, variance.min() / variance, rtol=1e-6)
    np.testing.assert_array_equal(capture.frame(3), frames[3])


def test_plain_folders_in_natural_order(tmp_path: Path) -> None:
    sensor = Sensor()
    frames = photographs(SETS[3], sensor)
    patterns, photos = write_folders(tmp_path, SETS[3], frames)
    capture = Capture.from_folders(patterns, photos)
    assert capture.digest == Capture.from_arrays(SETS[3], frames, sensor).digest
    assert capture.samples().weights is None


def test_options_of_plain_folders(tmp_path: Path) -> None:
    sensor = Sensor(black_level=20, clip=200)
    frames = photographs(SETS[3], sensor)
    patterns, photos = write_folders(tmp_path, SETS[3], frames)
    expected = Capture.from_arrays(SETS[3], frames, sensor)
    capture = Capture.from_folders(patterns, photos, ReadSettings(black=20, clip=200, exposure=1.0))
    assert capture.digest == expected.digest

    black = np.full((5, 7), 20, np.uint8)
    black[2, 3] = 255
    write_image(tmp_path / "black.png", black)
    mask = np.full((5, 7), 255, np.uint8)
    mask[0, :2] = 0
    write_image(tmp_path / "mask.png", mask)
    write_image(tmp_path / "white.png", np.full((5, 7), 150, np.uint8))
    capture = Capture.from_folders(
        patterns,
        photos,
        ReadSettings(
            black=tmp_path / "black.png",
            white=tmp_path / "white.png",
            mask=tmp_path / "mask.png",
            black_level=20,
            clip=200,
        ),
    )
    assert capture.count == COUNT + 1
    np.testing.assert_array_equal(capture.patterns.images()[-1], 1)
    samples = capture.samples()
    assert samples.weights is not None
    # Two pixels are masked and one is hot: it clips without light.
    assert np.flatnonzero(samples.weights[:, 0] == 0).tolist() == [0, 1, 2 * 7 + 3]
    assert not samples.values[samples.weights == 0].any()
    assert not samples.clipped[samples.weights == 0].any()
    np.testing.assert_allclose(samples.values[5:9, -1], 130 / 180, rtol=1e-6)
    with pytest.raises(InputError, match=r"darker than the black level of 50\n.*at most 20"):
        Capture.from_folders(
            patterns, photos, ReadSettings(black=tmp_path / "black.png", black_level=50)
        )
    kept = samples.weights[:, 0] > 0
    np.testing.assert_allclose(
        samples.values[kept, :-1], expected.samples().values[kept], atol=1e-6
    )


@given(st.integers(0, 5), st.integers(0, 40), st.sampled_from([(1, 1), (2, 3), (4, 4)]))
@settings(max_examples=30, deadline=None)
def test_tiles_are_parts_of_the_whole(seed: int, cut: int, block: tuple[int, int]) -> None:
    sensor = Sensor(np.linspace(0.8, 1.2, COUNT), 10, read_noise=0.02)
    frames = photographs(SETS[0], sensor, seed=seed)
    decoder = Decoder(
        255, 255, 10, exposure=sensor.exposure, black_frame=frames[0].ravel() / 9, black_exposure=1
    )
    capture = Capture.from_arrays(SETS[0], frames, decoder).bin(camera=block)
    whole, cut = capture.samples(), min(cut, capture.rows)
    parts = capture.samples(0, cut), capture.samples(cut)
    for name in ("values", "clipped", "clip_level"):
        joined = np.concatenate([np.broadcast_to(getattr(p, name), p.values.shape) for p in parts])
        np.testing.assert_array_equal(
            joined, np.broadcast_to(getattr(whole, name), whole.values.shape)
        )


def test_binning_the_camera_averages_samples() -> None:
    sensor = Sensor(read_noise=0.01)
    camera = (5, 7, 3)
    capture = Capture.from_arrays(SETS[0], photographs(SETS[0], sensor, camera), sensor)
    fine, coarse = capture.samples(), capture.bin(camera=(2, 3))
    assert coarse.camera_shape == (3, 3, 3)
    values = fine.values.reshape(*camera, COUNT)
    clipped = fine.clipped.reshape(*camera, COUNT)
    binned = coarse.samples()
    row = 0
    for r in range(0, 5, 2):
        for c in range(0, 7, 3):
            for channel in range(3):
                block = np.s_[r : r + 2, c : c + 3, channel]
                np.testing.assert_allclose(
                    binned.values[row], values[block].mean(axis=(0, 1)), rtol=1e-5, atol=1e-6
                )
                np.testing.assert_array_equal(binned.clipped[row], clipped[block].any(axis=(0, 1)))
                row += 1
    assert row == coarse.rows


def test_binning_the_projector_averages_patterns() -> None:
    sensor = Sensor()
    capture = Capture.from_arrays(SETS[0], photographs(SETS[0], sensor), sensor)
    coarse = capture.bin(projector=2)
    assert coarse.projector_shape == (3, 4)
    expected = SETS[0].images().reshape(COUNT, 3, 2, 4, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(coarse.patterns.images(), expected)
    np.testing.assert_array_equal(coarse.samples().values, capture.samples().values)
    with pytest.raises(InputError, match="binned already"):
        coarse.bin(projector=2)
    with pytest.raises(InputError, match="binned by 0 x 2"):
        capture.bin(camera=(0, 2))


def test_masked_pixels_do_not_count_in_a_bin() -> None:
    sensor = Sensor()
    frames = photographs(SETS[0], sensor, (4, 4))
    frames[:, 0, 0] = 255
    mask = np.ones((4, 4), bool)
    mask[0, 0] = False
    mask[2:, 2:] = False
    capture = Capture.from_arrays(SETS[0], frames, sensor, mask=mask)
    binned = capture.bin(camera=2)
    samples = binned.samples()
    assert binned.valid.tolist() == [True, True, True, False]
    inside = capture.samples().values.reshape(4, 4, COUNT)
    expected = (inside[0, 1] + inside[1, 0] + inside[1, 1]) / 3
    np.testing.assert_allclose(samples.values[0], expected, rtol=1e-5)
    assert samples.weights is not None
    np.testing.assert_array_equal(samples.weights[:, 0], [1, 1, 1, 0])


def test_selected_frames_keep_their_own_levels() -> None:
    sensor = Sensor(np.linspace(0.5, 1.5, COUNT))
    capture = Capture.from_arrays(SETS[0], photographs(SETS[0], sensor), sensor)
    index = [7, 2, 4]
    part, whole = capture.select(index), capture.samples()
    np.testing.assert_array_equal(part.patterns.images(), SETS[0].images()[index])
    np.testing.assert_array_equal(part.samples().values, whole.values[:, index])
    np.testing.assert_array_equal(part.samples().clip_level, whole.clip_level[index])


def test_large_captures_are_kept_in_a_temporary_file(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = Sensor()
    frames = photographs(SETS[0], sensor)
    expected = Capture.from_arrays(SETS[0], frames, sensor)
    monkeypatch.setattr(memory, "SCRATCH_MEMORY_BYTES", 0)
    mapped = Capture.from_arrays(SETS[0], frames, sensor)
    assert isinstance(mapped.raw, np.memmap)
    assert mapped.digest == expected.digest
    assert mapped.bin(camera=2).digest == expected.bin(camera=2).digest


def test_the_digest_tells_captures_apart() -> None:
    sensor = Sensor(read_noise=0.01)
    frames = photographs(SETS[0], sensor)
    capture = Capture.from_arrays(SETS[0], frames, sensor)
    changed = frames.copy()
    changed[3, 2, 2] ^= 1
    digests = {
        capture.digest,
        Capture.from_arrays(SETS[0], changed, sensor).digest,
        Capture.from_arrays(SETS[3], frames, sensor).digest,
        Capture.from_arrays(SETS[0], frames, Sensor(black_level=1)).digest,
        capture.bin(camera=2).digest,
        capture.bin(projector=2).digest,
    }
    assert len(digests) == 6


def test_a_folder_without_description_is_a_linear_camera(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    whole = Capture.open(place)
    (place / "capture.json").unlink()
    assert Capture.open(place).digest == whole.digest


def test_a_capture_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    sensor = Sensor()
    frames = photographs(SETS[0], sensor)
    with pytest.raises(InputError, match="8 frames for 9 patterns"):
        write_capture(tmp_path / "c", SETS[0], frames[:-1], sensor=sensor)
    with pytest.raises(InputError, match=r"frame 1 has shape \(4, 7\)"):
        write_capture(tmp_path / "c", SETS[0], iter([frames[0], frames[1][1:]]), sensor=sensor)
    assert not list(tmp_path.iterdir())
    write_capture(tmp_path / "c", SETS[0], frames, sensor=sensor)
    with pytest.raises(OutputError, match="overwrite=True"):
        write_capture(tmp_path / "c", SETS[0], frames, sensor=sensor)
    write_capture(tmp_path / "c", SETS[0], frames[::-1], sensor=sensor, overwrite=True)
    np.testing.assert_array_equal(Capture.open(tmp_path / "c").frame(0), frames[-1])


@pytest.mark.parametrize("bits", [10, 12])
def test_files_with_unused_bits_are_refused(tmp_path: Path, bits: int) -> None:
    # Nobody stated the clip level, and no level is above a sixteenth of that of the files.
    frames = photographs(SETS[0], Sensor(bits=bits))
    for k, frame in enumerate(frames):
        write_image(tmp_path / "photos" / f"{k}.png", frame)

    def judge(settings: ReadSettings, block: int = 1) -> None:
        photos = tmp_path / "photos"
        refuse_unusable(Capture.from_folders(SETS[0], photos, settings, bin_camera=block))

    for block in (1, 2):
        with pytest.raises(InputError, match=f"no level above {2**bits - 1}.*\n.*clip="):
            judge(ReadSettings(), block)
    judge(ReadSettings(clip=2**bits - 1))
    judge(ReadSettings(clip=65535))


class ByPixel(ArrayStack):
    """Frames that are read fast by pixel, as packed ones."""

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        return self.array.reshape(self.count, -1)[:, start:stop].T

    def part(self, rows: slice, cols: slice) -> ByPixel:
        return ByPixel(self.array[:, rows, cols])


@pytest.mark.parametrize("stack", [ArrayStack, ByPixel])
def test_hot_pixels_do_not_hide_unused_bits(stack: type[ArrayStack]) -> None:
    assert isinstance(stack(np.zeros((1, 2, 2))), PixelFrames) == (stack is ByPixel)
    frames = np.random.default_rng(0).integers(0, 4096, (16, 40, 40)).astype(np.uint16)
    decoder = Decoder(4, 65535, clip_assumed=True)
    frames[:, 7, 9] = 65535
    with pytest.raises(InputError, match="no level above 4095"):
        check_depth(stack(frames), decoder)
    # A pixel that is bright in one photograph sees light, as two in a thousand bright ones do.
    frames[1:, 7, 9] = 0
    check_depth(stack(frames), decoder)
    frames[:, 7:9, 9] = 65535
    check_depth(stack(frames), decoder)


def test_swapped_bytes_are_named() -> None:
    smooth = np.add.outer(np.linspace(0, 2000, 24), np.linspace(0, 2000, 32))
    raw = (smooth + np.random.default_rng(0).normal(60, 20, (5, 24, 32))).astype(np.uint16)
    # Levels of 12 bits, shifted to 16, without low bytes, without high ones, and two levels.
    for frames in (raw, raw * 16, (raw // 16) * 256, raw // 16, (raw > 2000) * np.uint16(0xFF01)):
        check_depth(ArrayStack(frames), Decoder(4095, 65535))
    for frames in (raw, raw * 16):
        with pytest.raises(InputError, match="bytes of each level are swapped"):
            check_depth(ArrayStack(frames.byteswap()), Decoder(4095, 65535))


def test_levels_below_black_are_named() -> None:
    frames = np.full((5, 24, 32), -0.5, np.float32)
    with pytest.raises(InputError, match="half of the levels that were looked at are below -0"):
        check_depth(ArrayStack(frames), Decoder(1, 1))


def test_levels_of_float_images_are_stated_in_their_own_unit(tmp_path: Path) -> None:
    patterns, photos = write_folders(tmp_path, SETS[0], photographs(SETS[0], Sensor(bits=12)))
    for file in list(photos.iterdir()):
        write_image(file.with_suffix(".tif"), read_image(file).astype(np.float32))
        file.unlink()
    with pytest.raises(InputError, match="levels up to 4095") as caught:
        lm.estimate(Capture.from_folders(patterns, photos), check=False)
    assert "clip=4095" in str(caught.value.hint)
    # The level that the message proposes is accepted, and is where a curve ends.
    stated = ReadSettings(clip=4095, response="gamma:2")
    alone = Capture.from_folders(patterns, photos, stated)
    both = Capture.from_folders(patterns, photos, replace(stated, full_scale=4095))
    assert alone.digest == both.digest
    assert alone.decoder.full_scale == 4095


def test_jpeg_without_a_response_is_warned_about(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for k, frame in enumerate(photographs(SETS[0], Sensor())):
        Image.fromarray(frame).save(tmp_path / "photos" / f"{k}.jpg")
    with pytest.warns(LightMatrixWarning, match="JPEG, so probably not linear"):
        Capture.from_folders(SETS[0], tmp_path / "photos")
    for response in ("linear", "srgb"):
        Capture.from_folders(SETS[0], tmp_path / "photos", ReadSettings(response=response))


def test_patterns_that_binning_makes_constant_are_no_error_unless_all_are() -> None:
    sensor = Sensor()
    frames = photographs(SETS[0], sensor)
    checker = np.indices(SHAPE).sum(axis=0) % 2
    images = SETS[0].images().copy()
    images[:4] = checker
    refuse_unusable(Capture.from_arrays(ImagePatterns(images), frames, sensor).bin(projector=2))
    images[:] = checker
    images[::2] = 1 - checker
    capture = Capture.from_arrays(ImagePatterns(images), frames, sensor)
    with pytest.raises(InputError, match="no pattern varies"):
        refuse_unusable(capture.bin(projector=2))


def test_the_documented_description_is_the_one_that_is_read() -> None:
    page = (Path(__file__).parents[2] / "docs" / "captures.md").read_text()
    example = json.loads(page.split("```json")[1].split("```")[0])
    assert set(example) == set(KEYS)
    for key in set(example) - {"format", "version"}:
        assert f"`{key}`" in page


def test_grey_saved_as_equal_colours_is_grey_for_the_black_frame_too(tmp_path: Path) -> None:
    patterns, grey = SETS[0], photographs(SETS[0], Sensor())
    black = np.random.default_rng(1).integers(0, 9, (5, 7)).astype(np.uint8)
    digests = set()
    for channels in (1, 3):
        place = tmp_path / str(channels)
        frames, dark = (np.squeeze(np.stack([x] * channels, -1)) for x in (grey, black))
        shown, photos = write_folders(place, patterns, frames)
        write_image(place / "black.png", dark)
        settings = ReadSettings(black=place / "black.png")
        digests.add(Capture.from_folders(shown, photos, settings).digest)
    assert len(digests) == 1


def test_check_reads_nothing_outside_the_folder(tmp_path: Path) -> None:
    write_capture(tmp_path / "capture", SETS[0], photographs(SETS[0], Sensor()), sensor=Sensor())
    write_image(tmp_path / "mask.png", np.ones((5, 7), np.uint8))
    file = tmp_path / "capture" / "capture.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "mask": "../mask.png"}))
    with pytest.raises(InputError, match="outside"):
        lm.check(tmp_path / "capture")
