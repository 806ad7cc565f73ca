"""The epipolar geometry of a projector and a camera, from where camera pixels see their light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.reprs import short_repr

# Random quadruples that are tried for a first epipolar geometry, and the rows that judge them. With
# half of the rows wrong, 500 quadruples miss a right one with a probability below 1e-13.
_TRIALS = 500
_JUDGES = 4000
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


@dataclass(frozen=True, eq=False)
class EpipolarGeometry:
    """Where direct light can come from: n . (camera row, col, projector row, col) = offset.

    The affine epipolar geometry (Koenderink & van Doorn 1991): all epipolar lines are parallel,
    which holds for long lenses and shallow scenes.

    Parameters
    ----------
    normal : (4,) float64
        n; its projector part has length 1, so that distances are in projector pixels.
    offset : float
        The right-hand side.
    spread : float
        Standard deviation of the distances of good rows, in projector pixels.
    motion : (3, 2) float64
        (camera row, col, 1) @ motion is the projector pixel of the scene's mean plane.
    parallax_range : (float, float)
        Where along the line good rows lie, relative to the mean plane, in projector pixels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> geometry = lm.separate(lm.truth("l_objects").transport()).geometry
    >>> -35 < geometry.direction < -30, geometry.spread < 0.5
    (True, True)
    """

    normal: NDArray[np.float64]
    offset: float
    spread: float
    motion: NDArray[np.float64]
    parallax_range: tuple[float, float]

    __repr__ = short_repr

    @property
    def along(self) -> NDArray[np.float64]:
        """The direction of epipolar lines on the projector as (row, col), of length 1."""
        return np.array([-self.normal[3], self.normal[2]])

    @property
    def direction(self) -> float:
        """Angle of epipolar lines to the projector's rows, in degrees from -90 to 90."""
        row, col = self.along if self.along[1] >= 0 else -self.along
        return float(np.degrees(np.arctan2(row, col)))

    def distance(
        self, camera: NDArray[np.float64], projector: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Signed distances of projector pixels (n, 2) to the lines of camera pixels (n, 2)."""
        return np.asarray(camera @ self.normal[:2] + projector @ self.normal[2:] - self.offset)

    def parallax(
        self, camera: NDArray[np.float64], projector: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Places of projector pixels (n, 2) along the line, relative to the mean plane."""
        plane = camera @ self.motion[:2] + self.motion[2]
        return np.asarray((projector - plane) @ self.along)


def mean_plane(camera: NDArray[np.float64], projector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The affine map (3, 2) from camera to projector, by reweighted least squares (Cauchy)."""
    design = np.column_stack([camera, np.ones(len(camera))])
    weight = np.ones(len(camera))
    motion = np.zeros((3, 2))
    for _ in range(_REFINEMENTS):
        root = np.sqrt(weight)[:, None]
        motion = np.linalg.lstsq(design * root, projector * root, rcond=None)[0]
        error = ((projector - design @ motion) ** 2).sum(axis=1)
        weight = 1 / (1 + error / max(float(np.median(error)), _LEAST_SPREAD**2))
    return motion


def fit_epipolar(
    camera: NDArray[np.float64],
    projector: NDArray[np.float64],
    motion: NDArray[np.float64],
) -> EpipolarGeometry:
    """Fit by RANSAC, then by reweighted total least squares, to matches (n, 2) each, n >= 4."""
    points = np.concatenate([camera, projector], axis=1)
    normal, offset = _most_supported(points)
    spread = 1.0
    for _ in range(_REFINEMENTS):
        distance = points @ normal - offset
        spread = max(1.48 * float(np.median(np.abs(distance))), _LEAST_SPREAD)
        weight = 1 / (1 + (distance / (2 * spread)) ** 2) ** 2
        mean = weight @ points / weight.sum()
        centred = points - mean
        normal = _unit(np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, 0])
        offset = float(normal @ mean)
    geometry = EpipolarGeometry(normal, offset, spread, motion, (0.0, 0.0))
    on_line = np.abs(geometry.distance(camera, projector)) <= max(_SUPPORT, 2 * spread)
    place = geometry.parallax(camera[on_line], projector[on_line])
    low, high = np.quantile(place, (_STRAY, 1 - _STRAY))
    return EpipolarGeometry(normal, offset, spread, motion, (float(low), float(high)))


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
