"""Stacks of images in one file: TIFF of several pages, npy and npz, as patterns and photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.files.images import write_image
from lightmatrix.files.stacks import ImageStack, list_images

PATTERNS = lm.BernoulliPatterns((8, 8), 12)


def noise(dtype: Any, shape: tuple[int, ...] = (12, 9, 10), seed: int = 0) -> NDArray[Any]:
    random = np.random.default_rng(seed)
    if np.dtype(dtype).kind == "f":
        return random.random(shape).astype(dtype)
    return random.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def save(file: Path, images: NDArray[Any], how: str = "") -> Path:
    if file.suffix == ".npy":
        np.save(file, np.asfortranarray(images) if how == "fortran" else images)
    elif file.suffix == ".npz":
        np.savez_compressed(file, images)
    else:
        colour = images.ndim == 4
        kinds: dict[str, dict[str, Any]] = {
            "": {},
            "imagej": {"imagej": True, "truncate": True},
            "shaped": {"truncate": True},
            "big": {"bigtiff": True, "metadata": None},
            "deflate": {"compression": "zlib"},
            "predicted": {"compression": "lzw", "predictor": True, "bigtiff": True},
            "swapped": {"byteorder": ">", "metadata": None},
        }
        options = kinds[how]
        tifffile.imwrite(file, images, photometric="rgb" if colour else "minisblack", **options)
    return file


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("s.npy", ""), ("s.npy", "fortran"), ("s.npz", ""), ("s.tif", ""), ("s.TIFF", "imagej"),
        ("s.tif", "shaped"), ("s.tif", "big"), ("s.tif", "deflate"), ("s.tif", "predicted"),
        ("s.tif", "swapped"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_stacks_are_read_as_they_were_stored(
    name: str, how: str, dtype: Any, tmp_path: Path
) -> None:
    for shape in ((12, 9, 10), (5, 9, 10, 3)):
        if how == "imagej" and len(shape) == 4 and dtype is not np.uint8:
            continue  # There is none.
        images = noise(dtype, shape)
        stack = ImageStack.open(save(tmp_path / name, images, how))
        assert (stack.count, stack.shape, stack.dtype) == (shape[0], shape[1:], np.dtype(dtype))
        np.testing.assert_array_equal(list(stack), images)
        assert stack.read(3).dtype == np.dtype(dtype)
        np.testing.assert_array_equal(stack.select([4, 1]).read(0), images[4])


def test_compressed_pages_come_from_their_own_place(tmp_path: Path) -> None:
    images = noise(np.uint8)
    first, *others = [Image.fromarray(image) for image in images]
    file = tmp_path / "lzw.tif"
    first.save(file, save_all=True, append_images=others, compression="tiff_lzw")
    np.testing.assert_array_equal(list(ImageStack.open(tmp_path / "lzw.tif")), images)


def test_a_colour_stack_that_is_grey_counts_once(tmp_path: Path) -> None:
    grey = noise(np.uint8)
    stack = ImageStack.open(save(tmp_path / "s.npy", np.repeat(grey[..., None], 3, axis=3)))
    np.testing.assert_array_equal(list(stack), grey)


def photographs() -> NDArray[Any]:
    transport = np.random.default_rng(1).random((90, 64)) / 40
    return np.rint(255 * (PATTERNS.dense() @ transport.T).clip(0, 1)).astype(np.uint8)


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Patterns and photographs in folders and in stacks."""
    images = photographs().reshape(12, 9, 10)
    lm.write_patterns(tmp_path / "patterns", PATTERNS)
    (tmp_path / "photos").mkdir()
    for k, image in enumerate(images):
        lm.write_image(tmp_path / "photos" / f"{k}.png", image)
    save(tmp_path / "photos.tif", images)
    np.save(tmp_path / "patterns.npy", PATTERNS.images() > 0)
    return tmp_path


def same(one: lm.Capture, other: lm.Capture) -> None:
    assert one.digest == other.digest
    np.testing.assert_array_equal(one.samples().values, other.samples().values)


def test_a_capture_from_stacks_is_that_from_folders(folders: Path) -> None:
    plain = lm.Capture.from_folders(folders / "patterns", folders / "photos")
    same(plain, lm.Capture.from_folders(folders / "patterns.npy", folders / "photos.tif"))
    images = np.stack([plain.frame(k) for k in range(12)])
    # Stacks in the place of the folders, and one within its folder.
    (folders / "capture" / "images").mkdir(parents=True)
    save(folders / "capture" / "images" / "all.tif", images)
    np.savez(folders / "capture" / "patterns.npz", PATTERNS.images())
    same(plain, lm.Capture.open(folders / "capture"))
    save(folders / "capture" / "images.npy", images)
    with pytest.raises(InputError, match=r"holds images and images\.npy"):
        lm.Capture.open(folders / "capture")


def test_the_command_line_takes_two_places(
    folders: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"{folders}/patterns.npy {folders}/photos.tif"
    assert main(f"estimate {line} -o {folders}/stacks.zarr".split()) == 0
    capture = lm.Capture.from_folders(folders / "patterns", folders / "photos")
    made, shown = lm.estimate(capture), lm.open(folders / "stacks.zarr")
    np.testing.assert_array_equal(made.sparse.toarray(), shown.sparse.toarray())
    findings = lm.check(patterns=folders / "patterns.npy", images=folders / "photos.tif")
    assert main(["check", *line.split()]) == int(bool(findings))
    assert main(["check", *line.split(), "--patterns", "patterns"]) == 2
    assert "give patterns and images once" in capsys.readouterr().err


def broken(how: str, folder: Path) -> tuple[str, str]:
    """A stack that is wrong, and what is words of it."""
    images = photographs().reshape(12, 9, 10)
    file = folder / "wrong.tif"
    if how == "count":
        save(file, images[:-1])
        return file.name, "12 patterns, but 11 images"
    if how == "size":
        for k, image in enumerate(images):
            tifffile.imwrite(file, image[: 9 - (k == 7)], append=k > 0)
        return file.name, "image 7: is 8 x 10, but wrong.tif, image 0 is 9 x 10"
    if how == "type":
        for k, image in enumerate(images):
            tifffile.imwrite(file, image.astype(np.uint16 if k == 7 else np.uint8), append=k > 0)
        return file.name, "image 7: is uint16, but wrong.tif, image 0 is uint8"
    if how == "nan":
        levels = images.astype(np.float32) / 255
        levels[5, 2, 3] = np.nan
        np.save(folder / "wrong.npy", levels)
        return "wrong.npy", "image 5: the value at (2, 3) is nan"
    if how == "cut":
        save(folder / "wrong.npy", images)
        data = (folder / "wrong.npy").read_bytes()
        (folder / "wrong.npy").write_bytes(data[:-100])
        return "wrong.npy", "greater than file size"
    if how == "cut shaped":
        save(file, images, "shaped")
        file.write_bytes(file.read_bytes()[:-100])
        return file.name, "damaged or truncated"
    if how == "one image":
        np.save(folder / "wrong.npy", images[0])
        return "wrong.npy", "no stack of images"
    if how == "objects":
        np.save(folder / "wrong.npy", np.array([None, "x"], object))
        return "wrong.npy", "Python objects in dtype"
    if how == "long":
        np.save(folder / "wrong.npy", images.astype(np.int64))
        return "wrong.npy", "image 0: holds int64 values"
    if how == "several arrays":
        np.savez(folder / "wrong.npz", a=images, b=images)
        return "wrong.npz", "holds 2 arrays (a, b)"
    (folder / "wrong.png").write_bytes(b"")
    return "wrong.png", "is a file, not a folder of images"


@pytest.mark.parametrize(
    "how",
    [
        "count", "size", "type", "nan", "cut", "cut shaped", "one image", "objects", "long",
        "several arrays", "another file",
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_stack_is_named(
    how: str, folders: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, words = broken(how, folders)
    assert main(f"estimate {folders}/patterns {folders}/{name} -o {folders}/x.zarr".split()) == 2
    message = capsys.readouterr().err
    assert words in message
    assert name in message
    assert "Traceback" not in message


def test_patterns_of_zeros_and_ones_in_integers_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", (PATTERNS.images() > 0).astype(np.uint8))
    with pytest.raises(InputError, match="no pattern is brighter than 1 of 255"):
        lm.read_patterns(tmp_path / "p.npy")


def test_grey_images_in_three_channels_are_read_as_one(tmp_path: Path) -> None:
    frames = [noise(np.uint8, (12, 10)) // (k + 1) for k in range(5)]
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


def test_natural_order_and_passed_over_files(tmp_path: Path) -> None:
    names = ["frame_10.png", "frame_2.png", "frame_1.png", "Frame_3.png"]
    for name in [*names, ".hidden.png"]:
        write_image(tmp_path / name, noise(np.uint8, (2, 2)))
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
    write_image(tmp_path / "a.png", noise(np.uint8, (2, 2)))
    write_image(tmp_path / "a.tif", noise(np.uint8, (2, 2)))
    with pytest.raises(InputError, match=r"several formats \(\.png, \.tif\)"):
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
