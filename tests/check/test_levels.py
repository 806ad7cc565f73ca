"""Too much light, too little, black and white frames that are not so, and JPEG."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

import lightmatrix as lm
from benchmarks.synthetic_captures import SCENES, draw
from lightmatrix.capture.clip_level import find_pile
from lightmatrix.check import levels
from lightmatrix.check.all_checks import check_capture
from lightmatrix.check.levels import (
    check_clip_level,
    check_light_level,
    check_plain_frames,
    check_saturated,
    check_two_levels,
)
from lightmatrix.check.relation import check_unseen
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.judgement.judgement import Verdict
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.codes import find_codes
from lightmatrix.patterns.pattern_set import ImagePatterns

K, SIDE = 12, 20


CAMERA = lm.Decoder(clip=255, full_scale=255)


def captured(frames: NDArray[np.generic], decoder: lm.Decoder = CAMERA) -> lm.Capture:
    return lm.Capture.from_arrays(BernoulliPatterns((4, 4), len(frames)), frames, decoder)


def survey(frames: NDArray[np.generic], decoder: lm.Decoder = CAMERA) -> Survey:
    capture = captured(frames, decoder)
    return Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)


def kinds(frames: NDArray[np.uint8], decoder: lm.Decoder = CAMERA) -> list[str]:
    taken = survey(frames, decoder)
    return [each.kind for each in check_light_level(taken) + check_unseen(taken)[0]]


def random_frames(top: int = 200) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, top + 1, (K, SIDE, SIDE)).astype(np.uint8)


def test_a_frame_that_clips_all_over_is_white_unless_patterns_are_coarse() -> None:
    frames = random_frames()
    frames[4] = 255
    (found,) = check_saturated(survey(frames), str)
    assert found.message == "4: white, although the pattern is not"
    # The camera sees a part of coarse patterns, of which another is nearly white.
    frames[7, 2:] = 255
    assert not check_saturated(survey(frames), str)


def test_two_thirds_of_the_samples_may_clip() -> None:
    for share, found in ((0.64, []), (0.69, ["light"])):
        frames = random_frames()
        frames[:, : round(SIDE * share)] = 255
        # Rows of the image: 12.8 of 20 and 13.8 of 20.
        frames[:, : int(SIDE * share), :] = 255
        assert kinds(frames) == found


@pytest.mark.parametrize(
    ("kind", "scene", "exposure", "found"),
    [("graycode", "corner", 0.8, ["light"]), ("graycode", "corner", 0.5, []),
     ("graycode", "l_objects", 0.8, ["light"]), ("graycode", "metal", 0.8, []),
     ("graycode, inverse", "corner", 0.8, []), ("graycode, inverse", "corner", 1.6, ["light"]),
     ("phase", "corner", 0.8, ["light"]), ("phase", "gripper", 0.8, []),
     ("microphase", "l_objects", 0.8, ["light"]), ("microphase", "l_objects", 0.3, [])],
)  # fmt: skip
def test_overexposed_stripes_are_said_and_few_highlights_are_not(
    kind: str, scene: str, exposure: float, found: list[str]
) -> None:
    patterns = lm.make_patterns(kind.split(",")[0], (64, 64), inverse="inverse" in kind)
    capture = lm.simulate(scene, patterns, exposure=exposure, noise=0.003)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    told = check_light_level(taken, find_codes(patterns).codes)
    assert [each.kind for each in told] == found
    assert all("see are uncertain" in each.message for each in told)
    # Random patterns endure as much.
    assert check_light_level(taken) == []


@pytest.mark.parametrize(
    ("clip", "scale", "dtype", "end"),
    [(235, 1, "u1", 255), (128, 0.5, "u1", 255), (4031, 16, "u2", 4095), (0.951, 1 / 255, "f4", 1)],
)
def test_a_clip_level_below_the_stated_one_is_named_and_taken(
    clip: float, scale: float, dtype: str, end: float, tmp_path: Path
) -> None:
    whole = (np.random.default_rng(0).gamma(3, 60, (K, SIDE, SIDE)) + 5) * scale
    # A hot pixel lies above.
    whole[:, 0, 0] = np.inf
    sensor = lm.Decoder(clip=end, full_scale=end)

    def photographed(level: float) -> NDArray[np.generic]:
        seen = np.minimum(whole, level)
        seen[:, 0, 0] = end
        return np.ascontiguousarray((seen if dtype == "f4" else np.rint(seen)).astype(dtype))

    frames = photographed(clip)
    (found,), mended = check_clip_level(survey(frames, sensor))
    assert found.kind == "clip"
    assert f"clip={clip}, or" in found.advice
    assert check_clip_level(mended) == ([], mended)
    # Noise that ends below the level is no pile, and neither is the stated level.
    assert check_clip_level(survey(photographed(end), sensor))[0] == []
    np.save(tmp_path / "images.npy", frames)
    with pytest.warns(lm.LightMatrixWarning, match=f"exactly {clip}"):
        read = lm.Capture.from_folders(
            BernoulliPatterns((4, 4), K), tmp_path / "images.npy", lm.ReadSettings(clip="auto")
        )
    assert read.decoder.clip == pytest.approx(clip)
    assert not read.decoder.clip_assumed


def test_other_checks_judge_by_the_level_at_which_photographs_clip() -> None:
    intact = draw("textured", "random", "intact", 16, 1).capture
    frames = np.stack([intact.frame(k) for k in range(intact.count)])
    video = lm.Capture.from_arrays(intact.patterns, np.minimum(frames, 128), CAMERA)
    assert [each.kind for each in check_capture(video)] == ["clip"]


@pytest.mark.parametrize("scene", sorted(SCENES))
@pytest.mark.parametrize("damage", ["intact", "curve"])
def test_two_levels_do_not_test_linearity(scene: str, damage: str) -> None:
    """Where each camera pixel sees one projector pixel, T errs by 0.4 through a gamma of 2.2."""
    capture = draw(scene, "random", damage, 16, 1).capture

    def kinds(**settings: object) -> list[str]:
        decoder = lm.Decoder(clip=255, full_scale=255, **settings)  # type: ignore[arg-type]
        seen = Survey.take(capture.patterns, capture.frames, decoder)
        return [each.kind for each in check_two_levels(seen, high_variance_rows(seen))]

    assert kinds() == (["linearity"] if scene in ("permutation", "fibres") else [])
    assert kinds(exposure=np.tile([1.0, 0.9], 32)) == []
    assert kinds(response=lm.Response.parse("srgb")) == []


def test_what_could_not_be_tested_is_not_good() -> None:
    capture = draw("permutation", "random", "curve", 16, 1).capture
    assert [each.kind for each in check_capture(capture)] == ["linearity"]
    verdict = Verdict("good", 0.01)
    assert verdict.with_findings(["linearity"]).level == "fair"
    assert verdict.with_findings(["linearity", "order"]).level == "doubtful"


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_no_pile_is_seen_where_nothing_clips(scene: str) -> None:
    """Camera pixels that see one projector pixel, or stripes, have few distinct levels."""
    for patterns in ("random", "stripes", "one pixel"):
        drawn = draw(scene, patterns, "intact", 16, 1)
        light = drawn.truth.sparse @ drawn.capture.patterns.rows(0, drawn.capture.count).T
        raw = lm.Sensor(1.0, 0.0, 0.003).expose(0.8 * light / light.max(), seed=0)
        assert find_pile(raw) is None


@pytest.mark.parametrize("black", [0, 10])
def test_24_levels_above_black_are_enough(black: int) -> None:
    decoder = lm.Decoder(clip=255, full_scale=255, black_level=black)
    for top, found in ((22, ["light"]), (26, [])):
        frames = black + np.minimum(random_frames(2 * top), top)
        assert kinds(frames.astype(np.uint8), decoder) == found


def test_nothing_counts_where_all_is_masked() -> None:
    masked = replace(survey(random_frames()), valid=np.zeros(SIDE * SIDE, bool))
    found = check_light_level(masked)
    assert [each.kind for each in found] == ["light"]
    assert "no camera pixel counts" in found[0].message


def test_a_tenth_of_the_pixels_must_see_the_projector() -> None:
    for rows, found in ((1, ["unseen"]), (3, [])):
        frames = np.full((K, SIDE, SIDE), 20, np.uint8)
        frames[:, :rows] = random_frames()[:, :rows]
        assert kinds(frames) == found


# ---- black and white frames


def plain(
    level: float, white: float, *, patterns: tuple[float, float] = (0.0, 1.0), clips: bool = False
) -> list[str]:
    """Findings if the frames of a black and of a white pattern lie there in each pixel's range."""
    generator = np.random.default_rng(1)
    images = generator.integers(0, 2, (K, 4, 4)).astype(np.float32)
    images[3], images[7] = patterns
    frames = generator.choice([20, 220], (K, SIDE, SIDE))
    frames[0], frames[1] = 20, 220
    frames[3], frames[7] = 20 + 200 * level, 20 + 200 * white
    if clips:
        frames[7, 0, 0] = 255
    capture = lm.Capture.from_arrays(ImagePatterns(images), frames.astype(np.uint8), CAMERA)
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    found = check_plain_frames(taken, np.arange(40), [f"frame {k}" for k in range(K)])
    assert all(each.frames in ((3,), (7,)) for each in found)
    return [each.kind for each in found]


def test_black_and_white_frames_lie_at_the_ends_of_the_range() -> None:
    assert plain(0.0, 1.0) == []
    assert plain(0.12, 0.88) == []
    assert plain(0.2, 1.0) == ["black"]
    assert plain(0.0, 0.8) == ["white"]
    assert plain(0.2, 0.8) == ["black", "white"]
    # Nearly black and white patterns count as such, others do not.
    assert plain(0.2, 0.8, patterns=(0.015, 0.985)) == ["black", "white"]
    assert plain(0.2, 0.8, patterns=(0.03, 0.97)) == []


def test_frames_that_clip_may_be_white() -> None:
    assert plain(0.0, 0.8, clips=True) == []


def test_a_black_frame_must_be_the_darkest() -> None:
    frames = 40 + random_frames(150)
    names = ["x"] * K
    for level, found in ((40, []), (50, []), (90, ["black"])):
        decoder = replace(CAMERA, black_frame=np.full(SIDE * SIDE, level, np.float32))
        taken = replace(survey(frames), decoder=decoder)
        assert [f.kind for f in check_plain_frames(taken, np.arange(40), names)] == found
    # Without a black frame nothing is said of it.
    bright = replace(survey(frames), decoder=replace(CAMERA, black_level=90))
    assert check_plain_frames(bright, np.arange(40), names) == []


def smooth(count: int = 4, seed: int = 0) -> NDArray[np.uint8]:
    generator = np.random.default_rng(seed)
    levels = np.cumsum(generator.normal(0, 6, (count, 96, 96)), axis=2) + 128
    return np.rint(levels.clip(0, 255)).astype(np.uint8)


def compressed(frames: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    saved = [encode_image(f, "jpeg", quality=quality) for f in frames]
    return np.stack([decode_image(each) for each in saved])


def blocks_of(frames: NDArray[np.uint8]) -> NDArray[np.floating]:
    return levels._blocks(frames[:, None, ..., None].astype(np.float32))


@pytest.mark.parametrize("quality", [30, 60, 90])
def test_the_quality_is_measured(quality: int) -> None:
    measured = levels.likely_quality(blocks_of(compressed(smooth(), quality)))
    assert measured is not None
    assert abs(measured - quality) <= 2


def test_lossless_photographs_have_no_quality() -> None:
    assert levels.likely_quality(blocks_of(smooth())) is None
    few = blocks_of(compressed(smooth(), 60))
    assert levels.likely_quality(few[:39]) is None
    assert levels.likely_quality(few[:60]) is not None


def rounded(step: float, fine: float = 0, frequencies: int = 64) -> NDArray[np.float64]:
    """Blocks whose first coefficients, row by row, are rounded to a step; the others to `fine`."""
    blocks = np.random.default_rng(0).normal(128, 20, (400, 8, 8))
    coefficients = dctn(blocks, axes=(1, 2), norm="ortho")
    flat = coefficients.reshape(-1, 64)
    flat[:, :frequencies] = step * np.rint(flat[:, :frequencies] / step)
    if fine:
        flat[:, frequencies:] = fine * np.rint(flat[:, frequencies:] / fine)
    return np.rint(idctn(coefficients, axes=(1, 2), norm="ortho").clip(1, 254))


def test_steps_of_an_unknown_table_are_measured() -> None:
    assert levels.comb_step(rounded(11)) in (11, 12)
    assert levels.comb_step(rounded(11, frequencies=40)) in (11, 12)
    assert levels.comb_step(rounded(11, fine=7, frequencies=50)) in (11, 12)
    # Less than half of the frequencies on combs.
    assert levels.comb_step(rounded(11, frequencies=30)) is None
    assert levels.comb_step(np.random.default_rng(0).normal(128, 20, (400, 8, 8))) is None


def test_words_and_which_frames_are_looked_at() -> None:
    def check(frames: NDArray[np.generic], name: str = "a.png") -> list[str]:
        top = 255 if frames.dtype == np.uint8 else 65535
        camera = lm.Decoder(clip=top, full_scale=top)
        patterns = BernoulliPatterns((4, 4), len(frames))
        capture = lm.Capture.from_arrays(patterns, frames, camera)
        survey = Survey.take(capture.patterns, capture.frames, capture.decoder)
        return [each.message for each in levels.check_jpeg(survey, [name])]

    frames = compressed(smooth(), 60)
    assert check(frames) == [
        "the photographs went through JPEG of quality 60, whatever their files are now"
    ]
    assert check(frames, "A.JPG") == ["the photographs went through JPEG of quality 60"]
    assert check(frames.astype(np.uint16)) == []
    other_table = rounded(11).reshape(4, 10, 10, 8, 8).swapaxes(2, 3).reshape(4, 80, 80)
    (message,) = check(other_table.astype(np.uint8))
    assert message.startswith("the photographs went through JPEG with steps of about 1")
    assert check(frames[:, :7]) == []
    assert check(smooth()) == []
