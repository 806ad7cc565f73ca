"""Compensation and inverse light on the bundled scenes, judged through the true T."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.simulation import library
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.compensation import compensate, compensator
from lightmatrix.uses.inverse_light import cancel_global

# The wanted picture is a white photograph of another scene; its brightest hundredth is white.
_PICTURE, _OTHER_PICTURE, _WHITE = "gripper", "l_objects", 0.99
# A pixel is reachable if more than this share of its white light is direct, and if what it wants is
# between the global light that it gets anyway and its light under white.
_DIRECT = 0.3
Row = dict[str, Any]


def wanted_picture(scene: str, side: int) -> NDArray[np.float32]:
    """A picture, (side, side) in [0, 1], that has nothing to do with the scene."""
    other = library.truth(_OTHER_PICTURE if scene == _PICTURE else _PICTURE, (side, side))
    image = np.asarray(other.matrix.sum(axis=1), np.float32).reshape(side, side)
    return np.clip(image / np.quantile(image, _WHITE), 0, 1)


def compensation_rows(estimate: LightTransport, truth: Truth, scene: str) -> list[Row]:
    """PSNR in dB of the true photographs under patterns by gains, by the estimate and by T.

    The error is relative to wanted white, over pixels that can be reached.
    """
    side = truth.camera_shape[0]
    wanted, known = wanted_picture(scene, side), truth.transport()
    found = compensate(estimate, wanted)
    shared = compensator(estimate)
    best = compensate(known, wanted, brightness=found.scale / _white_level(known))
    # All three are asked for the same light.
    target = found.target.ravel()
    gains = shared.light.split(np.clip(shared.start(target), 0, 1))[0]
    reachable = _reachable(truth, best.pattern, target) & shared.lit
    rows = [
        _row(scene, side, "compensate", "reachable share", float(reachable.mean())),
        _row(scene, side, "compensate", "brightness", found.brightness),
    ]
    shown = {"pixel gains": gains, "estimate": found.pattern, "true T": best.pattern}
    for method, pattern in shown.items():
        missed = (known.relight(pattern).ravel() - target)[reachable] / found.scale
        psnr = float(-10 * np.log10(np.mean(missed**2)))
        rows.append(_row(scene, side, "compensate", "PSNR", psnr, method))
    return rows


def inverse_light_rows(estimate: LightTransport, truth: Truth, scene: str) -> list[Row]:
    """Relative L2 distances to direct light alone, before and after global light is cancelled."""
    side = truth.camera_shape[0]
    white = np.ones(truth.projector_shape, np.float32)
    direct = truth.direct @ white.ravel()
    rows = []
    shown = {"white pattern": white, "estimate": cancel_global(estimate).pattern}
    for method, pattern in shown.items():
        missed = truth.matrix @ pattern.ravel() - direct
        residue = float(np.linalg.norm(missed) / np.linalg.norm(direct))
        rows.append(_row(scene, side, "cancel global", "residue", residue, method))
    return rows


def _white_level(transport: LightTransport) -> float:
    shared = compensator(transport)
    return float(np.median(shared.light.white[shared.lit]))


def _reachable(
    truth: Truth, pattern: NDArray[np.float32], target: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Camera pixels of which the true T says that the picture can be reached, (M,)."""
    white = np.ones(pattern.size, np.float32)
    direct, total = truth.direct @ white, truth.matrix @ white
    others = truth.indirect @ pattern.ravel()
    return np.asarray((direct > _DIRECT * total) & (others <= target) & (target <= others + direct))


def _row(
    scene: str, side: int, use: str, metric: str, value: float, method: str = "estimate"
) -> Row:
    return {
        "use": use, "scene": scene, "size": side, "method": method, "metric": metric,
        "value": value,
    }  # fmt: skip
