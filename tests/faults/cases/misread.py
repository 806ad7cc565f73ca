"""What was once misread, ignored, or blamed on the wrong thing: levels, options, surroundings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightmatrix.files.images import decode_image

from ..case import Case, nothing
from ..put import array, described, text
from ..work import SHAPE
from .streams import by_shell

_RELIGHT = "relight scene.zarr {} -o new.npy"
_LEVELS = np.arange(64, dtype=np.uint8).reshape(SHAPE)


def _float_levels(folder: Path) -> None:
    """Photographs of 0 to 255, saved as float."""
    files = sorted((folder / "photos").glob("*.png"))
    frames = np.stack([decode_image(file) for file in files])
    np.save(folder / "photos.npy", frames.astype(np.float32))


def _levels() -> list[Case]:
    ten_bits = (_LEVELS.astype(np.uint16) * 16).astype(">u2").tobytes()
    folders = "estimate --patterns projected --images photos.npy -o new.zarr"
    return [
        Case(
            "a PGM whose white is 200",
            _RELIGHT.format("a.pgm"),
            "white is 200, not 255",
            text("a.pgm", b"P5 8 8 200\n" + _LEVELS.tobytes()),
        ),
        Case(
            "a pattern of 10 bits in 16, whose brightest level is not white",
            _RELIGHT.format("a.pgm"),
            "16 bits, but no level above 1008",
            text("a.pgm", b"P5 8 8 1023\n" + ten_bits),
            code=0,
        ),
        Case("photographs of 0 to 255 as float", folders, "--clip", _float_levels),
        Case(
            "a pattern barely above 1",
            _RELIGHT.format("a.npy"),
            "1.0000002",
            array("a.npy", np.full(SHAPE, 1.0000002)),
        ),
        Case(
            "an exposure of 1e-300",
            "estimate capture --no-coherent -o new.zarr",
            "an exposure of 1e-300",
            described(exposure=1e-300),
        ),
    ]


def _options() -> list[Case]:
    estimate = "estimate capture --no-coherent"
    return [
        Case("a viewer without a report", f"{estimate} -o new.zarr --viewer", "without --report"),
        Case(
            "a report where the estimate goes",
            f"{estimate} -o new.zarr --report new.zarr",
            "is where the estimate goes",
        ),
        Case(
            "a report within the estimate",
            f"{estimate} -o new.zarr --report new.zarr/report",
            "is where the estimate goes",
        ),
        Case(
            "an output where no file can be made",
            f"{estimate} -o /proc/new.zarr",
            "/proc/new.zarr: cannot be written",
        ),
        Case(
            "pictures over a store",
            "info scene.zarr --pictures scene.zarr --overwrite",
            "holds a light transport matrix",
        ),
    ]


def _surroundings() -> list[Case]:
    """Variables of the environment that our libraries read."""
    variables = {
        "MPLBACKEND": ("nonsense", "info scene.zarr --pictures new"),
        "SOURCE_DATE_EPOCH": ("yesterday", "info scene.zarr --pictures new"),
        "ZARR_THREADING__MAX_WORKERS": ("-1", "info scene.zarr"),
    }
    return [
        Case(
            f"a wrong {name}",
            command,
            f"unset {name}",
            nothing,
            scenario=by_shell(f"lm {command}", **{name: value}),
        )
        for name, (value, command) in variables.items()
    ]


# What its cases need of the work folder.
NEEDS = ("capture", "scene.zarr", "photos", "projected")

CASES = [*_levels(), *_options(), *_surroundings()]
