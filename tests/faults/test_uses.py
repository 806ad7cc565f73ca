"""Uses of T: pictures, masks and matrices that make no sense for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from .case import Case, bear
from .put import array, both
from .run import Limits
from .work import SHAPE, matrix, write_truth

NEEDS = ("scene.zarr", "T.npz", "shown.png", "capture")
_NAN = np.full(SHAPE, 0.5, np.float32)
_NAN[2, 3] = np.nan
_PICTURES = both(
    array("nan.npy", _NAN),
    array("wide.npy", np.ones((3, 5), np.float32)),
    array("dark.npy", np.zeros(SHAPE, np.float32)),
    array("bright.npy", np.full(SHAPE, 2, np.float32)),
)
_SEPARATE = "separate T.npz -o new"
_COMPENSATE = "compensate scene.zarr shown.png -o new.png"
_CANCEL = "compensate T.npz --cancel-global -o new.png"


def _without_direct_light(folder: Path) -> None:
    """Every camera pixel sees light from everywhere."""
    random = np.random.default_rng(0)
    write_truth(folder / "T.npz", csr_array(random.random((64, 64)).astype(np.float32)))


def _negative(folder: Path) -> None:
    write_truth(folder / "T.npz", -matrix())


def _other_camera(folder: Path) -> None:
    write_truth(folder / "other.npz", matrix()[:32], camera_shape=np.array((4, 8)))


def _matrices() -> list[Case]:
    separable = "spread over|neighbours agree"
    return [
        Case("separate without direct light", _SEPARATE, separable, _without_direct_light),
        Case("cancel global light without direct", _CANCEL, separable, _without_direct_light),
        Case("separate a signed matrix", _SEPARATE, "negative entries", _negative),
        Case(
            "compensate beside another camera",
            f"{_COMPENSATE} --beside other.npz",
            "(4, 8)",
            _other_camera,
        ),
        Case("compensate without a matrix", _COMPENSATE.replace("scene", "no"), "no.zarr"),
    ]


def _pictures() -> list[Case]:
    lines = {
        "a wanted picture with NaN": ("compensate scene.zarr nan.npy -o new.png", "nan.npy"),
        "a wanted picture above 1": ("compensate scene.zarr bright.npy -o new.png", "[0, 1]"),
        "a mask with NaN": (f"{_COMPENSATE} --mask nan.npy", "nan.npy"),
        "room light with NaN": (f"{_COMPENSATE} --black nan.npy", "nan.npy"),
        "room light of another size": (f"{_COMPENSATE} --black wide.npy", "wide.npy has shape"),
        "a pattern of another size to separate": (f"{_SEPARATE} --pattern wide.npy", "(3, 5)"),
        "a pattern with NaN to separate": (f"{_SEPARATE} --pattern nan.npy", "nan.npy"),
        "cancel global light of another size": (_CANCEL.replace("T.npz", "T.npz wide.npy"), "3, 5"),
        "cancel global light of black": (
            _CANCEL.replace("T.npz", "T.npz dark.npy"),
            "no direct light|neighbours agree",
        ),
        "a video without frames": ("compensate scene.zarr capture -o new", "capture"),
    }
    return [Case(name, line, words, _PICTURES) for name, (line, words) in lines.items()]


CASES = [
    *_matrices(),
    *_pictures(),
    *(
        Case(
            f"{room} MiB of memory: {line.split()[0]}",
            line,
            (),
            code=(0, 3),
            limits=Limits(memory=room << 20),
        )
        for room in (8, 32)
        for line in (_SEPARATE, _COMPENSATE)
    ),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_uses(case: Case, work: Path) -> None:
    bear(case, work)
