"""The corners of a chessboard in the camera's image, and the projector pixels that light them.

The projector sees nothing, but each camera pixel knows the projector pixel that lights it. Around a
corner the board is flat and the lenses are straight enough, so that one homography leads from the
camera to the projector (Moreno & Taubin 2012). Fitted to many pixels, it takes the corner along to
a fraction of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.extras import load_opencv
from lightmatrix.transport.correspondence import Correspondence

# Homographies from many noisy matches, some of them wrong.


# Rounds of reweighting. Weights change by less than a per cent after five on real boards.
_ROUNDS = 8
# The least standard deviation of matches, in pixels, so that exact ones divide nothing by 0.
_LEAST_SPREAD = 0.01
# The median of the squared length of a two-dimensional error is 1.39 times its variance.
_MEDIAN_OF_SQUARES = 1.39


def fit_homography(
    source: NDArray[np.float64], target: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The homography (3, 3) from points (n, 2) to points (n, 2), n >= 4, with weights (n,).

    Linear least squares in coordinates of unit spread (Hartley 1997), reweighted such that matches
    that are off by several standard deviations hardly count.
    """
    before, after = _unit_spread(source), _unit_spread(target)
    start = np.column_stack([source * before[0, 0] + before[:2, 2], np.ones(len(source))])
    end = target * after[0, 0] + after[:2, 2]
    zero = np.zeros_like(start)
    rows = np.concatenate(
        [
            np.hstack([start, zero, -end[:, :1] * start]),
            np.hstack([zero, start, -end[:, 1:] * start]),
        ]
    )
    share = weight / weight.max()
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        weighted = rows * np.concatenate([share, share])[:, None]
        matrix = np.linalg.eigh(weighted.T @ rows)[1][:, 0].reshape(3, 3)
        image = start @ matrix.T
        error = ((image[:, :2] / image[:, 2:] - end) ** 2).sum(axis=1) / after[0, 0] ** 2
        variance = max(float(np.median(error)) / _MEDIAN_OF_SQUARES, _LEAST_SPREAD**2)
        share = weight / weight.max() / (1 + error / (4 * variance)) ** 2
    return np.asarray(np.linalg.inv(after) @ matrix @ before)


def moved(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) after a homography."""
    image = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(image[:, :2] / image[:, 2:])


def _unit_spread(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The map (3, 3) that moves points to the origin and gives them a mean distance of about 1."""
    middle = points.mean(axis=0)
    scale = 1 / max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean())), 1e-12)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


Shape = tuple[int, int]
# A corner's window reaches this share of a square's side, within these pixels, to every side. On
# the five poses of a real board, windows from 12 to 30 pixels gave the same corners to 0.01 pixels.
_REACH, _LEAST_REACH, _MOST_REACH = 0.4, 4, 30
# A corner needs matches at this share of its window's pixels, and this many.
_LEAST_SHARE, _FEWEST = 0.3, 16
# The window in which OpenCV refines a corner reaches this share of a square's side, within these
# pixels: larger ones average the bend of the lens, smaller ones the camera's noise.
_REFINED, _LEAST_REFINED, _MOST_REFINED = 0.14, 2, 11
# This quantile of an image becomes white, so that glare does not make the board dark.
_WHITE_QUANTILE = 0.98
_REFINEMENTS, _PRECISION = 100, 1e-3


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """The inner corners of a board, in the order of its rows.

    Parameters
    ----------
    camera : (n, 2) float64
        Their places in the camera's image as (col, row).
    projector : (n, 2) float64
        The projector pixels that light them as (col, row); NaN where too few pixels around a corner
        see the projector.
    """

    camera: NDArray[np.float64]
    projector: NDArray[np.float64]

    @property
    def lit(self) -> NDArray[np.bool_]:
        """The corners whose projector pixel is known, (n,)."""
        return np.asarray(np.isfinite(self.projector).all(axis=1))


def find_corners(white: NDArray[np.float64], board: Shape) -> NDArray[np.float64] | None:
    """The inner corners (n, 2) of a board of (corners across, down) in a white image, or None."""
    cv2 = load_opencv("finding a board", "shape")
    level = max(float(np.quantile(white, _WHITE_QUANTILE)), 1e-12)
    image = np.rint(255 * np.clip(white / level, 0, 1)).astype(np.uint8)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    try:
        good, corners = cv2.findChessboardCorners(image, board, flags=flags)
        if not good:
            # Slower, and finds boards that are blurred or unevenly lit.
            flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
            good, corners = cv2.findChessboardCornersSB(image, board, flags=flags)
    except cv2.error:
        # Images of a few pixels are too small for OpenCV's thresholds.
        return None
    if not good:
        return None
    places = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    reach = int(np.clip(_REFINED * side_of(places[:, 0], board), _LEAST_REFINED, _MOST_REFINED))
    criteria = (
        cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS,
        _REFINEMENTS,
        _PRECISION,
    )
    refined = cv2.cornerSubPix(image, places, (reach, reach), (-1, -1), criteria)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def side_of(corners: NDArray[np.floating], board: Shape) -> float:
    """Median side of the board's squares in the image, in pixels."""
    across, down = board
    grid = corners.reshape(down, across, 2)
    return float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=2)))


def light_corners(
    corners: NDArray[np.float64], matches: Correspondence, board: Shape
) -> BoardCorners:
    """The projector pixels of corners (n, 2), by a homography around each."""
    reach = int(np.clip(_REACH * side_of(corners, board), _LEAST_REACH, _MOST_REACH))
    known = np.asarray(np.isfinite(matches.place).all(axis=2))
    weight = np.where(known, matches.confidence, 0).astype(np.float64)
    if matches.uncertainty is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            weight = np.where(known, 1 / (matches.uncertainty**2).sum(axis=2), 0)
    projector = np.full_like(corners, np.nan)
    for number, corner in enumerate(corners):
        col, row = np.rint(corner).astype(int)
        rows = slice(max(row - reach, 0), row + reach + 1)
        cols = slice(max(col - reach, 0), col + reach + 1)
        use = known[rows, cols] & (weight[rows, cols] > 0)
        if use.sum() < _FEWEST or use.sum() < _LEAST_SHARE * (2 * reach + 1) ** 2:
            continue
        at = np.argwhere(use) + np.array([rows.start, cols.start])
        target = matches.place[rows, cols][use].astype(np.float64)
        matrix = fit_homography(
            at[:, ::-1].astype(np.float64), target[:, ::-1], weight[rows, cols][use]
        )
        projector[number] = moved(matrix, corner[None])[0]
    return BoardCorners(corners, projector)
