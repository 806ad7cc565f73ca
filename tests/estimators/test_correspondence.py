"""Movement of footprints: measured whatever the scale and the angle, and though most are wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

from lightmatrix.estimators.coherent.neighbourhood import measure_jacobian

CAMERA = (48, 56, 1)
PROJECTOR = (160, 160)

TURN = np.deg2rad(10)
RIGS = {
    "the same": ((1, 0), (0, 1)),
    "a quarter turn": ((0, 1), (-1, 0)),
    "mirrored": ((1, 0), (0, -1)),
    "ten degrees": ((np.cos(TURN), -np.sin(TURN)), (np.sin(TURN), np.cos(TURN))),
    "projector 2.7 times finer": ((2.7, 0), (0, 2.7)),
    "camera 8 times finer": ((0.125, 0), (0, 0.125)),
    "keystone": ((1.4, 0.2), (0.1, 0.8)),
}


def footprints(matrix: Any, wrong: float, seed: int = 0) -> csr_array:
    """One entry a row, where an affine map leads; a share of them anywhere."""
    random = np.random.default_rng(seed)
    grid = np.indices(CAMERA[:2]).reshape(2, -1) - np.array([[24], [28]])
    place = np.rint(np.asarray(matrix) @ grid + np.array([[80], [80]])).astype(int)
    other = random.integers(0, 160, place.shape)
    place = np.where(random.random(place.shape[1]) < wrong, other, place).clip(0, 159)
    pixels = place[0] * 160 + place[1]
    ones = np.ones(len(pixels), np.float32)
    return csr_array((ones, pixels, np.arange(len(pixels) + 1)), shape=(len(pixels), 160 * 160))


@pytest.mark.parametrize("wrong", [0.0, 0.7])
@pytest.mark.parametrize("rig", RIGS)
def test_it_is_found_at_any_scale_and_angle(rig: str, wrong: float) -> None:
    jacobian = measure_jacobian(footprints(RIGS[rig], wrong), CAMERA, PROJECTOR)
    inside = jacobian.reshape(*CAMERA[:2], 2, 2)[6:-6, 6:-6]
    off = np.abs(np.median(inside, axis=(0, 1)) - np.asarray(RIGS[rig]))
    # Finer than the steps of single pixels, of which a quarter is the least between two rows.
    assert off.max() <= 0.02


def test_two_surfaces_move_each_in_its_own_way() -> None:
    near, far = footprints(((1, 0), (0, 1)), 0.1), footprints(((1, 0), (0, 2)), 0.1, seed=1)
    left = (np.arange(48 * 56) % 56) < 28
    rows = csr_array(np.where(left[:, None], near.toarray(), far.toarray()))
    jacobian = measure_jacobian(rows, CAMERA, PROJECTOR).reshape(48, 56, 4)
    assert abs(np.median(jacobian[:, 6:22, 3]) - 1) <= 0.02
    assert abs(np.median(jacobian[:, 34:50, 3]) - 2) <= 0.02


def test_nothing_lit_does_not_move() -> None:
    dark = csr_array((48 * 56, 160 * 160), dtype=np.float32)
    assert not measure_jacobian(dark, CAMERA, PROJECTOR).any()
    single = csr_array(np.ones((1, 4), np.float32))
    assert not measure_jacobian(single, (1, 1, 1), (2, 2)).any()
