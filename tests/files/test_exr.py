"""OpenEXR in and out: linear float, nothing lost, and what is no picture of ours refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import InputError, MissingExtraError

OpenEXR = pytest.importorskip("OpenEXR")
HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
RANDOM = np.random.default_rng(0)


def write(file: Path, channels: dict[str, NDArray[Any]], **header: Any) -> Path:
    with OpenEXR.File({**HEADER, **header}, channels) as made:
        made.write(str(file))
    return file


@pytest.mark.parametrize("shape", [(5, 7), (6, 4, 3)])
def test_what_is_written_is_read(shape: tuple[int, ...], tmp_path: Path) -> None:
    # Brighter than full scale, and negative, as relit images may be.
    image = (RANDOM.random(shape) * 9 - 1).astype(np.float32)
    lm.write_image(tmp_path / "a.exr", image)
    np.testing.assert_array_equal(lm.read_image(tmp_path / "a.exr"), image)
    lm.write_image(tmp_path / "a.exr", image * 2, overwrite=True)
    np.testing.assert_array_equal(lm.read_image(tmp_path / "a.exr"), image * 2)
    lm.write_image(tmp_path / "b.exr", np.full((2, 2), 300, np.uint16))
    assert lm.read_image(tmp_path / "b.exr").tolist() == [[300, 300], [300, 300]]


def test_files_of_other_programs(tmp_path: Path) -> None:
    planes = {name: RANDOM.random((5, 7)).astype(np.float16) for name in "RGB"}
    colour = np.stack([planes[name] for name in "RGB"], axis=-1).astype(np.float32)
    opaque = {"A": np.ones((5, 7), np.float16)}
    image = lm.read_image(write(tmp_path / "half.exr", {**planes, **opaque}))
    np.testing.assert_array_equal(image, colour)
    image = lm.read_image(write(tmp_path / "z.exr", {"luminance": planes["G"]}))
    np.testing.assert_array_equal(image, colour[..., 1])


def broken(how: str, file: Path) -> None:
    planes = {name: RANDOM.random((200, 300)).astype(np.float32) for name in "RGB"}
    if how == "cut":
        data = write(file, planes).read_bytes()
        file.write_bytes(data[: int(0.97 * len(data))])
    elif how == "nan":
        planes["G"][3, 4] = np.nan
        write(file, planes)
    elif how == "integers":
        write(file, {"Y": np.ones((4, 5), np.uint32)})
    elif how == "layers":
        write(file, {"left.R": planes["R"], "left.G": planes["G"]})
    elif how == "window":
        window = (np.array([0, 0], np.int32), np.array([499, 199], np.int32))
        write(file, planes, displayWindow=window)
    elif how == "see-through":
        write(file, {**planes, "A": np.full((200, 300), 0.5, np.float32)})
    else:
        file.write_bytes(b"v/1\x01 and no more")


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("cut", "damaged or truncated"),
        ("nan", r"the value at \(3, 4, 1\) is nan"),
        ("integers", "channels of several kinds"),
        ("layers", r"has the channels left\.G, left\.R"),
        ("window", "only a part of its picture"),
        ("see-through", "partly transparent"),
        ("text", "damaged or truncated"),
    ],
)
def test_what_is_refused(how: str, said: str, tmp_path: Path) -> None:
    broken(how, tmp_path / "a.exr")
    with pytest.raises(InputError, match=said):
        lm.read_image(tmp_path / "a.exr")


def test_photographs_and_views(tmp_path: Path) -> None:
    patterns = lm.BernoulliPatterns((8, 8), 24)
    light = patterns.dense() @ RANDOM.random((64, 90)) / 60
    lm.write_patterns(tmp_path / "patterns", patterns)
    (tmp_path / "photos").mkdir()
    for k, frame in enumerate(light.reshape(24, 9, 10)):
        lm.write_image(tmp_path / "photos" / f"{k}.exr", frame)
    line = f"estimate {tmp_path}/patterns {tmp_path}/photos --no-check -o {tmp_path}/scene.zarr"
    assert main(line.split()) == 0
    assert main(f"show {tmp_path}/scene.zarr dual -o {tmp_path}/dual.exr".split()) == 0
    estimate = lm.open(tmp_path / "scene.zarr")
    np.testing.assert_array_equal(lm.read_image(tmp_path / "dual.exr"), estimate.dual_image())


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lm.write_image(tmp_path / "a.exr", np.ones((2, 2)))
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"lightmatrix\[exr\]"):
        lm.read_image(tmp_path / "a.exr")
    with pytest.raises(MissingExtraError, match=r"lightmatrix\[exr\]"):
        lm.write_image(tmp_path / "b.exr", np.ones((2, 2)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
