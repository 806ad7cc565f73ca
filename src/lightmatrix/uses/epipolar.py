"""The epipolar geometry of a projector and a camera, from where camera pixels see their light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.reprs import short_repr

# Random samples that are tried for a first epipolar geometry, and the rows that judge them. With
# nine of ten rows right, 500 samples of eight rows miss a right one with a probability below
# 1e-100; with six of ten, below 1e-3.
_TRIALS = 500
_JUDGES = 2000
# A row supports a geometry if it lies within this distance of its epipolar line, in projector
# pixels. Chosen by hand: places are known to about a tenth of a pixel.
_SUPPORT = 0.5
# A normal whose projector part is shorter says little about the projector; it is left out.
_LEAST_PROJECTOR_PART = 0.2
_REFINEMENTS = 20
# The least noise of places, in projector pixels, so that exact places divide nothing by 0.
_LEAST_SPREAD = 0.05
# This share of good rows at either end does not count in the range of the parallax.
_STRAY = 0.002
# Parallel lines are kept unless perspective puts this share of the rows more within `_SUPPORT` of
# their lines. Typical distances tell less: a plane, to which most rows may belong, fits many
# geometries. On scenes without perspective, rendered or of the experiment `uses`, the shares
# differ by at most 0.001.
_PERSPECTIVE_GAIN = 0.02
# The fewest rows that a fundamental matrix is fitted to; it has 7 unknowns.
_FEWEST_FOR_PERSPECTIVE = 64


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
        line = _with_ones(camera) @ self.fundamental.T
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
    for _ in range(_REFINEMENTS):
        root = np.sqrt(weight)[:, None]
        surface = np.asarray(np.linalg.lstsq(design * root, projector * root, rcond=None)[0])
        error = ((projector - design @ surface) ** 2).sum(axis=1)
        weight = 1 / (1 + error / max(float(np.median(error)), _LEAST_SPREAD**2))
    return _in_pixels(surface, middle, size)


def on_surface(surface: NDArray[np.float64], camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The projector pixels (n, 2) of the mean surface at camera pixels (n, 2)."""
    return np.asarray(_monomials(camera) @ surface)


def fit_epipolar(
    camera: NDArray[np.float64],
    projector: NDArray[np.float64],
    surface: NDArray[np.float64],
) -> EpipolarGeometry:
    """Fit parallel lines to matches (n, 2) each, n >= 4, or lines that meet where those miss."""
    row, col = camera.mean(axis=0)
    middle = (float(row), float(col))
    fundamental, spread = _affine(camera, projector)
    geometry = EpipolarGeometry(fundamental, spread, surface, (0.0, 0.0), middle)
    if len(camera) >= _FEWEST_FOR_PERSPECTIVE:
        fundamental, spread = _perspective(camera, projector)
        meeting = replace(geometry, fundamental=fundamental, spread=spread)
        gain = _support(meeting, camera, projector) - _support(geometry, camera, projector)
        if gain > _PERSPECTIVE_GAIN:
            geometry = meeting
    on_line = np.abs(geometry.distance(camera, projector)) <= max(_SUPPORT, 2 * geometry.spread)
    if not on_line.any():
        return geometry
    place = geometry.parallax(camera[on_line], projector[on_line])
    low, high = np.quantile(place, (_STRAY, 1 - _STRAY))
    return replace(geometry, parallax_range=(float(low), float(high)))


def _support(
    geometry: EpipolarGeometry, camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> float:
    """The share of matches that lie close to their lines."""
    return float((np.abs(geometry.distance(camera, projector)) < _SUPPORT).mean())


def _affine(
    camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """The fundamental matrix of parallel lines, by RANSAC and total least squares; its spread."""
    points = np.concatenate([camera, projector], axis=1)
    normal, offset = _most_supported(points)
    spread = 1.0
    for _ in range(_REFINEMENTS):
        distance = points @ normal - offset
        spread, weight = _spread_and_weights(distance)
        mean = weight @ points / weight.sum()
        centred = points - mean
        normal = _unit(np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, 0])
        offset = float(normal @ mean)
    zero = np.zeros((2, 2))
    last = np.append(normal[:2], -offset)
    return np.vstack([np.hstack([zero, normal[2:, None]]), last]), spread


def _perspective(
    camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """The fundamental matrix of matches by the eight-point algorithm, and its spread.

    Hartley, "In defense of the eight-point algorithm", PAMI 1997: RANSAC, then least squares
    reweighted by the distances in the projector.
    """
    own, of_camera = _normalized(camera)
    other, of_projector = _normalized(projector)
    products = (other[:, :, None] * own[:, None, :]).reshape(-1, 9)
    random = np.random.default_rng(0)
    judges = random.permutation(len(products))[:_JUDGES]
    chosen = products[judges[random.integers(len(judges), size=(_TRIALS, 8))]]
    candidates = np.linalg.svd(chosen)[2][:, -1].reshape(-1, 3, 3)
    scale = 1 / of_projector[0, 0]
    support = [
        int((np.abs(_distances(one, own[judges], other[judges])) * scale < _SUPPORT).sum())
        for one in candidates
    ]
    fundamental, spread = candidates[int(np.argmax(support))], 1.0
    for _ in range(_REFINEMENTS):
        line = own @ fundamental.T
        length = np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)
        spread, weight = _spread_and_weights((line * other).sum(axis=1) / length * scale)
        weight = weight / length**2
        fundamental = _of_rank_two(
            np.linalg.eigh((products * weight[:, None]).T @ products)[1][:, 0].reshape(3, 3)
        )
    return of_projector.T @ fundamental @ of_camera, spread


def _distances(
    fundamental: NDArray[np.float64], camera: NDArray[np.float64], projector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of projector points (n, 3) to the lines of camera points (n, 3)."""
    line = camera @ fundamental.T
    length = np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)
    return np.asarray((line * projector).sum(axis=1) / length)


def _spread_and_weights(distance: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """The robust standard deviation of distances, and weights that fall beyond twice of it."""
    spread = max(1.48 * float(np.median(np.abs(distance))), _LEAST_SPREAD)
    return spread, 1 / (1 + (distance / (2 * spread)) ** 2) ** 2


def _most_supported(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The hyperplane through four points that most points lie close to."""
    random = np.random.default_rng(0)
    judges = points[random.permutation(len(points))[:_JUDGES]]
    chosen = judges[random.integers(len(judges), size=(_TRIALS, 4))]
    normals = np.linalg.svd(chosen[:, 1:] - chosen[:, :1])[2][:, -1]
    length = np.linalg.norm(normals[:, 2:], axis=1)
    usable = length >= _LEAST_PROJECTOR_PART
    if not usable.any():
        usable = length == length.max()
    normals = normals[usable] / length[usable, None]
    offsets = (normals * chosen[usable, 0]).sum(axis=1)
    support = (np.abs(judges @ normals.T - offsets) < _SUPPORT).sum(axis=0)
    best = int(support.argmax())
    return normals[best], float(offsets[best])


def _unit(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The normal with a projector part of length 1."""
    return np.asarray(normal / max(float(np.linalg.norm(normal[2:])), 1e-9))


def _of_rank_two(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest matrix of rank 2, whose lines meet in one point."""
    left, values, right = np.linalg.svd(matrix)
    values[2] = 0
    return np.asarray(left * values @ right)


def _normalized(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) around 0 at a mean distance of sqrt(2), and the map (3, 3) that made them."""
    middle = points.mean(axis=0)
    away = float(np.linalg.norm(points - middle, axis=1).mean())
    scale = np.sqrt(2) / max(away, 1e-9)
    change = np.diag([scale, scale, 1.0])
    change[:2, 2] = -scale * middle
    return _with_ones(points) @ change.T, change


def _with_ones(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([points, np.ones(len(points))])


def _monomials(points: NDArray[np.float64]) -> NDArray[np.float64]:
    row, col = points.T
    return np.stack([np.ones_like(row), row, col, row**2, row * col, col**2], axis=1)


def _in_pixels(
    surface: NDArray[np.float64], middle: NDArray[np.float64], size: float
) -> NDArray[np.float64]:
    """The polynomial of (pixel - middle) / size as one of the pixel."""
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
