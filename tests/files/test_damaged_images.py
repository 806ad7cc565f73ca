"""Damaged, misleading and oversized image files are refused, never shown as something else."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import warnings
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import InputError
from lightmatrix.files import png
from lightmatrix.files.image_stack import ImageStack, list_images
from lightmatrix.files.images import read_image, write_image
from lightmatrix.files.pillow_images import encode_image
from tests.helpers.systems import PIPES

SHAPES = {"grey": (24, 31), "colour": (24, 31, 3)}


def picture(shape: tuple[int, ...], dtype: Any, seed: int = 0) -> NDArray[Any]:
    """Smooth with a little noise, so that it compresses as photographs do."""
    generator = np.random.default_rng(seed)
    ramp = np.add.outer(np.arange(shape[0]), np.arange(shape[1])).astype(float)
    image = ramp.reshape(*shape[:2], *([1] * (len(shape) - 2))) * 1000 + generator.integers(
        0, 90, shape
    )
    return (image % np.iinfo(dtype).max).astype(dtype)


def flip(file: Path, bit: int) -> None:
    data = bytearray(file.read_bytes())
    data[bit // 8] ^= 1 << (bit % 8)
    file.write_bytes(data)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_a_flipped_bit_is_noticed_or_does_not_matter(
    tmp_path: Path, suffix: str, kind: str, dtype: Any
) -> None:
    """PNG has checksums; npy has none for its values, but its header is held to its size."""
    image = picture(SHAPES[kind], dtype)
    write_image(tmp_path / f"whole{suffix}", image)
    data = (tmp_path / f"whole{suffix}").read_bytes()
    last = 8 * len(data) if suffix == ".png" else 8 * 128
    for bit in np.random.default_rng(1).integers(0, last, 60):
        file = tmp_path / f"flipped{suffix}"
        file.write_bytes(data)
        flip(file, int(bit))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read = read_image(file)
            except InputError:
                continue
        if suffix == ".png":
            np.testing.assert_array_equal(read, image)
        else:
            assert read.size * read.itemsize == image.size * image.itemsize


def a_png(header: bytes, pixels: bytes, **more: bytes) -> bytes:
    extra = [(name.encode(), content) for name, content in more.items()]
    return png.write_chunks((b"IHDR", header), *extra, (b"IDAT", pixels))


def lines(image: NDArray[Any]) -> bytes:
    rows = len(image)
    data = image.astype(image.dtype.newbyteorder(">")).reshape(rows, -1).view(np.uint8)
    return np.column_stack([np.zeros(rows, np.uint8), data]).tobytes()


@pytest.mark.parametrize(("bits", "colour"), [(8, 0), (8, 2), (16, 0), (16, 2), (16, 4)])
def test_checksums_of_pixels_are_verified(tmp_path: Path, bits: int, colour: int) -> None:
    """The chunk's checksum fits, the one of the pixel data within it does not."""
    channels = png.CHANNELS[colour]
    image = picture((9, 8, channels), np.uint8 if bits == 8 else np.uint16)
    if colour == 4:
        image[..., 1] = 65535
    header = struct.pack(">IIBBBBB", 8, 9, bits, colour, 0, 0, 0)
    packed = zlib.compress(lines(image))
    file = tmp_path / "a.png"
    file.write_bytes(a_png(header, packed))
    expected = image[..., 0] if channels < 3 else image
    np.testing.assert_array_equal(read_image(file), expected)
    for wrong in (
        packed[:-1] + bytes([packed[-1] ^ 1]),
        packed[:-4],
        zlib.compress(lines(image) + b"more"),
        zlib.compress(lines(image)[:-1]),
        b"",
    ):
        file.write_bytes(a_png(header, wrong))
        with pytest.raises(InputError, match="cannot be read as an image, damaged"):
            read_image(file)


def test_checksums_of_all_chunks_are_verified(tmp_path: Path) -> None:
    """A bit of the palette changes colours, and of the header the size, without harm to pixels."""
    header = struct.pack(">IIBBBBB", 8, 9, 8, png.PALETTE, 0, 0, 0)
    palette = bytes(range(256)) * 3
    data = a_png(header, zlib.compress(bytes(9 * 9)), PLTE=palette)
    file = tmp_path / "a.png"
    file.write_bytes(data)
    assert read_image(file).shape == (9, 8, 3)
    for at in (data.index(b"PLTE") + 4, data.index(b"IHDR") + 8, len(data) - 1):
        file.write_bytes(data)
        flip(file, 8 * at)
        with pytest.raises(InputError, match="a checksum does not fit"):
            read_image(file)


@pytest.mark.parametrize(("bits", "colours"), [(8, 200), (8, 256), (4, 11), (1, 2)])
def test_a_colour_beyond_the_palette(tmp_path: Path, bits: int, colours: int) -> None:
    header = struct.pack(">IIBBBBB", 8, 1, bits, png.PALETTE, 0, 0, 0)
    palette = np.arange(3 * colours, dtype=np.uint16).astype(np.uint8)
    index = np.array([colours - 1, 0] * 4)
    shown = ((index[:, None] >> np.arange(bits)[::-1]) & 1).astype(np.uint8)
    pixels = zlib.compress(b"\0" + np.packbits(shown).tobytes())
    file = tmp_path / "a.png"
    file.write_bytes(a_png(header, pixels, PLTE=palette.tobytes()))
    np.testing.assert_array_equal(read_image(file)[0], palette.reshape(-1, 3)[index])
    file.write_bytes(a_png(header, pixels, PLTE=palette[:-3].tobytes()))
    with pytest.raises(InputError, match=f"a pixel of colour {colours - 1}, but {colours - 1}"):
        read_image(file)


def test_interlaced_png_is_read_whole(tmp_path: Path) -> None:
    """Written pass by pass as the specification says."""
    for rows, cols in ((1, 1), (3, 2), (5, 9), (8, 8)):
        image = picture((rows, cols), np.uint8)
        starts = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4)]
        starts += [(2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
        passes = (image[r::down, c::across] for r, c, down, across in starts)
        packed = zlib.compress(b"".join(lines(part) for part in passes if part.size))
        header = struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 1)
        (tmp_path / "a.png").write_bytes(a_png(header, packed))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)
        (tmp_path / "a.png").write_bytes(a_png(header, packed[:-2]))
        with pytest.raises(InputError, match="damaged"):
            read_image(tmp_path / "a.png")


def test_deep_grey_with_alpha_keeps_its_depth(tmp_path: Path) -> None:
    image = picture((5, 6, 2), np.uint16)
    image[..., 1] = 65535
    header = struct.pack(">IIBBBBB", 6, 5, 16, 4, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(a_png(header, zlib.compress(lines(image))))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image[..., 0])
    image[2, 2, 1] = 9
    (tmp_path / "a.png").write_bytes(a_png(header, zlib.compress(lines(image))))
    with pytest.raises(InputError, match="partly transparent"):
        read_image(tmp_path / "a.png")


BOMB = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from lightmatrix.errors import InputError
from lightmatrix.files.images import read_image
try:
    read_image(sys.argv[1])
except InputError as error:
    print(error.message)
# The peak of this program alone; getrusage tells that of the one it was started from.
status = open('/proc/self/status').read()
print(status.split('VmHWM:')[1].split()[0])
"""


def bombs(folder: Path) -> Iterable[tuple[Path, str]]:
    """Small files that announce, or hold, far more than an image."""
    deflater = zlib.compressobj(9)
    zeros = b"".join([deflater.compress(bytes(1 << 20)) for _ in range(600)] + [deflater.flush()])
    for bits, colour in ((16, 2), (8, 0)):
        huge = struct.pack(">IIBBBBB", 30000, 30000, bits, colour, 0, 0, 0)
        (folder / f"huge{bits}.png").write_bytes(a_png(huge, zeros))
        yield folder / f"huge{bits}.png", "announces 30000 x 30000"
        small = struct.pack(">IIBBBBB", 10, 10, bits, colour, 0, 0, 0)
        (folder / f"small{bits}.png").write_bytes(a_png(small, zeros))
        yield folder / f"small{bits}.png", "its length does not fit"
    tifffile.imwrite(folder / "a.tif", np.zeros((64, 64), np.uint8), compression="zlib")
    with tifffile.TiffFile(folder / "a.tif") as tiff:
        page = tiff.pages.first
        offset, count = page.dataoffsets[0], page.tags["StripByteCounts"].valueoffset
        tall = [page.tags[name].valueoffset for name in ("ImageWidth", "ImageLength")]
    data = bytearray((folder / "a.tif").read_bytes())
    (folder / "strip.tif").write_bytes(data[:offset] + zeros)
    with (folder / "strip.tif").open("r+b") as file:
        file.seek(count)
        file.write(struct.pack("<I", len(zeros)))
    yield folder / "strip.tif", "its length does not fit"
    for at in tall:
        data[at : at + 4] = struct.pack("<I", 60000)
    (folder / "huge.tif").write_bytes(data)
    yield folder / "huge.tif", "announces 60000 x 60000"
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999, 99999)}".ljust(117) + b"\n"
    (folder / "huge.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + header)
    yield folder / "huge.npy", "its size does not fit its header"


def test_what_is_too_large_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    for file, message in bombs(tmp_path):
        done = subprocess.run(
            [sys.executable, "-c", BOMB, str(file)], capture_output=True, text=True, check=False
        )
        assert message in done.stdout, (file, done.stdout, done.stderr)
        peak = int(done.stdout.split()[-1])
        assert peak < 500 << 10, f"{file.name} took {peak >> 10} MiB"


def test_other_formats_under_a_wrong_name_are_refused(tmp_path: Path) -> None:
    image = picture((9, 8), np.uint8)
    for kind, wrong in (("jpeg", ".png"), ("png", ".jpg"), ("bmp", ".jpeg"), ("gif", ".bmp")):
        data = encode_image(image, kind)
        (tmp_path / f"a{wrong}").write_bytes(data)
        with pytest.raises(InputError, match=r"not a (PNG|JPEG|BMP) file"):
            read_image(tmp_path / f"a{wrong}")


def patched(source: Path, target: Path, tag: str, value: int) -> None:
    """A TIFF file with another first value of a tag."""
    with tifffile.TiffFile(source) as tiff:
        entry = tiff.pages.first.tags[tag]
        at, form = entry.valueoffset, {3: "<H", 4: "<I"}[int(entry.dtype)]
    data = bytearray(source.read_bytes())
    data[at : at + struct.calcsize(form)] = struct.pack(form, value)
    target.write_bytes(data)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_short_strips_of_tiff(tmp_path: Path, compression: str | None) -> None:
    image = picture((20, 30), np.uint16)
    file, bad = tmp_path / "a.tif", tmp_path / "bad.tif"
    tifffile.imwrite(file, image, compression=compression, rowsperstrip=8)
    np.testing.assert_array_equal(read_image(file), image)
    for count in (0, 1, 100):
        patched(file, bad, "StripByteCounts", count)
        with pytest.raises(InputError, match="damaged or truncated"):
            read_image(bad)
    patched(file, bad, "StripOffsets", 1 << 30 if compression is None else 60000)
    with pytest.raises(InputError, match="damaged or truncated"):
        read_image(bad)


def test_a_strip_that_is_whole_but_holds_too_few_lines(tmp_path: Path) -> None:
    image = picture((20, 30), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", image, compression="zlib", rowsperstrip=8)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        page = tiff.pages.first
        offset = page.dataoffsets[0]
    short = zlib.compress(image[:7].tobytes(), 9)
    data = bytearray((tmp_path / "a.tif").read_bytes())
    data[offset : offset + len(short)] = short
    (tmp_path / "a.tif").write_bytes(data)
    patched(tmp_path / "a.tif", tmp_path / "bad.tif", "StripByteCounts", len(short))
    with pytest.raises(InputError, match="damaged or truncated"):
        read_image(tmp_path / "bad.tif")


def test_strips_of_other_compressions(tmp_path: Path) -> None:
    image = picture((20, 30), np.uint8)
    Image.fromarray(image).save(tmp_path / "a.tif", compression="tiff_lzw")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)
    patched(tmp_path / "a.tif", tmp_path / "bad.tif", "StripByteCounts", 0)
    with pytest.raises(InputError, match="a strip of 0 bytes"):
        read_image(tmp_path / "bad.tif")


@pytest.mark.parametrize("options", [{"tile": (16, 16)}, {"rowsperstrip": 7}, {"predictor": True}])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3), (1, 1)])
def test_ways_to_store_tiff(
    tmp_path: Path, shape: tuple[int, ...], compression: str | None, options: dict[str, Any]
) -> None:
    if compression is None:
        options = {key: value for key, value in options.items() if key != "predictor"}
    image = picture(shape, np.uint16)
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(
        tmp_path / "a.tif", image, compression=compression, photometric=photometric, **options
    )
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)


def test_planes_of_tiff_are_put_together(tmp_path: Path) -> None:
    image = picture((20, 3, 3), np.uint16)
    for compression in (None, "zlib"):
        tifffile.imwrite(
            tmp_path / "a.tif",
            np.moveaxis(image, -1, 0),
            photometric="rgb",
            planarconfig="separate",
            compression=compression,
            rowsperstrip=7,
        )
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)


def test_palettes_are_never_indices(tmp_path: Path) -> None:
    palette = np.arange(3 * 256, dtype=np.uint16).reshape(3, 256) * 80
    tifffile.imwrite(
        tmp_path / "a.tif", picture((9, 8), np.uint8), photometric="palette", colormap=palette
    )
    with pytest.raises(InputError, match="has a palette"):
        read_image(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "b.tif", picture((9, 8, 4), np.uint8), photometric="separated")
    with pytest.raises(InputError, match="has colours of kind 5"):
        read_image(tmp_path / "b.tif")


def test_many_images_behind_one_page(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 9, 8), np.uint16), imagej=True)
    with pytest.raises(InputError, match="holds"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("value", [1e300, -1e39, np.nan, np.inf])
def test_values_beyond_single_precision(tmp_path: Path, value: float) -> None:
    image = np.zeros((3, 4))
    image[1, 2] = value
    np.save(tmp_path / "a.npy", image)
    with pytest.raises(InputError, match=r"the value at \(1, 2\) is"):
        read_image(tmp_path / "a.npy")
    with pytest.raises(InputError, match="not finite"):
        write_image(tmp_path / "b.npy", image)


@PIPES
def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "link.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "device.png").symlink_to("/dev/zero")
    for name, message in (
        ("pipe.png", "is a pipe or device"),
        ("device.png", "is a pipe or device"),
        ("link.png", "is a link that leads nowhere"),
    ):
        with pytest.raises(InputError, match=message):
            read_image(tmp_path / name)
    write_image(tmp_path / "1.png", np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match="is a"):
        list_images(tmp_path)


@given(st.lists(st.text(st.sampled_from("0a1²٣Ⅷ_"), min_size=1, max_size=4), unique=True))
@settings(max_examples=40, deadline=None)
def test_any_digits_may_stand_in_names(
    tmp_path_factory: pytest.TempPathFactory, names: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("names")
    write_image(folder / "0.png", np.zeros((2, 2), np.uint8), overwrite=True)
    for name in names:
        write_image(folder / f"{name}.png", np.zeros((2, 2), np.uint8), overwrite=True)
    assert ImageStack.open(folder).count == len({"0", *names})


@pytest.mark.parametrize("name", ["a.PNG", "a.TIF", "a.NPY", "a.Tiff"])
def test_endings_in_capitals_are_endings(tmp_path: Path, name: str) -> None:
    image = picture((5, 6), np.uint16)
    write_image(tmp_path / name, image)
    np.testing.assert_array_equal(read_image(tmp_path / name), image)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
