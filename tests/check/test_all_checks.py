"""Each fault of a capture is found and named; intact captures, of any kind, are left alone.

How often, over many captures, `python -m benchmarks.frame_checks` measures.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import lightmatrix as lm
from benchmarks import frame_checks
from lightmatrix.capture.folder import write_capture
from lightmatrix.check.all_checks import (
    check_capture,
    check_distinguishable,
    check_interchanged,
)
from lightmatrix.check.finding import KINDS, Finding
from lightmatrix.check.survey import Survey
from lightmatrix.cli import main
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.patterns.stripes import MicroPhasePatterns
from tests.helpers.surface import CAMERA, PROJECTOR, photographs

K = 32


PATTERNS = BernoulliPatterns(PROJECTOR, K)


DECODER = lm.Decoder(clip=255, full_scale=255)


Frames = NDArray[np.uint8]


Found = list[tuple[str, tuple[int, ...]]]


def found(
    frames: Frames,
    patterns: lm.PatternSet = PATTERNS,
    decoder: lm.Decoder = DECODER,
    look: Callable[[lm.Capture], list[Finding]] = check_capture,
) -> Found:
    """What is found in the frames; by `lm.check`, which estimates T too, also of the rig."""
    findings = look(lm.Capture.from_arrays(patterns, frames, decoder))
    assert {each.kind for each in findings} <= set(KINDS)
    assert all(each.message and each.advice for each in findings)
    return [(each.kind, each.frames) for each in findings]


def swapped(frames: Frames) -> Frames:
    order = np.arange(K)
    order[[3, 9]] = 9, 3
    return frames[order]


def blackened(frames: Frames) -> Frames:
    return np.where(np.arange(K)[:, None, None] == 5, 0, frames).astype(np.uint8)


def replaced(frames: Frames) -> Frames:
    other = frames.copy()
    other[5] = np.random.default_rng(0).permutation(other[5].ravel()).reshape(CAMERA)
    return other


def shifted(frames: Frames) -> Frames:
    return np.concatenate([frames[:16], np.roll(frames[16:], 2, axis=2)])


def coded(frames: Frames) -> Frames:
    return np.rint(255 * (frames / 255.0) ** (1 / 2.2)).astype(np.uint8)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda frames: frames, []),
        (swapped, [("order", (3, 9))]),
        (blackened, [("frame", (5,))]),
        (replaced, [("frame", (5,))]),
        (shifted, [("motion", tuple(range(16, K)))]),
        (coded, [("camera-curve", ())]),
        (lambda frames: swapped(blackened(frames)), [("order", (3, 9)), ("frame", (5,))]),
    ],
    ids=["intact", "swapped", "black", "replaced", "shifted", "coded", "swapped and black"],
)
def test_faults_are_named(fault: Callable[[Frames], Frames], expected: Found) -> None:
    assert found(fault(photographs(PATTERNS)), look=lm.check) == expected


def test_light_that_changes() -> None:
    beat = 1 + 0.05 * np.sin(1 + 1.3 * np.arange(K))
    assert found(photographs(PATTERNS, gain=beat), look=lm.check) == [("gain", ())]
    one = np.where(np.arange(K) == 7, 1.1, 1.0)
    capture = lm.Capture.from_arrays(PATTERNS, photographs(PATTERNS, gain=one), DECODER)
    (finding,) = lm.check(capture)
    assert "in frame 7 (+" in finding.message


def test_a_bright_black_frame() -> None:
    frames = photographs(PATTERNS)
    black = lm.Decoder(clip=255, full_scale=255, black_frame=frames[0].ravel())
    assert "black" in [kind for kind, _ in found(frames, decoder=black)]


@pytest.mark.parametrize("kind", ["hadamard", "mix", "sparse"])
def test_other_patterns_are_left_alone(kind: str) -> None:
    patterns = {
        "hadamard": HadamardPatterns(PROJECTOR, 48, "random", True),
        "mix": lm.make_patterns("mix", PROJECTOR, 64),
        "sparse": BernoulliPatterns(PROJECTOR, 48, 0.25),
    }[kind]
    assert found(photographs(patterns, exposure=0.5), patterns) == []


def test_colour_is_left_alone() -> None:
    grey = photographs(PATTERNS)
    colour = np.rint(grey[..., None] * np.array([1, 0.8, 0.5])).astype(np.uint8)
    assert found(colour) == []


def test_jpeg_of_light_that_holds_to_a_hundredth_is_no_flicker() -> None:
    gain = 1 + 0.01 * np.random.default_rng(0).standard_normal(K)
    files = [encode_image(frame, "jpeg", quality=92) for frame in photographs(PATTERNS, gain=gain)]
    assert {kind for kind, _ in found(np.stack([decode_image(file) for file in files]))} <= {"jpeg"}


def test_exact_mixtures_of_twelve_lights_are_left_alone() -> None:
    """Photographs under each of a few lamps, which all camera pixels see, added up."""
    generator, shape = np.random.default_rng(0), (24, 32)
    slope = gaussian_filter(generator.normal(size=(2, *shape)), (0, 3, 3)).reshape(2, -1)
    normals = np.vstack([slope / slope.std(), np.ones(slope.shape[1])])
    angles = np.arange(12) * np.pi / 6
    lamps = np.stack([np.cos(angles), np.sin(angles), np.full(12, 1.5)], axis=1)
    lit = np.maximum(lamps @ (normals / np.linalg.norm(normals, axis=0)), 0)
    lit += 0.005 * generator.standard_normal(lit.shape)
    for count in (24, 48):
        patterns = BernoulliPatterns((3, 4), count, seed=count)
        mixed = patterns.rows(0, count) @ lit
        frames = np.rint(230 * np.clip(mixed / mixed.max(), 0, 1)).astype(np.uint8)
        assert found(frames.reshape(count, *shape), patterns) == []


# ---- the bundled scenes


@pytest.mark.parametrize(
    "fault",
    ["two frames swapped", pytest.param("JPEG at quality 60", marks=pytest.mark.slow)],
)
def test_faults_of_a_bundled_scene_are_named(fault: str) -> None:
    draws = (draw for draw in frame_checks.draws(40, seed=5) if draw.patterns.count == 32)
    draw = next(draw for draw in draws if draw.scene == "metal")
    findings, named = frame_checks.FAULTS[fault](draw, np.random.default_rng(1))
    assert named, [each.message for each in findings]


@pytest.mark.slow
def test_a_shift_is_named_though_photographs_seem_unrelated_to_their_patterns() -> None:
    draw = list(frame_checks.draws(7, seed=7))[-1]
    findings, named = frame_checks.FAULTS["shifted 2 px from the middle on"](
        draw, np.random.default_rng(6)
    )
    assert named, [each.message for each in findings]


def test_several_exposures_of_a_bundled_scene_are_left_alone() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    capture = lm.simulate("metal", patterns, exposure="0.4:0.5,0.1:0.5", leak=0.01, ambient=0.05)
    assert check_capture(capture) == []


MICRO = MicroPhasePatterns((64, 64))


def stack(capture: lm.Capture) -> np.ndarray:
    return np.stack([capture.frame(k) for k in range(capture.count)])


@pytest.mark.parametrize(
    ("scene", "seed", "rows", "cols"),
    [
        # In these parts of the projector, two of the patterns are nearly the same.
        ("metal", 0, slice(3, 19), slice(0, 32)),
        ("gripper", 0, slice(3, 19), slice(0, 32)),
        ("l_objects", 1, slice(28, 60), slice(22, 34)),
    ],
)
def test_fine_stripes_that_are_alike_in_a_part_of_the_projector_accuse_nothing(
    scene: str, seed: int, rows: slice, cols: slice
) -> None:
    capture = lm.simulate(scene, MICRO, seed=seed, noise=0.003)
    part = np.ascontiguousarray(stack(capture)[:, rows, cols])
    findings = check_capture(lm.Capture.from_arrays(MICRO, part, capture.decoder))
    assert [each.kind for each in findings if each.kind in ("order", "unrelated")] == []


def test_motion_is_named_from_the_same_frame_on_in_a_crop() -> None:
    patterns = lm.BernoulliPatterns((64, 64), 32)
    intact = lm.simulate("l_objects", patterns, noise=0.003, exposure=0.4)
    frames = stack(intact)
    frames[20:] = np.roll(frames[20:], 1, axis=2)
    capture = lm.Capture.from_arrays(patterns, frames, intact.decoder)
    whole = lm.check(capture)
    assert [each.kind for each in whole] == ["motion"]
    assert abs(whole[0].frames[0] - 20) <= 1
    assert lm.check(capture, crop=((10, 20), (24, 32))) == whole


def test_only_the_crop_must_see_light_of_the_projector() -> None:
    frames = np.full((32, 60, 72), 3, np.uint8)
    frames[:, 20 : 20 + CAMERA[0], 20 : 20 + CAMERA[1]] = photographs(PATTERNS)
    capture = lm.Capture.from_arrays(PATTERNS, frames, lm.Sensor())
    assert "unseen" in [each.kind for each in check_capture(capture)]
    assert check_capture(capture.crop((20, 20), CAMERA)) == []


# All pixels differ.
RANDOM = BernoulliPatterns((10, 10), 12, seed=9).images()


def message(images: NDArray[np.floating]) -> str:
    found = check_distinguishable(ImagePatterns(images.astype(np.float32)))
    assert len(found) < 2
    assert {each.kind for each in found} <= {"patterns", "stripes"}
    return found[0].message if found else ""


def test_stripes_in_both_directions_do_not() -> None:
    rows = np.repeat(RANDOM[:, :, :1], 10, axis=2)
    cols = np.repeat(RANDOM[:, :1], 10, axis=1)
    for stripes in (rows, cols, np.concatenate([rows, cols])):
        assert "stripes suffice" in message(stripes)
    # One pattern that varies along both is enough, but by more than 2 %.
    both = 0.9 * np.concatenate([rows, cols])
    both[5, 3, 3] += 0.01
    assert "stripes suffice" in message(both)
    both[5, 3, 3] += 0.02
    assert "stripes suffice" not in message(both)


def test_patterns_too_coarse_to_tell_neighbours_apart_are_named() -> None:
    """T of 32 x 32 pixels from 256 of these errs by 0.15, and no photograph shows it."""
    coarse = HadamardPatterns((32, 32), 256, "sequency")
    assert "nearly alike" in check_distinguishable(coarse)[0].message
    for kind, count in (("bernoulli", 16), ("random", 8), ("mix", 64), ("onepixel", 1024)):
        assert not check_distinguishable(make_patterns(kind, (32, 32), count))
    assert not check_distinguishable(HadamardPatterns((32, 32), 512, "sequency"))
    assert not check_distinguishable(HadamardPatterns((32, 32), 256, "random"))


def test_a_fifth_of_the_pixels_may_be_alike() -> None:
    for alike, fault in ((18, False), (24, True)):
        images = RANDOM.copy().reshape(12, -1)
        images[:, :alike:2] = images[:, 1:alike:2]
        found = message(images.reshape(12, 10, 10))
        assert bool(found) == fault
        if fault:
            assert f"{alike} % of the projector pixels look like another" in found


def interchanged(patterns: lm.PatternSet, frames: NDArray[np.uint8]) -> bool:
    camera = lm.Decoder(clip=255, full_scale=255)
    capture = lm.Capture.from_arrays(patterns, frames, camera)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder)
    found = check_interchanged(taken)
    assert [each.kind for each in found] in ([], ["interchanged"])
    return bool(found)


@pytest.mark.parametrize("frames", [3, 12])
def test_exchanged_folders(frames: int) -> None:
    noisy = np.random.default_rng(0).random((frames, 10, 10)).astype(np.float32)
    drawn = (RANDOM[:frames] * 255).astype(np.uint8)
    taken = (noisy * 255).astype(np.uint8)
    assert interchanged(ImagePatterns(noisy), drawn)
    assert not interchanged(ImagePatterns(noisy), taken)
    assert not interchanged(ImagePatterns(RANDOM[:frames]), drawn)
    assert not interchanged(BernoulliPatterns((10, 10), frames), drawn)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    frames = photographs(PATTERNS, noise=0.001)
    write_capture(tmp_path / "capture", PATTERNS, frames, sensor=lm.Sensor(0.9, read_noise=0.001))
    return tmp_path / "capture"


def run(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[dict[str, object]]]:
    code = main(["check", *words.split(), "--json"])
    found = json.loads(capsys.readouterr().out)["findings"]
    assert all(set(each) == {"kind", "frames", "message", "advice"} for each in found)
    return code, found


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(folder)]) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    images = sorted((folder / "images").iterdir())
    images[3].write_bytes(images[4].read_bytes())
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("order", [3])]
    assert found == [each.as_dict() for each in lm.check(folder)]
    images[3].unlink()
    code, found = run(f"--patterns {folder}/patterns --images {folder}/images", capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("counts", [3])]
    assert "31 photographs" in str(found[0]["message"])


def test_files_that_do_not_fit_together_are_findings(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = sorted((folder / "images").iterdir())
    for image in images[5:7]:
        lm.write_image(image, np.zeros((9, 9), np.uint8), overwrite=True)
    images[8].write_bytes(b"no image")
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [each["kind"] for each in found] == ["files", "files"]
    assert [each["frames"] for each in found] == [[5, 6], [8]]
    assert str(found[0]["message"]).endswith(", and 1 more like it")
    assert "more like it" not in str(found[1]["message"])


@pytest.mark.parametrize(
    ("misread", "message"),
    [
        (lambda frames: frames.astype(np.float32), "float with levels up to 255"),
        (lambda frames: (frames / 127.5 - 1).astype(np.float32), "half of the levels"),
        (lambda frames: 9 * frames.astype(np.uint16), "16 bits, but no level above"),
        (lambda frames: (frames * np.uint16(16)).byteswap(), "two bytes of each level are swapped"),
    ],
)
def test_levels_that_estimate_refuses_are_findings(
    folder: Path, misread: Callable[[Frames], NDArray[np.generic]], message: str
) -> None:
    for file in sorted((folder / "images").iterdir()):
        frame = misread(lm.read_image(file))
        file.unlink()
        lm.write_image(file.with_suffix(".tif"), frame)
    (finding,) = lm.check(patterns=folder / "patterns", images=folder / "images")
    assert finding.kind == "files"
    assert message in finding.message


def test_no_capture_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["nowhere"], ["--patterns", "p"], ["c", "--clip", "3"]):
        assert main(["check", *words]) == 2
        assert "error:" in capsys.readouterr().err
    with pytest.raises(lm.InputError):
        lm.check()
