"""Two cameras and two projectors, calibrated together: `python -m benchmarks.calibration`.

A chessboard of 9 x 7 corners in some poses is rendered for cameras and projectors with lenses; each
projector shows a Gray code while the other is black, and the photographs have 8 bits and noise. The
table has the RMS of each pair, and how far the turn of one device to another is from the true one,
in degrees, beside the standard error that the calibration states.

    python -m benchmarks.calibration --rows 480 --poses 8
"""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from experiments.harness import options as options_of
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.simulation.simulate import SimulatedCapture

# Corners across and down, the side of a square in mm, and the noise of a photograph as a share of
# the clip level.
BOARD, SQUARE, NOISE = (9, 7), 25.0, 0.004


def devices(rows: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64], list[float]]]:
    """Projection matrix and lens of two cameras and two projectors, around a place 900 mm away."""
    places = ((0, 0, 0), (60, -170, 20), (190, 8, 15), (-190, 8, 15))
    angles = ((0, 0, 0), (4, 10, 175), (12, 7, 0), (-12, 7, 0))
    focals, lenses = (2.4, 2.5, 2.2, 2.1), ([-0.2, 0.15], [-0.1], [-0.05], [0.0])
    found = []
    # Projectors shift their image upwards.
    for number, (place, (across, down, roll), focal) in enumerate(
        zip(places, angles, focals, strict=True)
    ):
        turn = Rotation.from_euler("yxz", [across, down, roll], degrees=True).as_matrix()
        axis = 0.66 * rows + number, (0.5 if number < 2 else 0.8) * rows
        own = np.array([[focal * rows, 0, axis[0]], [0, focal * rows, axis[1]], [0, 0, 1]])
        pose = np.column_stack([turn, -turn @ np.array(place, float)])
        found.append((own @ pose, turn, lenses[number]))
    return found


def nearest_pixels(rig: RigGeometry, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """The projector pixels (n, 2), whole numbers as (col, row), nearest to places."""
    near = np.rint(places)
    if not rig.projector_stagger:
        return near
    # A diamond is as wide as a column, and as high as two rows.
    found = []
    for down in (-1, 0, 1):
        row = near[:, 1] + down
        col = np.rint(places[:, 0] - rig.projector_stagger * (row % 2))
        pixels = np.column_stack([col, row])
        away = np.abs(rig.projector_places(pixels) - places) @ [1, 0.5]
        found.append(np.column_stack([pixels, away]))
    best = np.argmin([each[:, 2] for each in found], axis=0)
    return np.take_along_axis(np.stack(found), best[None, :, None], axis=0)[0, :, :2]


def board_capture(
    rig: RigGeometry,
    turn: NDArray[np.float64],
    middle: NDArray[np.float64],
    patterns: lm.PatternSet,
    board: tuple[int, int] | None,
    fine: int,
    noise: float = NOISE,
) -> SimulatedCapture:
    """8-bit photographs of a board, or of a blank sheet, under patterns.

    The board has so many corners (across, down) and squares of `SQUARE`, and lies in the plane
    through its `middle`, at right angles to the third axis of its `turn`. A camera pixel averages
    `fine` x `fine` points.
    """
    rows, cols = rig.camera_shape
    step = (np.arange(fine) + 0.5) / fine - 0.5
    row, col, down, across = np.meshgrid(
        np.arange(rows), np.arange(cols), step, step, indexing="ij"
    )
    rays = rig.camera_rays(np.column_stack([(col + across).ravel(), (row + down).ravel()]))
    centre = rig.camera_centre
    depth = turn[:, 2] @ (middle - centre) / (rays @ turn[:, 2])
    points = centre + depth[:, None] * rays
    light = np.full(len(points), 0.8)
    if board is not None:
        # Dark squares on light paper.
        cell = np.floor((points - middle) @ turn[:, :2] / SQUARE + (np.array(board) + 1) / 2)
        on = (cell >= 0).all(axis=1) & (cell <= board).all(axis=1)
        light[on & (cell.sum(axis=1) % 2 == 0)] = 0.15
    light /= fine**2
    lit = nearest_pixels(rig, rig.project_projector(points))
    inside = ((lit >= 0) & (lit < rig.projector_shape[::-1])).all(axis=1)
    column = (lit[inside, 1] * rig.projector_shape[1] + lit[inside, 0]).astype(np.int32)
    owner = np.repeat(np.arange(rows * cols), fine**2)[inside]
    size = rows * cols, rig.projector_shape[0] * rig.projector_shape[1]
    matrix = csr_array((light[inside].astype(np.float32), (owner, column)), shape=size)
    truth = lm.Truth(matrix, matrix.data, rig.camera_shape, rig.projector_shape)
    return lm.simulate(truth, patterns, exposure=1.0, noise=noise)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print the figures."""
    parser = options_of("benchmarks.calibration", __doc__)
    parser.add_argument("--rows", type=int, default=480, help="rows of all images")
    parser.add_argument("--poses", type=int, default=8, help="poses of the board")
    options = parser.parse_args(arguments)
    shape = options.rows, 4 * options.rows // 3
    known = devices(options.rows)
    rigs = [
        [
            RigGeometry(c, p, shape, shape, np.array(of_c), np.array(of_p))
            for p, _, of_p in known[2:]
        ]
        for c, _, of_c in known[:2]
    ]
    random = np.random.default_rng(0)
    code = lm.make_patterns("graycode", shape, inverse=False)
    poses = []
    for number in range(options.poses):
        around = 2 * np.pi * number / options.poses
        tilt = [30 * np.cos(around), 30 * np.sin(around), random.uniform(-10, 10)]
        turn = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
        middle = np.array([*random.uniform(-30, 30, 2), 900 + random.uniform(-60, 60)])
        middle[1] -= 10
        poses.append(
            [
                [board_capture(rigs[c][p], turn, middle, code, BOARD, 2) for c in (0, 1)]
                for p in (0, 1)
            ]
        )
        print(f"pose {number + 1} of {options.poses}", flush=True)
    started = time.process_time()
    measured = lm.calibrate_rig(poses, BOARD, SQUARE, units="mm")
    print(f"{measured.corners} matches of corners, {time.process_time() - started:.0f} s")
    names = ["camera 1", *measured.standard_errors]
    found = [measured.geometries[c][0].camera_matrix for c in (0, 1)]
    found += [measured.geometries[0][p].projector_matrix for p in (0, 1)]
    turns = [RigGeometry(found[0], one, shape, shape).rotation for one in found[1:]]
    turns = [np.eye(3), *turns]
    for one, other in combinations(range(4), 2):
        right = known[other][1] @ known[one][1].T
        off = Rotation.from_matrix(turns[other] @ turns[one].T @ right.T).magnitude()
        stated = f", stated {measured.standard_errors[names[other]][0]:.3f}" if one == 0 else ""
        print(f"{names[one]} to {names[other]}: {np.degrees(off):.3f} degrees off{stated}")
    for c, p in np.ndindex(2, 2):
        parts = [f"{name} {rms:.3f}" for name, rms in measured.geometries[c][p].rms.items()]
        print(f"camera {c + 1}, projector {p + 1}: RMS in pixels: {', '.join(parts)}")


if __name__ == "__main__":
    main()
