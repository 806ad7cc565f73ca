"""Image files come back as they were stored; broken ones are named, never guessed at."""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files import png, reading
from lightmatrix.files.image_stack import ImageStack, list_images, nonlinear_tag
from lightmatrix.files.images import read_grey, read_image, write_image
from tests.helpers.limits import largest_file
from tests.helpers.systems import LIMITS

if sys.platform != "win32":
    pass


def noise(shape: tuple[int, ...], dtype: Any, seed: int = 0) -> NDArray[Any]:
    generator = np.random.default_rng(seed)
    if np.dtype(dtype).kind == "f":
        return generator.random(shape).astype(dtype)
    return generator.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".npy"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (4, 9, 3), (3, 1, 3)])
def test_integer_images_round_trip(
    tmp_path: Path, suffix: str, dtype: Any, shape: tuple[int, ...]
) -> None:
    image = noise(shape, dtype)
    file = tmp_path / f"image{suffix}"
    write_image(file, image)
    back = read_image(file)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]


@pytest.mark.parametrize("suffix", [".tif", ".npy"])
def test_float_images_round_trip(tmp_path: Path, suffix: str) -> None:
    image = noise((6, 5), np.float32) * 3
    write_image(tmp_path / f"image{suffix}", image)
    np.testing.assert_array_equal(read_image(tmp_path / f"image{suffix}"), image)


def test_float_images_as_png_use_the_full_range_and_cut_off(tmp_path: Path) -> None:
    image = np.array([[0.0, 0.5, 1.0, 1.7, -0.2]], np.float32)
    write_image(tmp_path / "a.png", image)
    write_image(tmp_path / "b.png", image, bits=16)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), [[0, 128, 255, 255, 0]])
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), [[0, 32768, 65535, 65535, 0]])


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 4), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_every_line_filter_of_16_bit_colour_png(rows: int, cols: int, kind: int, seed: int) -> None:
    """Filter lines by the specification's definition, pixel by pixel, and decode them."""
    image = noise((rows, cols, 3), np.uint16, seed)
    plain = image.astype(">u2").view(np.uint8).reshape(rows, cols * 6).astype(int)
    lines = np.zeros((rows, 1 + cols * 6), np.uint8)
    for r in range(rows):
        lines[r, 0] = (kind + r) % 5
        for c in range(cols * 6):
            left = plain[r, c - 6] if c >= 6 else 0
            up = plain[r - 1, c] if r else 0
            corner = plain[r - 1, c - 6] if r and c >= 6 else 0
            nearest = min((left, up, corner), key=lambda v: abs(left + up - corner - v))
            predicted = (0, left, up, (left + up) // 2, nearest)[lines[r, 0]]
            lines[r, 1 + c] = (plain[r, c] - predicted) % 256
    header = struct.pack(">IIBBBBB", cols, rows, 16, 2, 0, 0, 0)
    data = png.write_chunks((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes())))
    chunks = png.read_chunks(data)
    assert png.read_png_header(chunks).is_deep_colour
    # As a whole, and some lines at a time, each of which needs the line before it.
    for at_once in (1 << 25, 12 * cols + 2):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(png, "_DECODED_AT_ONCE", at_once)
            np.testing.assert_array_equal(png.decode_deep_colour(chunks), image)


def test_a_palette_counts_as_the_colours_that_it_becomes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    colours = noise((4, 6, 3), np.uint8)
    Image.fromarray(colours).quantize(16).save(tmp_path / "a.bmp")
    monkeypatch.setattr(reading, "MOST_VALUES", colours.size)
    assert read_image(tmp_path / "a.bmp").shape == colours.shape
    monkeypatch.setattr(reading, "MOST_VALUES", colours.size - 1)
    with pytest.raises(InputError, match="4 x 6 x 3 values"):
        read_image(tmp_path / "a.bmp")


def test_black_and_white_and_opaque_alpha(tmp_path: Path) -> None:
    grey = noise((4, 6), np.uint8)
    opaque = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    Image.fromarray(opaque).save(tmp_path / "opaque.png")
    np.testing.assert_array_equal(read_image(tmp_path / "opaque.png"), opaque[..., :3])
    opaque[0, 0, 3] = 7
    Image.fromarray(opaque).save(tmp_path / "clear.png")
    with pytest.raises(InputError, match="transparent"):
        read_image(tmp_path / "clear.png")
    Image.fromarray(grey > 99).save(tmp_path / "bits.png")
    np.testing.assert_array_equal(read_image(tmp_path / "bits.png"), (grey > 99) * np.uint8(255))


def test_pgm_levels_come_back_as_stored(tmp_path: Path) -> None:
    levels = np.array([[0, 1, 4095], [7, 300, 2]], np.uint16)
    header = b"P5\n# by a camera\n3 2\n4095\n"
    (tmp_path / "a.pgm").write_bytes(header + levels.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.pgm"), levels)
    assert read_image(tmp_path / "a.pgm").dtype == np.uint16
    small = levels.clip(0, 255).astype(np.uint8)
    (tmp_path / "b.pgm").write_bytes(b"P5 3 2 255 " + small.tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "b.pgm"), small)
    for damaged in (
        b"P2 1 1 255 7", b"P5 3 2", b"P5 3 2 255 abc", b"P5 1 1 9 z", b"P5 1 1 70000 abcd",
        b"P5 1 1 255 ab", b"P5 0 1 255 ", b"P5 999999999 999999999 255 a",
    ):  # fmt: skip
        (tmp_path / "c.pgm").write_bytes(damaged)
        with pytest.raises(InputError, match=r"c\.pgm"):
            read_image(tmp_path / "c.pgm")


def test_grey_images_in_three_channels_are_read_as_one(tmp_path: Path) -> None:
    frames = [noise((12, 10), np.uint8) // (k + 1) for k in range(5)]
    frames[0][:] = 0
    for k, frame in enumerate(frames):
        write_image(tmp_path / f"{k}.png", np.repeat(frame[..., None], 3, axis=2))
    stack = ImageStack.open(tmp_path)
    assert stack.shape == (12, 10)
    np.testing.assert_array_equal(list(stack.select([3, 1])), [frames[3], frames[1]])
    # One in colour among those that were not looked at.
    coloured = np.repeat(frames[2][..., None], 3, axis=2)
    coloured[0, 0] = 1, 2, 3
    write_image(tmp_path / "2.png", coloured, overwrite=True)
    with pytest.raises(InputError, match=r"2\.png: is in colour"):
        list(ImageStack.open(tmp_path))
    write_image(tmp_path / "4.png", coloured, overwrite=True)
    assert ImageStack.open(tmp_path).shape == (12, 10, 3)


def test_compressed_and_big_endian_tiff(tmp_path: Path) -> None:
    image = noise((20, 30), np.uint16)
    tifffile.imwrite(tmp_path / "zip.tif", image, compression="zlib")
    tifffile.imwrite(tmp_path / "big.tif", image, byteorder=">")
    for name in ("zip.tif", "big.tif"):
        np.testing.assert_array_equal(read_image(tmp_path / name), image)
        assert read_image(tmp_path / name).dtype == np.uint16


def test_patterns_are_read_over_the_full_range(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.array([[0, 51, 255]], np.uint8))
    np.testing.assert_allclose(read_grey(tmp_path / "a.png"), [[0, 0.2, 1]], rtol=1e-6)
    write_image(tmp_path / "b.tif", np.array([[0, 65535]], np.uint16))
    np.testing.assert_allclose(read_grey(tmp_path / "b.tif"), [[0, 1]])
    write_image(tmp_path / "c.png", np.full((2, 2, 3), 255, np.uint8))
    np.testing.assert_allclose(read_grey(tmp_path / "c.png"), np.ones((2, 2)))


def truncated(path: Path, share: float = 0.6) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


BAD_FILES = {
    "missing.png": "no such file",
    "folder.png": "is a folder, not an image file",
    "raw.x3f": "files ending in .x3f are not read",
    "empty.png": "is empty",
    "text.png": "cannot be read as an image",
    "half.png": "damaged or truncated",
    "half16.png": "damaged or truncated",
    "half.tif": "damaged or truncated",
    "half.npy": "damaged or truncated",
    "nan.npy": r"the value at \(1, 2\) is nan",
    "inf.tif": r"the value at \(0, 0\) is inf",
    "stack.npy": r"holds an array of shape \(2, 3, 5\)",
    "wide.npy": "holds int64 values",
    "pages.tif": "holds 2 pages",
    "object.npy": "cannot be read as an image",
}


@pytest.fixture(scope="module")
def bad_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bad")
    (folder / "folder.png").mkdir()
    (folder / "raw.x3f").write_bytes(b"raw")
    (folder / "empty.png").touch()
    (folder / "text.png").write_text("not an image")
    image = noise((40, 50), np.uint8)
    write_image(folder / "half.png", image)
    write_image(folder / "half16.png", noise((40, 50, 3), np.uint16))
    write_image(folder / "half.tif", image)
    write_image(folder / "half.npy", image)
    for name in ("half.png", "half16.png", "half.tif", "half.npy"):
        truncated(folder / name)
    values = noise((3, 4), np.float32)
    values[1, 2] = np.nan
    np.save(folder / "nan.npy", values)
    tifffile.imwrite(folder / "inf.tif", np.full((2, 2), np.inf, np.float32))
    np.save(folder / "stack.npy", np.zeros((2, 3, 5), np.uint8))
    np.save(folder / "wide.npy", np.arange(12).reshape(3, 4))
    tifffile.imwrite(folder / "pages.tif", np.zeros((2, 8, 9), np.uint8), photometric="minisblack")
    np.save(folder / "object.npy", np.array([[{}]], object), allow_pickle=True)
    return folder


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_named(bad_files: Path, name: str) -> None:
    with pytest.raises(InputError, match=BAD_FILES[name]) as caught:
        read_image(bad_files / name)
    assert name in caught.value.message
    assert "index out of range" not in caught.value.message


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
def test_no_truncation_is_read_as_an_image(tmp_path: Path, suffix: str, share: float) -> None:
    file = tmp_path / f"image{suffix}"
    write_image(file, noise((50, 60), np.uint16))
    truncated(file, share)
    with pytest.raises(InputError, match="truncated"):
        read_image(file)


def test_natural_order_and_passed_over_files(tmp_path: Path) -> None:
    names = ["frame_10.png", "frame_2.png", "frame_1.png", "Frame_3.png"]
    for name in [*names, ".hidden.png"]:
        write_image(tmp_path / name, noise((2, 2), np.uint8))
    (tmp_path / "notes.txt").write_text("passed over")
    names = [path.name for path in list_images(tmp_path)]
    assert names == ["frame_1.png", "frame_2.png", "Frame_3.png", "frame_10.png"]


def test_folders_that_are_no_stacks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        list_images(tmp_path / "nothing")
    (tmp_path / "clip.mp4").touch()
    with pytest.raises(InputError, match=r"holds no images, only \.mp4 files"):
        list_images(tmp_path)
    with pytest.raises(InputError, match="is a file, not a folder"):
        list_images(tmp_path / "clip.mp4")
    write_image(tmp_path / "a.png", noise((2, 2), np.uint8))
    write_image(tmp_path / "a.tif", noise((2, 2), np.uint8))
    with pytest.raises(InputError, match=r"several formats \(\.png, \.tif\)"):
        list_images(tmp_path)


def test_a_stack_has_one_shape_and_type(tmp_path: Path) -> None:
    images = [noise((3, 4), np.uint8, seed) for seed in range(3)]
    for k, image in enumerate(images):
        write_image(tmp_path / f"{k}.png", image)
    stack = ImageStack.open(tmp_path)
    assert (stack.count, stack.shape, stack.dtype.name) == (3, (3, 4), "uint8")
    np.testing.assert_array_equal(list(stack), images)
    np.testing.assert_array_equal(stack.select([2, 0]).read(0), images[2])
    write_image(tmp_path / "1.png", noise((4, 3), np.uint8), overwrite=True)
    with pytest.raises(InputError, match=r"1\.png: is 4 x 3, but 0\.png is 3 x 4"):
        stack.read(1)
    write_image(tmp_path / "1.png", noise((3, 4), np.uint16), overwrite=True)
    with pytest.raises(InputError, match=r"1\.png: is uint16, but 0\.png is uint8"):
        stack.read(1)


def with_chunk(path: Path, name: bytes, content: bytes) -> None:
    data = path.read_bytes()
    chunk = struct.pack(">I", len(content)) + name + content
    chunk += struct.pack(">I", zlib.crc32(name + content))
    path.write_bytes(data[:33] + chunk + data[33:])


@pytest.mark.parametrize(
    ("name", "content", "tag"),
    [
        (b"sRGB", b"\0", "tagged sRGB"),
        (b"gAMA", struct.pack(">I", 45455), "tagged with gamma 2.2"),
        (b"gAMA", struct.pack(">I", 100000), None),
        (b"tEXt", b"Comment\0linear", None),
    ],
)
def test_tags_of_png_files(tmp_path: Path, name: bytes, content: bytes, tag: str | None) -> None:
    file = tmp_path / "a.png"
    write_image(file, noise((2, 2), np.uint8))
    with_chunk(file, name, content)
    assert nonlinear_tag(file) == tag
    assert nonlinear_tag(tmp_path / "a.tif") is None
    assert nonlinear_tag(tmp_path / "a.JPG") == "JPEG"


def test_writing_refuses_what_is_no_image(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite"):
        write_image(tmp_path / "a.png", np.array([[np.nan]]))
    with pytest.raises(InputError, match=r"shape \(2, 2, 2\)"):
        write_image(tmp_path / "a.png", np.zeros((2, 2, 2)))
    with pytest.raises(OutputError, match=r"ends in \.jpg"):
        write_image(tmp_path / "a.jpg", np.zeros((2, 2)))
    assert not list(tmp_path.iterdir())


def test_an_existing_output_needs_overwrite(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    write_image(file, np.zeros((2, 2)))
    with pytest.raises(OutputError, match="overwrite=True"):
        write_image(file, np.ones((2, 2)))
    assert read_image(file).max() == 0
    write_image(file, np.ones((2, 2)), overwrite=True)
    assert read_image(file).max() == 255


@LIMITS
def test_a_failing_write_leaves_nothing_and_spares_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "a.npy"
    write_image(file, np.zeros((2, 2)))
    before = file.read_bytes()
    with largest_file(4096), pytest.raises(OutputError, match="cannot be written"):
        write_image(file, noise((100, 100), np.float32), overwrite=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npy"]
    assert file.read_bytes() == before
