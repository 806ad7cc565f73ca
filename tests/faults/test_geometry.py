"""Calibrations without a board, and files that are no geometry or belong to another rig."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.capture.folder import write_capture

from .case import Case, bear
from .checks import holds
from .put import copy, text

NEEDS = ("capture", "lit", "scene.zarr", "holiday.jpg")
TRIANGULATE = "triangulate scene.zarr --geometry rig.json --least-probability 0 -o new.ply"
CALIBRATE = "calibrate {} --board 9x7 --square 24mm -o new.json"
_MATRIX = [[10.0, 0.0, 3.5, 0.0], [0.0, 10.0, 3.5, 0.0], [0.0, 0.0, 1.0, 0.0]]


def _geometry(**changes: object) -> str:
    """A good geometry for images of 8 x 8, with changes."""
    moved = [[10.0, 0.0, 3.5, -5.0], *_MATRIX[1:]]
    content: dict[str, object] = {
        "format": "lightmatrix-geometry",
        "version": 1,
        "camera_matrix": _MATRIX,
        "projector_matrix": moved,
        "camera_shape": [8, 8],
        "projector_shape": [8, 8],
        "camera_distortion": [0.0] * 5,
        "projector_distortion": [0.0] * 5,
    }
    return json.dumps({**content, **changes})


# The content of a file -> what the message says; tests/geometry/test_rig_geometry.py has more.
FILES: dict[str, tuple[str | bytes, str]] = {
    "a photograph": (b"\x89PNG\r\n\x1a\n\x00\xff", "cannot be read as text|no geometry"),
    "a camera of another size": (_geometry(camera_shape=[12, 10]), "12 x 10"),
    "a projector of another size": (_geometry(projector_shape=[12, 16]), "12 x 16"),
}


def _boards_without_projector(folder: Path) -> None:
    """Three poses of a board of 4 x 3 corners in the light of the room."""
    code = lm.make_patterns("graycode", (8, 8), inverse=True)
    row, col = np.indices((60, 70)) // 10
    board = np.where((row + col) % 2, 40, 200).astype(np.uint8)
    board[:10], board[-10:], board[:, :10], board[:, -10:] = 200, 200, 200, 200
    for pose in ("one", "two", "three"):
        frames = np.tile(board, (code.count, 1, 1))
        write_capture(folder / pose, code, frames, sensor=lm.Sensor())


def _files() -> list[Case]:
    return [
        Case(f"a geometry that is {name}", TRIANGULATE, says, text("rig.json", content))
        for name, (content, says) in FILES.items()
    ]


def _views() -> list[Case]:
    """The geometry in other commands; one of larger images is scaled."""
    other = text("rig.json", _geometry(camera_shape=[12, 10]))
    twice = text("rig.json", _geometry(camera_shape=[16, 16], projector_shape=[16, 16]))
    report = "estimate capture -o new.zarr --report new --geometry"
    depth = "show scene.zarr depth -o new.png"
    return [
        Case("images twice as large", TRIANGULATE, (), twice, code=0, check=holds("new.ply")),
        Case("depth of another camera", f"{depth} --geometry rig.json", "12 x 10", other),
        Case("depth without a geometry", depth, "geometry"),
        Case("a report with a geometry of another camera", f"{report} rig.json", "12 x 10", other),
        Case("a report with a photograph", f"{report} holiday.jpg", "holiday.jpg"),
    ]


def _poses() -> list[Case]:
    again = copy("capture", "again")
    several = CALIBRATE.format("capture lit again")
    only_camera = CALIBRATE.format("one two three").replace("9x7", "4x3")
    unlit = "no camera pixel sees the projector"
    values = {
        "9x7": ("size|board", ("1x7", "0x7", "nine")),
        "24mm": ("square", ("0mm", "wide", "-3", "nan", "1e999mm", "1.2.3mm")),
    }
    return [
        Case("poses without a board", several, "no board of 9 x 7", again),
        Case("a board that only the camera sees", only_camera, unlit, _boards_without_projector),
        Case("too few poses", CALIBRATE.format("capture lit"), "2 usable poses"),
        Case("a pose that is missing", CALIBRATE.format("nowhere capture lit"), "nowhere"),
        Case("a photograph", CALIBRATE.format("holiday.jpg capture lit"), "holiday.jpg"),
        *(
            Case(f"{value} for {usual}", several.replace(usual, value), says, again)
            for usual, (says, wrong) in values.items()
            for value in wrong
        ),
    ]


def _codes() -> list[Case]:
    """Captures that hold no code, and what is no correspondence."""
    triangulate = TRIANGULATE.replace("scene.zarr", "c.npz")
    graycode = "patterns graycode -k 7 --size 8x8 -o new"
    return [
        Case("random patterns to decode", "decode capture -o new.npz", "no stripes"),
        Case("a photograph for rays", triangulate, "c.npz", copy("holiday.jpg", "c.npz")),
        Case("a code of a number that it does not have", graycode, "leave the number out"),
    ]


CASES = [*_files(), *_views(), *_poses(), *_codes()]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_geometry(case: Case, work: Path) -> None:
    bear(case, work)
