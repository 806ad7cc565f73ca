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

from lightmatrix.calibration.rig.homography import fit_homography, moved
from lightmatrix.files.extras import load_opencv
from lightmatrix.transport.correspondence import Correspondence

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
