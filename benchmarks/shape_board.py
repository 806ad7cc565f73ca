"""Shape of a real board, and the time of a large depth map: `python -m benchmarks.shape_board`.

The captures (kamino410/procam-calibration) show a board of 9 x 7 corners and squares of 75 mm in
five poses, each under a Gray code with inverses. `BOARD` holds `graycode_pattern/` and `capture_0/`
to `capture_4/`. Four tables:

* calibration with all poses: corners that count, RMS of their residuals;
* each pose left out: the sides of its squares, by the calibration with the other four;
* pose 0 pixel by pixel: distances of the points within its corners from their plane, for places to
  a fraction of a projector pixel and for whole pixels;
* depth and layers of 1,024 x 1,024 from T in a store, of two surfaces and 18 entries a row, as
  estimates from 32 photographs have 8 to 17: seconds, and the peak memory of the process.

    python -m benchmarks.shape_board BOARD
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from experiments.harness import options as options_of
from lightmatrix.shape.calibrate import RigCalibration

BOARD, SQUARE, POSES = (9, 7), 75.0, 5
# A camera pixel is lit if white exceeds black by this share of the clip level. Chosen by hand.
LIT = 0.1
# Points of the board farther from its plane than this, in millimetres, are wrong: no part of the
# board is bent as far.
WRONG = 6.0
# The large map: pixels a side, and a block of this side for each spot of a row of T.
LARGE, SPOT = 1024, 3


def captures(folder: Path) -> list[lm.Capture]:
    """The captures of all poses."""
    patterns = folder / "graycode_pattern"
    return [lm.Capture.from_folders(patterns, folder / f"capture_{pose}") for pose in range(POSES)]


def square_sides(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sides of all squares between the corners (n, 3) of a board."""
    across, down = BOARD
    grid = points.reshape(down, across, 3)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).ravel() for axis in (0, 1)]
    return np.concatenate(steps)


def plane_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances of points (n, 3) from the plane through most of them."""
    near = np.ones(len(points), bool)
    distance = np.zeros(len(points))
    for _ in range(5):
        middle = points[near].mean(axis=0)
        normal = np.linalg.svd(points[near] - middle, full_matrices=False)[2][-1]
        distance = (points - middle) @ normal
        near = np.abs(distance) <= WRONG
    return distance


def within(corners: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The camera pixels within the outermost corners of a board."""
    across, down = BOARD
    outline = corners[[0, across - 1, across * down - 1, across * (down - 1)]]
    row, col = np.indices(shape)
    inside = Outline(outline).contains_points(np.column_stack([col.ravel(), row.ravel()]))
    return np.asarray(inside.reshape(shape))


def plane(capture: lm.Capture, measured: RigCalibration) -> None:
    """Print how far the points of pose 0 lie from one plane."""
    matches = lm.decode(capture)
    assert matches.light is not None
    board = within(measured.poses[0].camera[0], measured.geometry.camera_shape)
    lit = board & (matches.light > LIT)
    whole = replace(matches, place=np.rint(matches.place))
    for name, places in (("fractions", matches), ("whole pixels", whole)):
        shape = lm.triangulate(places, measured.geometry)
        found = lit & shape.kept
        distance = plane_distances(shape.points[found].astype(np.float64))
        right = np.abs(distance) <= WRONG
        print(
            f"pose 0, {name}: {100 * found.sum() / lit.sum():.2f} % of {lit.sum()} lit pixels have "
            f"a depth, {100 * right.mean():.2f} % of these within {WRONG:g} mm of the plane, "
            f"RMS {np.sqrt((distance[right] ** 2).mean()):.2f} mm, median distance from the camera "
            f"{np.nanmedian(shape.depth[found]):.0f} mm"
        )


def large_store(folder: Path) -> None:
    """Write T of gauze at z = 4 before a wall at z = 8 as a store, and the geometry."""
    pixel = np.arange(LARGE * LARGE)
    row, col = np.divmod(pixel, LARGE)
    steps = np.arange(SPOT) - SPOT // 2
    rows = np.clip(row[:, None] + steps, 0, LARGE - 1)
    fall = np.exp(-2 * steps**2)
    size, matrix = (len(pixel), len(pixel)), None
    # Seen from beside, gauze and wall are shifted by 20 and 10 pixels.
    for shift, share in ((20, 0.3), (10, 0.7)):
        cols = np.clip(col[:, None] - shift + steps, 0, LARGE - 1)
        places = (rows[:, :, None] * LARGE + cols[:, None, :]).reshape(-1)
        light = np.tile((share * fall[:, None] * fall).ravel(), len(pixel)).astype(np.float32)
        part = csr_array((light, places, np.arange(len(pixel) + 1) * SPOT**2), size)
        part.sum_duplicates()
        matrix = part if matrix is None else matrix + part
    shape = (LARGE, LARGE)
    known = {"footprint": np.full(size[0], 3.0), "estimated_error": np.full(size[0], 0.03)}
    known = {name: each.astype(np.float32) for name, each in known.items()}
    transport = lm.LightTransport.from_matrix(matrix, shape, shape, diagnostics=known)
    lm.save(folder / "scene.zarr", transport)
    camera = np.array([[1000.0, 0, 511.5, 0], [0, 1000, 511.5, 0], [0, 0, 1, 0]])
    projector = camera.copy()
    projector[0, 3] = -20 * 4
    lm.RigGeometry(camera, projector, shape, shape).save(folder / "rig.json")


def large_map() -> None:
    """Print the times and the peak memory of the commands, on a store that was just written."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        large_store(folder)
        for line in (
            "triangulate scene.zarr --geometry rig.json -o cloud.ply --depth depth.npy",
            "layers scene.zarr --geometry rig.json -o layers.ply",
        ):
            command = [sys.executable, "-m", "lightmatrix", *line.split()]
            started = time.perf_counter()
            before = os.times()
            subprocess.run(command, cwd=folder, check=True, capture_output=True)
            after, seconds = os.times(), time.perf_counter() - started
            processor = sum(after[2:4]) - sum(before[2:4])
            # The peak of the largest process so far, in GiB.
            memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
            print(
                f"{line.split()[0]}, {LARGE} x {LARGE} from a store: {seconds:.1f} s, "
                f"{processor:.1f} s of processor time, {memory:.2f} GiB"
            )
        depth = np.load(folder / "depth.npy")
    print(
        f"{100 * np.isfinite(depth).mean():.1f} % have a depth, median {np.nanmedian(depth):.4f} "
        "(true: 4 and 8)"
    )


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print the figures."""
    parser = options_of("benchmarks.shape_board", __doc__)
    parser.add_argument("board", type=Path, help="the folder of patterns and captures")
    options = parser.parse_args(arguments)
    large_map()
    poses = captures(options.board)
    measured = lm.calibrate_rig(poses, BOARD, SQUARE, units="mm")
    facts = measured.as_dict()
    print({name: facts[name] for name in facts if name not in ("poses", "left_out")})
    for number, pose in enumerate(measured.poses):
        others = [capture for other, capture in enumerate(poses) if other != number]
        rig = lm.calibrate_rig(others, BOARD, SQUARE, units="mm").geometry
        sides = square_sides(rig.triangulate(pose.camera[0], pose.projector[0, 0]))
        print(f"pose {number} left out: squares of {sides.mean():.2f} +- {sides.std():.2f} mm")
    plane(poses[0], measured)


if __name__ == "__main__":
    main()
