"""What was once misread, ignored, or blamed on the wrong thing: levels, options, surroundings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightmatrix.files.images import decode_image

from .case import Case, bear
from .put import array, described, text
from .work import SHAPE

NEEDS = ("capture", "scene.zarr", "photos", "projected")
ESTIMATE = "estimate capture --no-coherent"
LEVELS = np.arange(64, dtype=np.uint8).reshape(SHAPE)
TEN_BITS = b"P5 8 8 1023\n" + (LEVELS.astype(np.uint16) * 16).astype(">u2").tobytes()
WHITE_200 = text("a.pgm", b"P5 8 8 200\n" + LEVELS.tobytes())


def _float_levels(folder: Path) -> None:
    """Photographs of 0 to 255, saved as float."""
    files = sorted((folder / "photos").glob("*.png"))
    frames = np.stack([decode_image(file) for file in files])
    np.save(folder / "photos.npy", frames.astype(np.float32))


def _relit(file: str) -> str:
    return f"relight scene.zarr {file} -o new.npy"


CASES = [
    Case("a PGM whose white is 200", _relit("a.pgm"), "white is 200, not 255", WHITE_200),
    Case(
        "a pattern of 10 bits in 16, whose brightest level is not white",
        _relit("a.pgm"),
        "16 bits, but no level above 1008",
        text("a.pgm", TEN_BITS),
        code=0,
    ),
    Case(
        "photographs of 0 to 255 as float",
        "estimate --patterns projected --images photos.npy -o new.zarr",
        "--clip",
        _float_levels,
    ),
    Case(
        "a pattern barely above 1",
        _relit("a.npy"),
        "1.0000002",
        array("a.npy", np.full(SHAPE, 1.0000002)),
    ),
    Case(
        "an exposure of 1e-300",
        f"{ESTIMATE} -o new.zarr",
        "an exposure of 1e-300",
        described(exposure=1e-300),
    ),
    Case("a viewer without a report", f"{ESTIMATE} -o new.zarr --viewer", "without --report"),
    *(
        Case(
            f"a report at {place}",
            f"{ESTIMATE} -o new.zarr --report {place}",
            "is where the estimate goes",
        )
        for place in ("new.zarr", "new.zarr/report")
    ),
    Case(
        "an output where no file can be made",
        f"{ESTIMATE} -o /proc/new.zarr",
        "choose a folder on another disk",
    ),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_misread(case: Case, work: Path) -> None:
    bear(case, work)
