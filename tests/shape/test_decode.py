"""`decode`: the correspondence of a known scene from every code, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import lightmatrix as lm
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError, LightMatrixWarning
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
    with pytest.raises(InputError, match="tell only 26 of 52 columns apart"):
        lm.decode(whole.select(np.arange(5)))
    random = lm.BernoulliPatterns(PROJECTOR, 12)
    with pytest.raises(InputError, match="are no stripes") as refused:
        lm.decode(capture(random, photographs(random)))
    assert "`estimate`" in (refused.value.hint or "")
    with pytest.raises(InputError, match="no pattern varies"):
        lm.decode(whole.select([patterns.count - 1, patterns.count - 2]))
    lm.truth("metal").save(tmp_path / "T.npz")
    with pytest.raises(InputError, match="no correspondence"):
        lm.read_correspondence(tmp_path / "T.npz")


def test_estimates_of_stripes_point_here() -> None:
    patterns = lm.make_patterns("graycode", (16, 16), inverse=True)
    light = np.tile(np.linspace(0.2, 0.8, patterns.count)[:, None, None], (1, 4, 4))
    frames = np.asarray(light * patterns.images()[:, 4:8, 4:8], np.float32)
    with pytest.warns(LightMatrixWarning, match="fine for correspondence and shape"):
        lm.estimate(capture(patterns, frames), coherent=False)
