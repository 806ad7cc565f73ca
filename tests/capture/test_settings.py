"""`ReadSettings`: validation, the numbers that they normalise, and the levels that they set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.cli.source import read_source
from lightmatrix.errors import InputError
from tests.helpers.captures import COUNT, SETS, photographs, write_folders


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"clip": 0}, "a clip level of 0"),
        ({"clip": [255.0, np.nan]}, "a clip level of nan"),
        ({"clip": 300, "full_scale": 255}, "a clip level of 300"),
        ({"full_scale": -1}, "a full scale of -1"),
        ({"full_scale": 2.0**33}, "a full scale of 8.58993e"),
        ({"black_level": -1}, "a black level of -1"),
        ({"black_level": 20, "clip": 10}, "a black level of 20 with a clip level of 10"),
        ({"black_level": [1, 2], "clip": [9, 9, 9]}, "2 black levels, but 3 clip levels"),
        ({"black": 3, "black_level": 3}, "black levels of 3 and 3"),
        ({"exposure": [1, 0]}, "an exposure of 0"),
        ({"exposure": [1, np.inf]}, "an exposure of"),
        ({"black": "b.png", "black_exposure": 0}, "a black exposure of 0"),
    ],
)
def test_values_out_of_range_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ReadSettings(**values)


def test_a_number_in_place_of_a_black_frame_is_a_black_level() -> None:
    settings = ReadSettings(black=3)
    assert (settings.black, settings.black_level) == (None, 3.0)


def test_lists_of_the_command_line_follow_selected_frames(tmp_path: Path) -> None:
    sensor = Sensor(exposure=np.linspace(0.5, 1.5, COUNT))
    patterns, photos = write_folders(tmp_path, SETS[3], photographs(SETS[3], sensor))
    exposures = ",".join(f"{value:.17g}" for value in np.linspace(0.5, 1.5, COUNT))
    source = read_source(patterns=patterns, images=photos, exposure=exposures, clip="255")
    capture = source.open().select([2, 5])
    np.testing.assert_allclose(capture.exposures, np.linspace(0.5, 1.5, COUNT)[[2, 5]])
    expected = Capture.from_arrays(SETS[3], photographs(SETS[3], sensor), sensor).select([2, 5])
    assert capture.digest == expected.digest


def test_settings_are_for_plain_folders_only(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a capture folder and --images, --black-level were given"):
        read_source(capture=tmp_path, images=tmp_path, black_level="3")
