"""`decode`: the correspondence of a known scene from every code, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import lightmatrix as lm
from experiments.shape import Reference
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.capture.sensor import Sensor
from lightmatrix.check.all_checks import missing_places
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.patterns.codes import _bounded_place, find_codes
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

PROJECTOR, CAMERA = (40, 52), (34, 30)
CODES: dict[str, dict[str, Any]] = {
    "graycode": {},
    "graycode, inverse": {"inverse": True},
    "phase": {},
    "phase, inverse": {"inverse": True, "period": 6},
    "microphase": {"count": 14, "period": 8},
}


def code(name: str) -> PatternSet:
    return lm.make_patterns(name.split(",")[0], PROJECTOR, **CODES[name])


def places() -> tuple[np.ndarray, np.ndarray]:
    """The projector row and column that each camera pixel sees: a plane seen askew."""
    row, col = np.mgrid[: CAMERA[0], : CAMERA[1]].astype(float)
    return 3.2 + 0.9 * row + 0.11 * col, 5.3 - 0.07 * row + 1.2 * col


def photographs(patterns: PatternSet, *, noise: float = 0.002) -> np.ndarray:
    """Photographs of the plane under a texture, with light that no pattern changes."""
    generator = np.random.default_rng(1)
    texture = generator.uniform(0.3, 0.7, CAMERA)
    images = patterns.images()
    seen = np.stack([map_coordinates(image, places(), order=1) for image in images])
    light = texture * seen + 0.1 + noise * generator.standard_normal((len(images), *CAMERA))
    return np.asarray(light, np.float32)


def capture(patterns: PatternSet, frames: np.ndarray) -> lm.Capture:
    return lm.Capture.from_arrays(patterns, frames, Sensor(bits=None))


def errors(matches: lm.Correspondence) -> np.ndarray:
    return np.abs(matches.place - np.stack(places(), axis=-1)).max(axis=-1)


@pytest.mark.parametrize("name", CODES)
def test_every_code_places_a_pixel_to_a_fraction(name: str) -> None:
    patterns = code(name)
    matches = lm.decode(capture(patterns, photographs(patterns)))
    assert matches.valid.all()
    assert errors(matches).max() < 0.25
    assert matches.confidence.min() > 0.95
    assert matches.projector_shape == PROJECTOR
    # The stated uncertainty is that of the noise, to a factor of three.
    assert matches.uncertainty is not None
    stated, real = np.median(matches.uncertainty), np.sqrt((errors(matches) ** 2).mean())
    assert stated / 3 < real < 6 * stated


@pytest.mark.parametrize("name", ["graycode, inverse", "microphase"])
def test_any_order_and_plain_images_give_the_same(name: str) -> None:
    patterns = code(name)
    frames = photographs(patterns)
    usual = lm.decode(capture(patterns, frames))
    order = np.random.default_rng(5).permutation(patterns.count)
    mixed = ImagePatterns(patterns.images()[order])
    shuffled = lm.decode(capture(mixed, frames[order]))
    np.testing.assert_array_equal(shuffled.pixel, usual.pixel)
    np.testing.assert_allclose(shuffled.place, usual.place, atol=1e-3)


def test_columns_alone_leave_rows_unknown() -> None:
    patterns = code("graycode, inverse")
    columns = np.arange(12)
    matches = lm.decode(capture(patterns, photographs(patterns)).select(columns))
    assert matches.valid.all()
    assert (matches.pixel[..., 0] == -1).all()
    assert np.isnan(matches.place[..., 0]).all()
    assert np.abs(matches.place[..., 1] - places()[1]).max() < 0.25


def test_shadows_and_masked_pixels_see_nothing() -> None:
    patterns = code("graycode, inverse")
    frames = photographs(patterns)
    frames[:, :5] = 0.1
    mask = np.ones(CAMERA, bool)
    mask[:, :4] = False
    matches = lm.decode(lm.Capture.from_arrays(patterns, frames, Sensor(bits=None), mask=mask))
    assert not matches.valid[:5].any()
    assert not matches.valid[:, :4].any()
    assert matches.valid[5:, 4:].all()


def test_colour_cameras_are_decoded_by_the_sum_of_their_channels() -> None:
    patterns = code("phase")
    frames = photographs(patterns)
    coloured = frames[..., None] * np.array([0.5, 0.3, 0.2], np.float32)
    matches = lm.decode(capture(patterns, coloured))
    assert matches.valid.shape == CAMERA
    assert errors(matches).max() < 0.25


def test_files_hold_all_of_a_correspondence(tmp_path: Path) -> None:
    patterns = code("graycode")
    made = lm.decode(capture(patterns, photographs(patterns)), output=tmp_path / "c.npz")
    read = lm.read_correspondence(tmp_path / "c.npz")
    for name in ("pixel", "place", "confidence", "uncertainty", "light"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
    assert read.projector_shape == made.projector_shape


def test_what_is_no_code_is_refused(tmp_path: Path) -> None:
    patterns = code("graycode")
    whole = capture(patterns, photographs(patterns))
    with pytest.raises(InputError, match="tell only 32 of 52 columns apart, and some"):
        lm.decode(whole.select(np.arange(1, 6)))
    random = lm.BernoulliPatterns(PROJECTOR, 12)
    with pytest.raises(InputError, match="are no stripes") as refused:
        lm.decode(capture(random, photographs(random)))
    assert "`estimate`" in (refused.value.hint or "")
    with pytest.raises(InputError, match="no pattern varies"):
        lm.decode(whole.select([patterns.count - 1, patterns.count - 2]))
    lm.truth("metal").save(tmp_path / "T.npz")
    with pytest.raises(InputError, match="no correspondence"):
        lm.read_correspondence(tmp_path / "T.npz")


def order(count: int, fault: str) -> np.ndarray:
    """The frames of a capture with a fault of their order."""
    frames = np.arange(count)
    if fault == "swapped":
        frames[[1, 4]] = 4, 1
    if fault == "with its inverse":
        frames[[8, 9]] = 9, 8
    return {
        "late": np.roll(frames, 1),
        "late from 8": np.where(frames < 8, frames, frames - 1),
        "late from 4": np.where(frames < 4, frames, frames - 1),
        "fifth again": np.where(frames == 5, 4, frames),
        "third lost": np.minimum(np.where(frames < 2, frames, frames + 1), count - 1),
        "by name": np.array(sorted(frames, key=str)),
        "backwards": frames[::-1],
    }.get(fault, frames)


@pytest.mark.parametrize(
    ("name", "fault", "words"),
    [
        ("graycode", "swapped", "frame 1 and frame 4 look swapped"),
        ("graycode, inverse", "with its inverse", "frame 8 and frame 9 look swapped"),
        ("graycode, inverse", "late", "each photograph shows the pattern before its own"),
        ("graycode, inverse", "by name", "the order of their names as text"),
        ("phase", "swapped", "frame 1 and frame 4 look swapped"),
        ("phase", "late from 8", "from frame 8 to frame 15, each image shows the pattern before"),
        ("microphase", "swapped", "frame 1 and frame 4 look swapped"),
        ("graycode", "backwards", "the opposite order"),
        (
            "graycode",
            "late from 4",
            "from frame 4 to frame 13, each image shows the pattern before",
        ),
        ("phase", "fifth again", "frame 4 and frame 5 are the same photograph, to the last level"),
        ("graycode", "third lost", "to frame 12, each image shows the pattern after its own"),
    ],
)
def test_frames_out_of_order_are_refused_by_name(name: str, fault: str, words: str) -> None:
    patterns = code(name)
    frames = photographs(patterns)[order(patterns.count, fault)]
    wrong = capture(patterns, frames)
    with pytest.raises(InputError, match=words) as refused:
        lm.decode(wrong)
    assert "check=False" in (refused.value.hint or "")
    assert [each.kind for each in lm.check(wrong) if each.kind == "order"] == ["order"]


@pytest.mark.parametrize("name", CODES)
def test_a_copied_photograph_is_refused(name: str) -> None:
    """Any over any other: nothing tells which one is in its own place, and both are named."""
    patterns = code(name)
    plain = photographs(patterns)
    for frame, copied in np.random.default_rng(3).permutation(patterns.count)[:6].reshape(3, 2):
        frames = plain.copy()
        frames[copied] = frames[frame]
        with pytest.raises(InputError, match=r"same photograph|shows the pattern") as refused:
            lm.decode(capture(patterns, frames))
        assert f"frame {copied}" in refused.value.message
    # Rendered photographs have no noise, and all that a camera sees of two patterns may be white.
    part = photographs(patterns, noise=0)[:, 6:32, 2:28]
    found = lm.check(capture(patterns, part))
    assert not [each for each in found if "same photograph" in each.message]
    # Frames of one pattern may be alike, and so may those in which all is dark.
    twice = patterns.subset(np.append(np.arange(patterns.count), 0))
    found = lm.check(capture(twice, np.concatenate([plain, plain[:1]])))
    assert not [each for each in found if "same photograph" in each.message]


@pytest.mark.parametrize(
    ("name", "frame", "shown"),
    [
        *(
            (name, *both)
            for name in ("graycode", "phase", "microphase")
            for both in ((1, 4), (5, 3))
        ),
        ("graycode, inverse", 1, 4),
        ("graycode, inverse", 2, 8),
    ],
)
def test_a_photograph_of_another_pattern_is_refused(name: str, frame: int, shown: int) -> None:
    """Also one that was taken anew, whose levels are not those of the other."""
    patterns = code(name)
    frames = photographs(patterns)
    frames[frame] = photographs(patterns, noise=0.003)[shown]
    with pytest.raises(InputError, match=f"frame {frame}"):
        lm.decode(capture(patterns, frames))


@pytest.mark.parametrize("name", ["graycode", "phase", "microphase"])
@pytest.mark.parametrize("factor", [0.6, 1, 1.4])
def test_a_photograph_of_other_light_is_named(name: str, factor: float) -> None:
    patterns = code(name)
    frames = photographs(patterns)
    frames[3] *= np.float32(factor)
    found = [each for each in lm.check(capture(patterns, frames)) if not each.is_note]
    assert [(each.kind, each.frames) for each in found] == [("gain", (3,))] * (factor != 1)
    assert all(f"frame 3 ({'-' if factor < 1 else '+'}" in each.message for each in found)


@pytest.mark.parametrize("name", ["graycode", "phase", "microphase"])
@pytest.mark.parametrize("gamma", [0.45, 2.2])
def test_a_curve_that_is_not_stated_is_named(name: str, gamma: float) -> None:
    """A camera brightens greys, a projector darkens them; Gray code has none."""
    patterns = code(name)
    found = lm.check(capture(patterns, photographs(patterns) ** np.float32(gamma)))
    curve = "camera-curve" if gamma < 1 else "projector-curve"
    expected = [] if name == "graycode" else [curve]
    assert [each.kind for each in found if not each.is_note] == expected


@pytest.mark.parametrize("flipped", [False, True])
def test_a_mirrored_image_is_said(flipped: bool) -> None:
    patterns, frames = code("graycode, inverse"), photographs(code("graycode, inverse"))
    if flipped:
        frames = frames[:, :, ::-1]
    else:
        # The coarsest pattern and its inverse: all else fits a mirrored projector as well.
        frames[[0, 1]] = frames[[1, 0]]
    with pytest.warns(LightMatrixWarning, match="sees the projector's image mirrored"):
        lm.decode(capture(patterns, frames))
    assert "mirrored" not in [each.kind for each in lm.check(capture(patterns, frames[:, ::-1]))]


@pytest.mark.parametrize("exposure", [0.2, 1.5])
def test_a_code_without_inverses_of_a_corner_is_in_order(exposure: float) -> None:
    """White that takes the place of black makes all pixels see the same line."""
    patterns = make_patterns("graycode", (64, 64))
    taken = lm.simulate("corner", patterns, exposure=exposure, noise=0.003)
    assert [each.kind for each in lm.check(taken) if each.kind != "light"] == ["stripes"]


@pytest.mark.parametrize(
    ("name", "lost", "named"),
    [
        ("graycode", 3, "3"),
        # A Gray code without its finest bit is one without its coarsest bit, half as large.
        ("graycode", 5, "0 or 5"),
        ("graycode, inverse", 7, "6 or 7"),
        ("phase", 6, "6"),
        ("microphase", 9, "9"),
    ],
)
def test_a_lost_frame_is_named(name: str, lost: int, named: str) -> None:
    patterns = code(name)
    frames = np.delete(photographs(patterns), lost, axis=0)
    survey = Survey.take(patterns, ArrayStack(frames), Sensor(bits=None).decoder())
    places = missing_places(survey)
    assert " or ".join(map(str, places)) == named


def test_a_lost_frame_of_a_corner_is_named() -> None:
    """The dark photograph in place of the white one must not make all pixels see one line."""
    patterns = make_patterns("graycode", (64, 64))
    taken = lm.simulate("corner", patterns, exposure=0.2, noise=0.003)
    frames = np.stack([taken.frames.read(k) for k in range(patterns.count) if k != 3])
    assert missing_places(Survey.take(patterns, ArrayStack(frames), taken.decoder)) == (3,)


@pytest.mark.parametrize(
    ("name", "frame"), [("graycode", 0), ("graycode", 3), ("graycode", 5), ("graycode", 8),
                        ("phase", 3), ("microphase", 3)],
)  # fmt: skip
@pytest.mark.parametrize("part", [False, True])
@pytest.mark.parametrize("grey", ["white", "black"])
def test_a_white_or_black_photograph_is_named(name: str, frame: int, part: bool, grey: str) -> None:
    """Also where the camera sees a part of the image, in which some patterns are so."""
    patterns = code(name)
    seen = np.s_[:, 6:32, 2:28] if part else np.s_[:]
    frames = photographs(patterns)
    plain = [each.kind for each in lm.check(capture(patterns, frames[seen]))]
    level = np.full((1, *PROJECTOR), grey == "white", np.float32)
    frames[frame] = photographs(ImagePatterns(level), noise=0.003)[0]
    told = [each.message for each in lm.check(capture(patterns, frames[seen]))]
    assert f"frame {frame}: {grey}, although the pattern is not" in told
    assert "frame" not in plain


@pytest.mark.parametrize("name", CODES)
def test_a_photograph_that_clips_all_over_is_named_alone(name: str) -> None:
    patterns = code(name)
    frames = photographs(patterns)
    frames[4] = 1.5
    (found,) = [each for each in lm.check(capture(patterns, frames)) if not each.is_note]
    assert found.message == "frame 4: white, although the pattern is not"


def test_noise_and_darkness_are_refused_and_leave_no_file(tmp_path: Path) -> None:
    patterns = code("graycode, inverse")
    random = np.random.default_rng(0)
    noise = random.random((patterns.count, *CAMERA)).astype(np.float32)
    with pytest.raises(InputError, match="have nothing to do with each other"):
        lm.decode(capture(patterns, noise))
    grey = np.asarray(0.4 + 0.004 * (noise - 0.5), np.float32)
    with pytest.raises(InputError, match="no camera pixel sees the projector"):
        lm.decode(capture(patterns, grey), check=False, output=tmp_path / "c.npz")
    assert not list(tmp_path.iterdir())
    deep = lm.Capture.from_arrays(
        patterns,
        (4095 * photographs(patterns)).astype(np.uint16),
        lm.Decoder(clip=65535, full_scale=65535),
    )
    with pytest.raises(InputError, match="clips at 4095"):
        lm.decode(replace(deep, decoder=replace(deep.decoder, clip_assumed=True)))


def test_wrong_places_contradict_their_neighbours() -> None:
    patterns = code("graycode, inverse")
    frames = photographs(patterns)
    right = lm.decode(capture(patterns, frames))
    # In a corner, a bit is wrong at random, which nothing but its neighbours can tell.
    flipped = np.random.default_rng(0).random((12, 12)) < 0.2
    frames[2:4, :12, :12] = np.where(flipped, frames[[3, 2], :12, :12], frames[2:4, :12, :12])
    wrong = lm.decode(capture(patterns, frames))
    apart = np.abs(wrong.place - right.place).max(axis=2) > 4
    assert apart.sum() > 15
    assert wrong.confidence[apart].mean() < 0.7
    assert wrong.confidence[15:, 15:].min() > 0.95


@pytest.mark.parametrize("name", ["graycode", "microphase"])
@pytest.mark.parametrize("jpeg", [False, True])
def test_pixels_that_see_nothing_get_no_place(name: str, jpeg: bool) -> None:
    patterns = code(name)
    frames = photographs(patterns)
    noise = 0.01 * np.random.default_rng(3).standard_normal((patterns.count, 34, 12))
    frames[:, :, :12] = np.float32(0.2) + noise.astype(np.float32)
    shown = capture(patterns, frames)
    if jpeg:
        levels = np.rint(255 * frames.clip(0, 1)).astype(np.uint8)
        files = [encode_image(each, "jpeg", quality=90) for each in levels]
        shown = lm.Capture.from_arrays(
            patterns, np.stack([decode_image(each) for each in files]), Sensor(bits=8)
        )
    matches = lm.decode(shown, check=False)
    # Blocks of 8 x 8 pixels lie across the border, and ring.
    assert matches.valid[:, : 8 if jpeg else 12].mean() < 0.01
    assert matches.valid[:, 16:].mean() > 0.99


def test_codes_of_blocks_place_pixels_to_blocks() -> None:
    patterns = code("graycode, inverse")
    stripes = patterns.stripes  # type: ignore[attr-defined]
    finest = [np.flatnonzero(stripes.axes == axis)[-2:] for axis in (0, 1)]
    kept = np.setdiff1d(np.arange(patterns.count), np.concatenate(finest))
    whole = capture(patterns, photographs(patterns))
    with pytest.warns(lm.LightMatrixWarning, match="blocks of 4 and 4|blocks of 2 and 2"):
        matches = lm.decode(whole.select(kept))
    assert matches.valid.all()
    assert matches.projector_shape == PROJECTOR
    assert matches.uncertainty is not None
    assert 0.3 < np.sqrt((errors(matches) ** 2).mean()) < 1.0
    assert 0.45 < np.median(matches.uncertainty) < 0.9
    binned = lm.decode(whole.select(kept).bin(projector=2))
    np.testing.assert_allclose(2 * binned.place + 0.5, matches.place, atol=0.2)


@pytest.mark.parametrize(
    ("kind", "block", "most"),
    [("graycode", 4, 0.5), ("graycode", 8, 1.0), ("phase", 2, 0.1), ("phase", 4, 0.15),
     ("microphase", 8, 0.3)],
)  # fmt: skip
def test_what_the_camera_does_not_resolve_widens_the_place(
    kind: str, block: int, most: float
) -> None:
    known = lm.truth("corner")
    patterns = lm.make_patterns(kind, (64, 64), inverse=kind == "graycode")
    fine = lm.simulate(known, patterns, exposure=0.2)
    places = lm.correspondence(known.transport()).place
    matches = lm.decode(fine.bin(camera=block), check=False)
    true = places.reshape(64 // block, block, 64 // block, block, 2)
    plain = (np.ptp(true, axis=(1, 3)) < 1.5 * block).all(axis=-1) & matches.valid
    error = (matches.place - true.mean(axis=(1, 3)))[plain]
    assert matches.uncertainty is not None
    stated = matches.uncertainty[plain]
    assert plain.mean() > 0.7
    root = float(np.sqrt((error**2).mean()))
    assert root < most
    assert (np.abs(error) > 3 * stated).mean() < (0.05 if kind == "microphase" else 0.01)
    assert root < np.sqrt((stated**2).mean()) < block / 2
    if kind == "graycode":
        # A block of pixels is known to its width.
        assert np.sqrt((stated**2).mean()) > block / 8


def test_patterns_in_colour_are_no_threefold_projector() -> None:
    patterns = lm.colour_bernoulli((8, 8), 12)
    frames = np.random.default_rng(0).random((12, 9, 9)).astype(np.float32)
    with pytest.raises(InputError, match="in colour"):
        lm.decode(lm.Capture.from_arrays(patterns, frames, Sensor(bits=None)))


def test_estimates_of_stripes_point_here() -> None:
    patterns = lm.make_patterns("graycode", (16, 16), inverse=True)
    light = np.tile(np.linspace(0.2, 0.8, patterns.count)[:, None, None], (1, 4, 4))
    frames = np.asarray(light * patterns.images()[:, 4:8, 4:8], np.float32)
    with pytest.warns(LightMatrixWarning, match="stripes suffice for correspondence and shape"):
        lm.estimate(capture(patterns, frames), coherent=False)


@pytest.mark.parametrize("brighter", [1.5, 2.0, 2.5])
@pytest.mark.parametrize("name", CODES)
def test_places_are_as_uncertain_as_clipped_samples_leave_them(name: str, brighter: float) -> None:
    patterns = code(name)
    frames = np.minimum(brighter * photographs(patterns), 1)
    matches = lm.decode(capture(patterns, frames), check=False)
    assert (frames == 1).mean() > 0.05
    assert matches.uncertainty is not None
    known, error = matches.valid, np.abs(matches.place - np.stack(places(), axis=-1))
    assert known.mean() > (0.5 if name == "microphase" else 0.99)
    assert (error > 3 * matches.uncertainty)[known].mean() < 0.03
    if name != "microphase":
        # No bit is wrong, and most places are known to a fraction.
        assert error[known].max() < 0.6
        assert np.sqrt((error[known] ** 2).mean()) < 0.17
    if name == "graycode":
        # What is left open lowers the confidence.
        open_ = known & np.any(matches.uncertainty > 0.2, axis=-1)
        assert not open_.any() or matches.confidence[open_].max() < 0.4


@pytest.mark.parametrize("name", CODES)
def test_pixels_that_clip_change_no_other(name: str) -> None:
    patterns = code(name)
    frames = photographs(patterns)
    usual = lm.decode(capture(patterns, frames), check=False)
    frames[:, :, 15:] = np.minimum(2.5 * frames[:, :, 15:], 1)
    partly = lm.decode(capture(patterns, frames), check=False)
    for part in ("pixel", "place", "uncertainty", "light"):
        kept = np.s_[:, :15]
        np.testing.assert_array_equal(getattr(partly, part)[kept], getattr(usual, part)[kept])


def test_bounds_leave_open_what_they_do_not_tell() -> None:
    """A camera pixel sees three quarters of line 12, and a quarter of line 13."""
    found = find_codes(lm.make_patterns("phase", (32, 32))).codes[0]
    exact = 0.75 * found.values[12] + 0.25 * found.values[13]
    samples = np.float32(0.9) * exact[None] + np.float32(0.1)
    free = np.ones(samples.shape, bool)
    near = [np.array([13])]
    # A bound below the sample tells as much as the sample, as long as others tell the place.
    brightest = int(samples[0].argmax())
    bound, seen = samples.copy(), free.copy()
    bound[0, brightest], seen[0, brightest] = 0.7, False
    for values, which in ((samples, free), (bound, seen)):
        mean, spread = _bounded_place(found, values, which, near)
        assert mean[0] == pytest.approx(12.25, abs=0.02)
        assert spread[0] < 0.1
    # Bits whose bright samples are all bounds say which lines, but not how much of each.
    found = find_codes(lm.make_patterns("graycode", (32, 32))).codes[0]
    samples = (0.75 * found.values[12] + 0.25 * found.values[13])[None]
    assert sorted(set(samples[0].tolist()))[1:-1] == [0.25]
    mean, spread = _bounded_place(found, np.minimum(samples, 0.5), samples < 0.5, [np.array([12])])
    assert 0.1 < spread[0] < 0.5
    assert abs(mean[0] - 12.25) < 2 * spread[0]


@pytest.mark.parametrize(
    ("kind", "wrong", "right"),
    [("graycode", 0.15, 2000), ("phase", 0.035, 3500), ("microphase", 0.15, 2900)],
)
def test_points_of_overexposed_stripes_are_as_probable_as_right(
    kind: str, wrong: float, right: int
) -> None:
    """Before clipped samples were bounds: 41, 16 and 38 % wrong, at 0.99 26, 0.6 and 12 %."""
    known = lm.truth("corner")
    assert known.geometry is not None
    patterns = lm.make_patterns(kind, (64, 64))
    with pytest.warns(LightMatrixWarning, match=r"places that 9\d % of the pixels see"):
        matches = lm.decode(lm.simulate(known, patterns, exposure=0.8, noise=0.003))
    shape = lm.triangulate(matches, known.geometry)
    exact = Reference.of(known).depths
    apart = np.abs(shape.depth[..., None] - exact) / exact
    good, kept = np.fmin.reduce(apart, axis=-1) <= 0.01, shape.kept
    sure = kept & (shape.probability >= 0.99)
    assert (kept & ~good).sum() < wrong * kept.sum()
    assert (kept & good).sum() > right
    # Bounces mislead micro phase shifts as much without clipping.
    assert (sure & ~good).sum() <= (70 if kind == "microphase" else 3)
