"""The epipolar geometry of a projector and a camera, from where camera pixels see their light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.geometry.matches import (
    ROBUST,
    fit_fundamental,
    fit_parallel_lines,
    spread_of_spots,
)
from lightmatrix.reprs import short_repr


@dataclass(frozen=True, eq=False)
class EpipolarGeometry:
    """Where direct light can come from: on the line F (camera row, col, 1) of the projector.

    Lines are parallel (the affine epipolar geometry, Koenderink & van Doorn 1991) unless the data
    ask for a perspective one. Long lenses and shallow scenes do with the affine one, which a
    fundamental matrix in general would fit less stably.

    Parameters
    ----------
    fundamental : (3, 3) float64
        F; direct light fulfils (projector row, col, 1) F (camera row, col, 1)' = 0.
    spread : float
        Standard deviation of the distances of good rows to their lines, in projector pixels.
    surface : (6, 2) float64
        The projector pixel of the scene's mean surface as a polynomial of second degree of the
        camera pixel: coefficients of 1, row, col, row^2, row col, col^2.
    parallax_range : (float, float)
        Where along the line good rows lie, relative to the mean surface, in projector pixels.
    middle : (float, float)
        The camera pixel for which `direction` is told: the mean of good rows.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> geometry = lm.separate(lm.truth("l_objects").transport()).geometry
    >>> -35 < geometry.direction < -30, geometry.perspective, geometry.spread < 0.5
    (True, False, True)
    """

    fundamental: NDArray[np.float64]
    spread: float
    surface: NDArray[np.float64]
    parallax_range: tuple[float, float]
    middle: tuple[float, float]

    __repr__ = short_repr

    @property
    def perspective(self) -> bool:
        """Whether epipolar lines meet in a point; else they are parallel."""
        return bool(self.fundamental[:2, :2].any())

    @property
    def direction(self) -> float:
        """Angle of epipolar lines to the projector's rows, in degrees from -90 to 90.

        Lines that meet have it at the middle of the scene.
        """
        row, col = self._along(np.array([self.middle]))[0]
        if col < 0:
            row, col = -row, -col
        return float(np.degrees(np.arctan2(row, col)))

    def distance(
        self, camera: NDArray[np.float64], projector: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Signed distances of projector pixels (n, 2) to the lines of camera pixels (n, 2)."""
        line = self._lines(camera)
        row, col = projector.T
        return np.asarray(line[:, 0] * row + line[:, 1] * col + line[:, 2])

    def parallax(
        self, camera: NDArray[np.float64], projector: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Places of projector pixels (n, 2) along the line, relative to the mean surface."""
        away = projector - on_surface(self.surface, camera)
        return np.asarray((away * self._along(camera)).sum(axis=1))

    def _lines(self, camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """Epipolar lines (n, 3) with normals of length 1."""
        line = np.column_stack([camera, np.ones(len(camera))]) @ self.fundamental.T
        return np.asarray(line / np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)[:, None])

    def _along(self, camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """The directions of epipolar lines (n, 2) as (row, col), of length 1."""
        line = self._lines(camera)
        return np.stack([-line[:, 1], line[:, 0]], axis=1)


def mean_surface(
    camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The polynomial (6, 2) from camera to projector, by reweighted least squares (Cauchy).

    Its second degree follows keystone, whose exact map, a homography, is less stable where the
    scene is not flat.
    """
    # Pixels around 0, so that squares do not dominate.
    middle, size = camera.mean(axis=0), max(float(np.ptp(camera, axis=0).max()), 1.0)
    design = _monomials((camera - middle) / size)
    weight = np.ones(len(camera))
    surface: NDArray[np.float64] = np.zeros((6, 2))
    for _ in range(ROBUST.rounds):
        root = np.sqrt(weight)[:, None]
        surface = np.asarray(np.linalg.lstsq(design * root, projector * root, rcond=None)[0])
        error = ((projector - design @ surface) ** 2).sum(axis=1)
        weight = 1 / (1 + error / max(float(np.median(error)), ROBUST.least_spread_of_spots**2))
    # The polynomial of (pixel - middle) / size as one of the pixel.
    one, row, col, row2, rowcol, col2 = surface
    row, col = row / size, col / size
    row2, rowcol, col2 = row2 / size**2, rowcol / size**2, col2 / size**2
    y, x = middle
    return np.stack(
        [
            one - row * y - col * x + row2 * y * y + rowcol * x * y + col2 * x * x,
            row - 2 * row2 * y - rowcol * x,
            col - 2 * col2 * x - rowcol * y,
            row2,
            rowcol,
            col2,
        ]
    )


def on_surface(surface: NDArray[np.float64], camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The projector pixels (n, 2) of the mean surface at camera pixels (n, 2)."""
    return np.asarray(_monomials(camera) @ surface)


def fit_epipolar(
    camera: NDArray[np.float64], projector: NDArray[np.float64], surface: NDArray[np.float64]
) -> EpipolarGeometry:
    """Fit parallel lines to matches (n, 2) each, n >= 4, or lines that meet where those miss."""
    row, col = camera.mean(axis=0)

    def fitted(fundamental: NDArray[np.float64]) -> tuple[EpipolarGeometry, float]:
        """The geometry of lines, and the share of matches that lie close to them."""
        made = EpipolarGeometry(fundamental, 0.0, surface, (0.0, 0.0), (float(row), float(col)))
        distance = made.distance(camera, projector)
        share = float((np.abs(distance) < ROBUST.support).mean())
        return replace(made, spread=spread_of_spots(distance)), share

    geometry, share = fitted(fit_parallel_lines(camera, projector))
    # A fundamental matrix has 7 unknowns, so that fewer matches hardly support it.
    if len(camera) >= 64:
        meeting, more = fitted(fit_fundamental(camera, projector))
        # Typical distances tell less than shares: a plane, to which most rows may belong, fits many
        # geometries. On scenes without perspective, rendered or of the experiment `uses`, the
        # shares differ by at most 0.001.
        if more - share > 0.02:
            geometry = meeting
    on_line = np.abs(geometry.distance(camera, projector)) <= max(
        ROBUST.support, 2 * geometry.spread
    )
    if not on_line.any():
        return geometry
    place = geometry.parallax(camera[on_line], projector[on_line])
    # A few stray rows at either end do not count.
    low, high = np.quantile(place, (0.002, 0.998))
    return replace(geometry, parallax_range=(float(low), float(high)))


def _monomials(points: NDArray[np.float64]) -> NDArray[np.float64]:
    row, col = points.T
    return np.stack([np.ones_like(row), row, col, row**2, row * col, col**2], axis=1)
