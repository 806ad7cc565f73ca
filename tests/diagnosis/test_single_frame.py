"""One photograph by itself: clipped, dark, or that of before."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.diagnosis.single_frame import check_frame

CAMERA = lm.Decoder(clip=255, full_scale=255)


def kinds(image: NDArray[np.generic], decoder: lm.Decoder = CAMERA, **options: object) -> list[str]:
    found = check_frame(image, decoder, **options)  # type: ignore[arg-type]
    assert all(each.frames == (options.get("index", 0),) for each in found)
    return [each.kind for each in found]


def image(level: int) -> NDArray[np.uint8]:
    return np.full((30, 40), level, np.uint8)


def test_two_thirds_may_clip() -> None:
    for columns, found in ((26, []), (27, ["light"])):
        bright = image(100)
        bright[:, :columns] = 255
        assert kinds(bright) == found


def test_eight_levels_above_black_are_light() -> None:
    assert kinds(image(7)) == ["frame"]
    assert kinds(image(9)) == []
    assert kinds(image(7), lit=False) == []
    above = lm.Decoder(clip=255, full_scale=255, black_level=20)
    assert kinds(image(27), above) == ["frame"]
    assert kinds(image(29), above) == []
    # One bright pixel is no light.
    glint = image(0)
    glint[3, 3] = 255
    assert kinds(glint) == ["frame"]


def test_levels_are_those_of_the_frame_whatever_its_exposure() -> None:
    exposures = lm.Decoder(clip=255, full_scale=255, exposure=np.array([1.0, 0.1, 0.1]))
    for index in (0, 1):
        assert kinds(image(7), exposures, index=index) == ["frame"]
        assert kinds(image(9), exposures, index=index) == []


def test_floats_are_never_dark() -> None:
    floats = np.full((30, 40), 0.001, np.float32)
    assert kinds(floats, lm.Decoder(clip=1, full_scale=1)) == []


@pytest.mark.parametrize("index", [0, 3])
def test_the_frame_of_before_is_recognised(index: int) -> None:
    assert kinds(image(100), index=index, previous=image(100)) == ["order"]
    other = image(100)
    other[0, 0] += 1
    assert kinds(image(100), index=index, previous=other) == []
