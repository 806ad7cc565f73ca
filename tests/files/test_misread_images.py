"""Images that were once read as something else than they show, without a word."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

import lightmatrix as lm
from lightmatrix.files.image_stack import ImageStack

LEVELS = np.arange(12, dtype=np.uint8).reshape(3, 4) * np.uint8(20)


def photographs(folder: Path, count: int = 8) -> lm.Capture:
    """A capture whose frames lie as PNG files in `folder`."""
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), count))
    for k in range(count):
        lm.write_image(folder / f"{k}.png", capture.frame(k))
    return capture


@pytest.mark.parametrize("white", [255, 1023, 4095, 16383])
@pytest.mark.parametrize("form", ["npy", "folder"])
def test_patterns_of_fewer_bits_in_16_are_refused(tmp_path: Path, white: int, form: str) -> None:
    bits = lm.BernoulliPatterns((8, 8), 4).images(0, 4)
    levels = (bits * white).astype(np.uint16)
    if form == "npy":
        place = tmp_path / "patterns.npy"
        np.save(place, levels)
    else:
        place = tmp_path / "patterns"
        for k, image in enumerate(levels):
            lm.write_image(place / f"{k}.png", image)
    with pytest.raises(lm.InputError, match=f"16 bits, but no level above {white}") as refused:
        lm.read_patterns(place)
    assert "8 bits" in (refused.value.hint or "")


def test_dark_patterns_of_16_bits_and_of_float_are_read(tmp_path: Path) -> None:
    bits = lm.BernoulliPatterns((8, 8), 4).images(0, 4)
    np.save(tmp_path / "half.npy", (bits * 32768).astype(np.uint16))
    half = lm.read_patterns(tmp_path / "half.npy").images(0, 4)
    np.testing.assert_allclose(half, bits * np.float32(32768 / 65535))
    np.save(tmp_path / "dark.npy", (bits * np.float32(0.01)).astype(np.float32))
    dark = lm.read_patterns(tmp_path / "dark.npy").images(0, 4)
    np.testing.assert_allclose(dark, bits * np.float32(0.01))


def test_a_single_pattern_of_fewer_bits_is_warned_of(tmp_path: Path) -> None:
    lm.write_image(tmp_path / "a.png", LEVELS.astype(np.uint16) // 20 * 20 + np.uint16(35))
    with pytest.warns(lm.LightMatrixWarning, match="16 bits, but no level above 255"):
        lm.read_grey(tmp_path / "a.png")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_stack_in_which_0_is_white_is_turned_back(tmp_path: Path, dtype: type) -> None:
    stack: NDArray[Any] = np.stack([LEVELS, LEVELS[::-1]]).astype(dtype)
    top = np.iinfo(dtype).max
    tifffile.imwrite(tmp_path / "s.tif", top - stack, photometric="miniswhite", truncate=True)
    with tifffile.TiffFile(tmp_path / "s.tif") as tiff:
        assert (len(tiff.pages), tiff.series[0].shape) == (1, (2, 3, 4))
    frames = ImageStack.open(tmp_path / "s.tif")
    np.testing.assert_array_equal([frames.read(0), frames.read(1)], stack)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_tag_turns_no_tiff(tmp_path: Path, orientation: int) -> None:
    """Whichever library reads it."""
    for compression in ("raw", "tiff_lzw", "packbits", "tiff_adobe_deflate"):
        file = tmp_path / f"{compression}.tif"
        Image.fromarray(LEVELS).save(file, compression=compression, tiffinfo={274: orientation})
        np.testing.assert_array_equal(lm.read_image(file), LEVELS, err_msg=compression)


def test_a_jpeg_is_no_mask(tmp_path: Path) -> None:
    capture = photographs(tmp_path / "photos")
    mask = np.full((64, 64), 255, np.uint8)
    mask[10:23, 11:25] = 0
    Image.fromarray(mask).save(tmp_path / "mask.jpg", quality=80)
    assert (np.asarray(Image.open(tmp_path / "mask.jpg"))[10:23, 11:25] > 0).any()
    settings = lm.ReadSettings(mask=tmp_path / "mask.jpg")
    with pytest.raises(lm.InputError, match="is a JPEG, whose compression"):
        lm.Capture.from_folders(capture.patterns, tmp_path / "photos", settings)
    # One that compression left as it was.
    Image.fromarray(np.full((64, 64), 255, np.uint8)).save(tmp_path / "white.jpg", quality=95)
    settings = lm.ReadSettings(mask=tmp_path / "white.jpg")
    read = lm.Capture.from_folders(capture.patterns, tmp_path / "photos", settings)
    assert read.mask is not None
    assert read.mask.all()


def test_printing_colours_are_refused(tmp_path: Path) -> None:
    data = io.BytesIO()
    # Full black, which was taken for an opaque alpha channel.
    image = Image.new("CMYK", (8, 8), (0, 200, 100, 255))
    image.save(data, "JPEG")
    (tmp_path / "a.jpg").write_bytes(data.getvalue())
    with pytest.raises(lm.InputError, match="printing colours"):
        lm.read_image(tmp_path / "a.jpg")


def masked(values: NDArray[Any]) -> NDArray[Any]:
    wrapped: NDArray[Any] = np.ma.MaskedArray(values)
    wrapped[..., 0] = np.ma.masked
    return wrapped


def test_masked_values_are_refused(tmp_path: Path) -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    frames = np.stack([capture.frame(k) for k in range(8)])
    with pytest.raises(lm.InputError, match=r"frames with \d+ masked values"):
        lm.Capture.from_arrays(capture.patterns, masked(frames), capture.decoder)
    mask = masked(np.ones((64, 64), bool))
    with pytest.raises(lm.InputError, match=r"a mask with 64 masked values"):
        lm.Capture.from_arrays(capture.patterns, frames, capture.decoder, mask=mask)
    with pytest.raises(lm.InputError, match=r"patterns with \d+ masked values"):
        lm.ImagePatterns(masked(np.ones((4, 8, 8), np.float32)))
    # Without a masked value it is an array like any other.
    plain = np.ma.MaskedArray(frames)
    read = lm.Capture.from_arrays(capture.patterns, plain, capture.decoder)
    np.testing.assert_array_equal(read.samples().values, capture.samples().values)


def test_lights_and_patterns_must_be_finite_and_whole(tmp_path: Path) -> None:
    transport = lm.truth("metal").transport()
    lm.save(tmp_path / "s.zarr", transport)
    lights = np.ones(transport.camera_shape, np.float32)
    broken = lights.copy()
    broken[3, 4] = np.nan
    for matrix in (transport, lm.StoredTransport.open(tmp_path / "s.zarr")):
        with pytest.raises(lm.InputError, match="camera lights that are not all finite"):
            matrix.dual(broken)
        with pytest.raises(lm.InputError, match="camera lights with 64 masked values"):
            matrix.dual(masked(lights))
        with pytest.raises(lm.InputError, match="a pattern with 64 masked values"):
            matrix.relight(masked(np.ones(transport.projector_shape)))
