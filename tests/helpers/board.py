"""Simulated captures of a chessboard in several poses, by a rig whose geometry is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array, hstack
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from benchmarks import calibration
from lightmatrix.simulation.simulate import SimulatedCapture

BOARD, SQUARE = (7, 5), 25.0
# Turns about x, y and z in degrees, and the place of the board's middle.
POSES = (
    ((30, 0, -10), (-20, 10, 880)),
    ((-28, 8, 3), (15, -10, 920)),
    ((5, 32, 0), (10, 5, 900)),
    ((-8, -30, 15), (-10, 0, 890)),
)


def board_rig() -> lm.RigGeometry:
    """A small rig with distortion, whose camera and projector overlap 900 units away."""
    turn = Rotation.from_euler("yx", [12, -2], degrees=True).as_matrix()
    return lm.RigGeometry.from_intrinsics(
        np.array([[570.0, 0, 124], [0, 573, 88], [0, 0, 1]]),
        np.array([[480.0, 0, 96], [0, 478, 76], [0, 0, 1]]),
        turn,
        turn @ np.array([190.0, 8, 15]) * -1,
        (180, 240),
        (144, 192),
        camera_distortion=[-0.2, 0.15],
        projector_distortion=[-0.1],
        units="mm",
    )


def board_capture(
    rig: lm.RigGeometry,
    pose: tuple[Sequence[float], Sequence[float]],
    patterns: lm.PatternSet,
    *,
    noise: float = 0.004,
    squares: bool = True,
) -> SimulatedCapture:
    """8-bit photographs of the board, or of a blank sheet, under patterns."""
    angles, middle = pose
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    board = BOARD if squares else None
    return calibration.board_capture(rig, turn, np.array(middle), patterns, board, 3, noise)


def two_by_two() -> tuple[tuple[lm.RigGeometry, ...], ...]:
    """The rig, a projector on its other side, and a camera above: each camera's two geometries."""
    rig = board_rig()
    turn = Rotation.from_euler("yx", [-12, 2], degrees=True).as_matrix()
    shift = turn @ np.array([190.0, -8, -15])
    matrix = np.array([[470.0, 0, 94], [0, 472, 70], [0, 0, 1]]) @ np.column_stack([turn, shift])
    both = rig, replace(rig, projector_matrix=matrix)
    # Upside down, so that it counts the board from the other end.
    turn = Rotation.from_euler("zyx", [175, -3, -9], degrees=True).as_matrix()
    shift = -turn @ np.array([60.0, -170, 20])
    matrix = np.array([[580.0, 0, 118], [0, 580, 92], [0, 0, 1]]) @ np.column_stack([turn, shift])
    return both, tuple(replace(one, camera_matrix=matrix) for one in both)


def two_projector_capture(
    rigs: Sequence[lm.RigGeometry], pose: tuple[Sequence[float], Sequence[float]]
) -> SimulatedCapture:
    """A dark photograph of the board under projectors of one size, and its true T."""
    shape = rigs[0].projector_shape
    black = lm.ImagePatterns(np.zeros((1, *shape), np.float32))
    matrices = [board_capture(rig, pose, black).truth.matrix for rig in rigs]
    matrix = csr_array(hstack(matrices), dtype=np.float32)
    size = (len(rigs) * shape[0], shape[1])
    about = {"projectors": [list(shape)] * len(rigs)}
    truth = lm.Truth(matrix, matrix.data, rigs[0].camera_shape, size, about)
    black = lm.ImagePatterns(np.zeros((1, *size), np.float32))
    return lm.simulate(truth, black, exposure=1.0, noise=0.004)
