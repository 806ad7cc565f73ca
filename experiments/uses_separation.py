"""Direct and global light on the bundled scenes, by T and by its peers, sharp and out of focus."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.planning.plan import plan
from lightmatrix.simulation.realism import defocus
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.correspondence import REACH, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.separation import Separation, separate
from lightmatrix.uses.spots import entries_of

Row = dict[str, Any]
# Blurs of the projector in pixels, each with the name of its rig.
_BLURS = {"separate": 0.0, "separate, blur 1": 1.0}
# Nayar et al. 2006 shift a checkerboard by a third of its square's period, five times five ways.
_SHIFTS = 5
# Sides of the checkerboards' squares in projector pixels, of which the best one counts.
_SQUARES = (2, 3, 4, 6, 8)
# A row has direct light above this share of a bright row's (the 0.9 quantile), and none below the
# second one; rows darker than the first one in all do not count. A row without direct light is
# called direct above the third; a direct row is lost below the last share of its direct light.
_HAS, _HAS_NONE, _CALLED, _LOST = 0.02, 0.002, 0.05, 0.1
_BRIGHT = 0.9


def separation_rows(estimated: LightTransport, truth: Truth, scene: str, seed: int) -> list[Row]:
    """Errors of the direct and the global image, and of which rows are called direct."""
    rows = []
    for use, blur in _BLURS.items():
        known = defocus(truth, blur) if blur else truth
        found = _estimate(known, seed) if blur else estimated
        direct, others = _white_images(known)
        parts = separate(found)
        images = {
            "T, separated": _images(parts),
            "T, window 5 x 5": _window(found),
            "Nayar, best square": _best_checkerboards(known, seed, direct, others),
        }
        for method, (own_direct, own_others) in images.items():
            row = {"use": use, "scene": scene, "size": truth.camera_shape[0], "method": method}
            errors = {
                "direct error": _relative(own_direct, direct),
                "global error": _relative(own_others, others),
                **_counts(own_direct, direct, direct + others),
            }
            if method == "T, separated":
                errors["epipolar direction off"] = _turned(parts, known)
            rows += [{**row, "metric": name, "value": value} for name, value in errors.items()]
    return rows


def _estimate(truth: Truth, seed: int, count: int = 32, noise: float = 0.003) -> LightTransport:
    """The estimate from few Bernoulli patterns with the planner's exposure."""
    exposure = plan(truth, frames=count, noise=noise).exposure
    patterns = BernoulliPatterns(truth.projector_shape, count, seed=seed)
    return estimate(simulate(truth, patterns, exposure=exposure, noise=noise, seed=seed))


def _white_images(truth: Truth) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    direct, others = (
        np.asarray(part.sum(axis=1), np.float64).ravel() for part in (truth.direct, truth.indirect)
    )
    return direct, others


def _images(parts: Separation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    white = np.ones(parts.direct.shape[1])
    return parts.direct @ white, parts.global_ @ white


def _window(transport: LightTransport) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What lies in 5 x 5 projector pixels around the strongest one counts as direct."""
    strongest = correspondence(transport).pixel.reshape(-1, 2)
    matrix = transport.sparse
    owner, row, col = entries_of(matrix, transport.projector_shape[1])
    near = (np.abs(row - strongest[owner, 0]) <= REACH) & (
        np.abs(col - strongest[owner, 1]) <= REACH
    )
    kept = csr_array((np.where(near, matrix.data, 0), matrix.indices, matrix.indptr), matrix.shape)
    white = np.ones(matrix.shape[1])
    direct = kept @ white
    return direct, transport @ white - direct


def _best_checkerboards(
    truth: Truth, seed: int, direct: NDArray[np.float64], others: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Max-min of 25 shifted checkerboards, of the square size that suits the scene best."""
    found = [_checkerboards(truth, seed, square) for square in _SQUARES]
    errors = [_relative(one, direct) + _relative(other, others) for one, other in found]
    return found[int(np.argmin(errors))]


def _checkerboards(
    truth: Truth, seed: int, square: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nayar et al. 2006, Eq. 5 and 6, with patterns that light half of the projector."""
    row, col = np.indices(truth.projector_shape)
    shifts = [round(2 * square * number / _SHIFTS) for number in range(_SHIFTS)]
    boards = [
        ((row + down) // square + (col + right) // square) % 2
        for down in shifts
        for right in shifts
    ]
    patterns = ImagePatterns(np.stack(boards).astype(np.float32))
    # The photographs must not clip.
    exposure = 0.95 / float((truth.matrix @ patterns.images().reshape(len(boards), -1).T).max())
    capture = simulate(truth, patterns, exposure=exposure, noise=0.003, seed=seed)
    values = np.asarray(capture.samples().values, np.float64)
    high, low = values.max(axis=1), values.min(axis=1)
    return high - low, 2 * low


def _relative(found: NDArray[np.float64], known: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))


def _counts(
    found: NDArray[np.float64], direct: NDArray[np.float64], total: NDArray[np.float64]
) -> dict[str, float]:
    """Shares of rows without direct light that are called direct, and of direct rows lost."""
    bright = np.quantile(direct, _BRIGHT)
    lit = total > _HAS * np.quantile(total, _BRIGHT)
    none, has = lit & (direct < _HAS_NONE * bright), direct > _HAS * bright
    called = float((found[none] > _CALLED * bright).mean()) if none.any() else 0.0
    return {"called direct": called, "direct lost": float((found < _LOST * direct)[has].mean())}


def _turned(parts: Separation, truth: Truth) -> float:
    """Degrees between the estimate's epipolar lines and those of the true direct light."""
    known = LightTransport.from_matrix(truth.direct, truth.camera_shape, truth.projector_shape)
    away = abs(parts.geometry.direction - separate(known).geometry.direction) % 180
    return float(min(away, 180 - away))
