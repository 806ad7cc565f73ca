"""Image files come back as they were stored; damaged and misleading ones are refused by name."""

from __future__ import annotations

import io
import os
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import lightmatrix as lm
from lightmatrix.errors import InputError, OutputError
from lightmatrix.files import reading
from lightmatrix.files.extras import orientation
from lightmatrix.files.images import encode_image, read_grey, read_image, write_image
from lightmatrix.files.stacks import list_images, nonlinear_tag
from tests.helpers.systems import PIPES

SHAPES = {"grey": (24, 31), "colour": (24, 31, 3)}
# Channels of PNG files by their kind of colour.
LEVELS = np.arange(12, dtype=np.uint8).reshape(3, 4) * np.uint8(20)
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def noise(shape: tuple[int, ...], dtype: Any, seed: int = 0) -> NDArray[Any]:
    generator = np.random.default_rng(seed)
    if np.dtype(dtype).kind == "f":
        return generator.random(shape).astype(dtype)
    return generator.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


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


def a_png(shape: tuple[int, int], bits: int, colour: int, pixels: bytes, **more: Any) -> bytes:
    """A PNG file of deflated lines, with further chunks."""
    header = struct.pack(">IIBBBBB", shape[1], shape[0], bits, colour, 0, 0, 0)
    chunks = {"IHDR": header, **more, "IDAT": pixels, "IEND": b""}
    data = b"\x89PNG\r\n\x1a\n"
    for name, content in chunks.items():
        body = name.encode() + content
        data += struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
    return data


def lines(image: NDArray[Any]) -> bytes:
    rows = len(image)
    data = image.astype(image.dtype.newbyteorder(">")).reshape(rows, -1).view(np.uint8)
    return np.column_stack([np.zeros(rows, np.uint8), data]).tobytes()


@pytest.mark.parametrize("suffix", [".png", ".TIF", ".tiff", ".npy", ".PNG", ".NPY"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (4, 9, 3), (3, 1, 3)])
def test_images_round_trip(tmp_path: Path, suffix: str, dtype: Any, shape: tuple[int, ...]) -> None:
    if dtype == np.float32 and suffix.lower() == ".png":
        pytest.skip("a PNG has no float values")
    image = noise(shape, dtype)
    file = tmp_path / f"image{suffix}"
    write_image(file, image)
    back = read_image(file)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]


def test_float_images_as_png_use_the_full_range_and_cut_off(tmp_path: Path) -> None:
    image = np.array([[0.0, 0.5, 1.0, 1.7, -0.2]], np.float32)
    write_image(tmp_path / "a.png", image)
    write_image(tmp_path / "b.png", image, bits=16)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), [[0, 128, 255, 255, 0]])
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), [[0, 32768, 65535, 65535, 0]])


def test_patterns_are_read_over_the_full_range(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.array([[0, 51, 255]], np.uint8))
    np.testing.assert_allclose(read_grey(tmp_path / "a.png"), [[0, 0.2, 1]], rtol=1e-6)
    write_image(tmp_path / "b.tif", np.array([[0, 65535]], np.uint16))
    np.testing.assert_allclose(read_grey(tmp_path / "b.tif"), [[0, 1]])
    write_image(tmp_path / "c.png", np.full((2, 2, 3), 255, np.uint8))
    np.testing.assert_allclose(read_grey(tmp_path / "c.png"), np.ones((2, 2)))


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


# ---- PNG


@pytest.mark.parametrize(("bits", "colour"), [(8, 0), (8, 2), (16, 0), (16, 2), (16, 4), (16, 6)])
def test_checksums_of_pixels_are_verified(tmp_path: Path, bits: int, colour: int) -> None:
    """The chunk's checksum fits, the one of the pixel data within it does not."""
    channels = CHANNELS[colour]
    image = picture((9, 8, channels), np.uint8 if bits == 8 else np.uint16)
    if colour > 3:
        image[..., -1] = 65535
    packed = zlib.compress(lines(image))
    file = tmp_path / "a.png"
    file.write_bytes(a_png((9, 8), bits, colour, packed))
    expected = image[..., 0] if channels < 3 else image[..., :3]
    np.testing.assert_array_equal(read_image(file), expected)
    for wrong in (
        packed[:-1] + bytes([packed[-1] ^ 1]),
        packed[:-4],
        zlib.compress(lines(image)[:-1]),
        b"",
    ):
        file.write_bytes(a_png((9, 8), bits, colour, wrong))
        with pytest.raises(InputError, match="cannot be read as an image, damaged"):
            read_image(file)


def test_checksums_of_all_chunks_are_verified(tmp_path: Path) -> None:
    """A bit of the palette changes colours, and of the header the size, without harm to pixels."""
    data = a_png((9, 8), 8, 3, zlib.compress(bytes(9 * 9)), PLTE=bytes(range(256)) * 3)
    file = tmp_path / "a.png"
    file.write_bytes(data)
    assert read_image(file).shape == (9, 8, 3)
    for at in (data.index(b"PLTE") + 4, data.index(b"IHDR") + 8):
        file.write_bytes(data)
        flip(file, 8 * at)
        with pytest.raises(InputError, match=r"CRC error|announces"):
            read_image(file)


@pytest.mark.parametrize(
    ("bits", "colour"), [(1, 0), (2, 0), (4, 0), (1, 3), (2, 3), (4, 3), (8, 3)]
)
def test_few_bits_and_palettes(tmp_path: Path, bits: int, colour: int) -> None:
    """Grey of fewer bits reaches over the full range; entries of a palette are colours."""
    index = np.arange(8)[None] % 2**bits
    shown = np.unpackbits(index[..., None].astype(np.uint8), axis=-1)[..., -bits:]
    pixels = zlib.compress(b"\0" + np.packbits(shown).tobytes())
    palette = np.arange(3 * 2**bits, dtype=np.uint16).astype(np.uint8) if colour else None
    more = {} if palette is None else {"PLTE": palette.tobytes()}
    (tmp_path / "a.png").write_bytes(a_png((1, 8), bits, colour, pixels, **more))
    expected = index * (255 // (2**bits - 1)) if palette is None else palette.reshape(-1, 3)[index]
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)
    # One level, or entry of the palette, stands for transparent pixels, which have levels too.
    more["tRNS"] = b"\0\1" if palette is None else b"\0\x80"
    (tmp_path / "a.png").write_bytes(a_png((1, 8), bits, colour, pixels, **more))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)


@pytest.mark.parametrize("chunks", [{"sBIT": b"\x0c"}, {"gAMA": struct.pack(">I", 45455)}])
def test_tags_change_no_levels(tmp_path: Path, chunks: dict[str, bytes]) -> None:
    image = picture((5, 6), np.uint16)
    (tmp_path / "a.png").write_bytes(a_png((5, 6), 16, 0, zlib.compress(lines(image)), **chunks))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)


@pytest.mark.parametrize(
    ("name", "content", "tag"),
    [
        ("sRGB", b"\0", "tagged sRGB"),
        ("iCCP", b"display\0\0", "tagged with a colour profile"),
        ("gAMA", struct.pack(">I", 45455), "tagged with gamma 2.2"),
        ("gAMA", struct.pack(">I", 100000), None),
        ("tEXt", b"Comment\0sRGB", None),
    ],
)
def test_tags_of_png_files(tmp_path: Path, name: str, content: bytes, tag: str | None) -> None:
    file = tmp_path / "a.png"
    file.write_bytes(a_png((2, 2), 8, 0, zlib.compress(bytes(6)), **{name: content}))
    assert nonlinear_tag(file) == tag
    file.write_bytes(file.read_bytes()[:40])
    nonlinear_tag(file)
    assert nonlinear_tag(tmp_path / "a.tif") is None
    assert nonlinear_tag(tmp_path / "a.JPG") == "JPEG"


# ---- TIFF


def patched(source: Path, target: Path, tag: str, value: int) -> None:
    """A TIFF file with another first value of a tag."""
    with tifffile.TiffFile(source) as tiff:
        entry = tiff.pages.first.tags[tag]
        at, form = entry.valueoffset, {3: "<H", 4: "<I"}[int(entry.dtype)]
    data = bytearray(source.read_bytes())
    data[at : at + struct.calcsize(form)] = struct.pack(form, value)
    target.write_bytes(data)


COMPRESSIONS = (None, "zlib", "lzw", "packbits", "lzma", "zstd")
WAYS: tuple[dict[str, Any], ...] = (
    {"tile": (16, 16)}, {"rowsperstrip": 7}, {"rowsperstrip": 7, "predictor": True},
    {"byteorder": ">"}, {"bigtiff": True},
)  # fmt: skip


@pytest.mark.parametrize("how", WAYS, ids=str)
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_ways_to_store_tiff(
    tmp_path: Path, dtype: Any, compression: str | None, how: dict[str, Any]
) -> None:
    """They come back as stored, and are refused where a strip or tile is cut."""
    if "predictor" in how and compression in (None, "packbits"):
        pytest.skip("there is none")
    file, bad = tmp_path / "a.tif", tmp_path / "bad.tif"
    for shape in ((1, 1), (20, 30, 3), (20, 30)):
        image = picture(shape, np.uint8).astype(dtype)
        colours = "rgb" if len(shape) == 3 else "minisblack"
        tifffile.imwrite(file, image, compression=compression, photometric=colours, **how)
        read = read_image(file)
        assert read.dtype == dtype
        np.testing.assert_array_equal(read, image)
    if how.keys() & {"byteorder", "bigtiff"}:
        return
    part = "Tile" if "tile" in how else "Strip"
    for count in (0, 1):
        patched(file, bad, f"{part}ByteCounts", count)
        with pytest.raises(InputError, match="damaged or truncated"):
            read_image(bad)
    patched(file, bad, f"{part}Offsets", 60000)
    with pytest.raises(InputError, match="damaged or truncated"):
        read_image(bad)


def test_planes_of_tiff_are_put_together(tmp_path: Path) -> None:
    image = picture((20, 3, 3), np.uint16)
    planes = np.moveaxis(image, -1, 0)
    for compression in COMPRESSIONS:
        tifffile.imwrite(
            tmp_path / "a.tif", planes, photometric="rgb", planarconfig="separate",
            compression=compression, rowsperstrip=7,
        )  # fmt: skip
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), image)


@pytest.mark.parametrize("bits", [1, 12, 16])
def test_packed_levels_of_tiff(tmp_path: Path, bits: int) -> None:
    levels = picture((9, 18), np.uint16) & (2**bits - 1)
    stored = levels.astype(bool) if bits == 1 else levels
    more: dict[str, Any] = {"bitspersample": bits} if bits == 12 else {}
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", **more)
    shown = levels * 255 if bits == 1 else levels
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), shown)


def test_what_tiff_may_hold_besides(tmp_path: Path) -> None:
    palette = np.arange(3 * 256, dtype=np.uint16).reshape(3, 256) * 80
    grey, file = picture((9, 8), np.uint8), tmp_path / "a.tif"
    cases: list[tuple[str, Any, dict[str, Any]]] = [
        ("has a palette", grey, {"photometric": "palette", "colormap": palette}),
        ("has white as 0", grey, {"photometric": "miniswhite"}),
        ("has colours of kind 5", picture((9, 8, 4), np.uint8), {"photometric": "separated"}),
        ("compression 34933 is not read", grey, {"compression": "png"}),
        ("has 4 bits a value", grey % 16, {"bitspersample": 4, "photometric": "minisblack"}),
        ("holds", np.zeros((4, 9, 8), np.uint16), {"imagej": True}),
        ("holds", grey.astype(np.int16) - 300, {}),
        ("holds", grey.astype(np.complex64), {}),
        (
            r"a\.tif",
            picture((9, 8, 5), np.uint8),
            {"photometric": "minisblack", "planarconfig": "contig"},
        ),
    ]
    for message, pixels, how in cases:
        tifffile.imwrite(file, pixels, **how)
        with pytest.raises(InputError, match=message):
            read_image(file)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_tag_turns_no_tiff(tmp_path: Path, orientation: int) -> None:
    """Whichever library reads it."""
    for compression in ("raw", "tiff_lzw", "packbits", "tiff_adobe_deflate"):
        file = tmp_path / f"{compression}.tif"
        Image.fromarray(LEVELS).save(file, compression=compression, tiffinfo={274: orientation})
        np.testing.assert_array_equal(lm.read_image(file), LEVELS, err_msg=compression)


# ---- PGM, JPEG


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


def test_printing_colours_are_refused(tmp_path: Path) -> None:
    data = io.BytesIO()
    # Full black, which was taken for an opaque alpha channel.
    image = Image.new("CMYK", (8, 8), (0, 200, 100, 255))
    image.save(data, "JPEG")
    (tmp_path / "a.jpg").write_bytes(data.getvalue())
    with pytest.raises(lm.InputError, match="printing colours"):
        lm.read_image(tmp_path / "a.jpg")


# ---- damage


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


def test_other_formats_under_a_wrong_name_are_refused(tmp_path: Path) -> None:
    image = picture((9, 8), np.uint8)
    for kind, wrong in (("jpeg", ".png"), ("png", ".jpg"), ("bmp", ".jpeg"), ("gif", ".bmp")):
        data = encode_image(image, kind)
        (tmp_path / f"a{wrong}").write_bytes(data)
        with pytest.raises(InputError, match=r"not a (PNG|JPEG|BMP) file"):
            read_image(tmp_path / f"a{wrong}")


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


BAD_FILES = {
    "missing.png": "no such file",
    "folder.png": "is a folder, not an image file",
    "raw.x3f": "files ending in .x3f are not read",
    "empty.png": "is empty",
    "text.png": "cannot be read as an image",
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


@pytest.fixture
def forbid(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a file unreadable, for root too, whom the system lets read anything."""
    usual = Path.open

    def forbidden(file: Path) -> None:
        def opened(path: Path, *arguments: Any, **more: Any) -> Any:
            if path == file:
                raise PermissionError(13, "Permission denied", str(path))
            return usual(path, *arguments, **more)

        access = os.access
        monkeypatch.setattr(os, "access", lambda path, mode: path != file and access(path, mode))
        monkeypatch.setattr(Path, "open", opened)

    return forbidden


def test_an_image_that_may_not_be_read(tmp_path: Path, forbid: Any) -> None:
    lm.write_image(tmp_path / "a.png", np.eye(4, dtype=np.uint8))
    forbid(tmp_path / "a.png")
    with pytest.raises(lm.InputError, match=r"a\.png: cannot be read \(Permission denied") as error:
        lm.read_image(tmp_path / "a.png")
    assert "permissions" in (error.value.hint or "")


@pytest.mark.parametrize("name", ["zarr.json", "data/zarr.json", "data/c/0"])
def test_a_store_that_may_not_be_read(tmp_path: Path, forbid: Any, name: str) -> None:
    lm.save(tmp_path / "s.zarr", lm.truth("metal").transport())
    forbid(tmp_path / "s.zarr" / name)
    with pytest.raises(lm.InputError, match="Permission denied") as error:
        lm.open(tmp_path / "s.zarr")
    assert name in error.value.message
    assert "permissions" in (error.value.hint or "")
    assert "damaged" not in error.value.message


# ---- meaning


def test_a_single_pattern_of_fewer_bits_is_warned_of(tmp_path: Path) -> None:
    lm.write_image(tmp_path / "a.png", np.arange(35, 256, 20, dtype=np.uint16).reshape(3, 4))
    with pytest.warns(lm.LightMatrixWarning, match="16 bits, but no level above 255"):
        read_grey(tmp_path / "a.png")


def photographs(folder: Path, count: int = 8) -> lm.Capture:
    """A capture whose frames lie as PNG files in `folder`."""
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), count))
    for k in range(count):
        lm.write_image(folder / f"{k}.png", capture.frame(k))
    return capture


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


# ---- writing


def test_writing_refuses_what_is_no_image(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not finite"):
        write_image(tmp_path / "a.png", np.array([[np.nan]]))
    with pytest.raises(InputError, match=r"shape \(2, 2, 2\)"):
        write_image(tmp_path / "a.png", np.zeros((2, 2, 2)))
    with pytest.raises(OutputError, match=r"ends in \.jpg"):
        write_image(tmp_path / "a.jpg", np.zeros((2, 2)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dtype", ["i2", "u4", "i4", ">u2", ">i4"])
def test_levels_of_16_bits_are_read_from_other_integers(dtype: str, tmp_path: Path) -> None:
    levels = np.array([[0, 1, 300], [7, 30000, 2]])
    np.save(tmp_path / "a.npy", levels.astype(dtype))
    read = read_image(tmp_path / "a.npy")
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, levels)
    if "i" in dtype:
        np.save(tmp_path / "b.npy", (levels - 1).astype(dtype))
        with pytest.raises(InputError, match=r"holds .* values"):
            read_image(tmp_path / "b.npy")


def test_a_file_larger_than_any_image_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lightmatrix.files.images.MOST_VALUES", 1 << 18)
    file = tmp_path / "a.png"
    with file.open("wb") as stream:
        # A copy program reserved the place, and was stopped.
        stream.truncate(2**20 + 1)
    with pytest.raises(InputError, match="is larger than 1 MiB"):
        read_image(file)


@pytest.mark.parametrize("transfer", [16, 18, 13])
def test_a_picture_in_hdr_is_named(tmp_path: Path, transfer: int) -> None:
    file = tmp_path / "wide.png"
    write_image(file, np.full((4, 4), 9, np.uint8))
    plain, chunk = file.read_bytes(), b"cICP" + bytes([9, transfer, 0, 1])
    whole = struct.pack(">I", 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    file.write_bytes(plain[:33] + whole + plain[33:])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(read_image(file), np.full((4, 4), 9))
    # 13 is sRGB.
    assert ["is in HDR" in str(each.message) for each in said] == [True] * (transfer != 13)


@pytest.mark.parametrize("kind", ["exif", "xmp", "none"])
def test_a_png_is_turned_as_its_tags_say(kind: str, tmp_path: Path) -> None:
    image, tags = Image.new("L", (6, 4)), PngInfo()
    if kind == "xmp":
        said = '<x xmlns:tiff="http://ns.adobe.com/tiff/1.0/" tiff:Orientation="6"/>'
        tags.add_itxt("XML:com.adobe.xmp", said)
    exif = Image.Exif()
    exif[274] = 6
    more: dict[str, Any] = {"exif": exif} if kind == "exif" else {}
    image.save(tmp_path / "p.png", pnginfo=tags, **more)
    assert orientation(tmp_path / "p.png") == (1 if kind == "none" else 6)
