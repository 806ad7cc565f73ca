"""Least squares over patterns in [0, 1], by an accelerated projected gradient method."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.uses.joint_light import JointLight

# The ridge, relative to the median step bound of the projector pixels that are seen. It darkens
# pixels that no camera pixel sees, and costs no PSNR on the bundled scenes (1e-2: up to 0.8 dB).
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class BoundedFit:
    """min over p in [0, 1] of f(p) = 1/2 ||T p - y||^2_W + r/2 ||p||^2.

    FISTA (Beck & Teboulle 2009) in the metric of L = T' W T 1 + r, with the restart by gradient of
    O'Donoghue & Candes (2015). As T has no negative entries, diag(L) - T' W T is diagonally
    dominant, hence positive semidefinite: 1 / L is a safe step for each pixel by itself. Of a T
    with negative entries, L takes the magnitudes.
    """

    light: JointLight
    # (M,) float32: weights W >= 0 of the camera samples.
    weights: NDArray[np.float32]

    @cached_property
    def _bounds(self) -> NDArray[np.float32]:
        """T' W T 1, (N,), of the magnitudes of T."""
        light = self.light.without_signs
        return light.adjoint(self.weights * light.white)

    @cached_property
    def ridge(self) -> float:
        """The ridge r; positive, so that the solution is unique."""
        seen = self._bounds[self._bounds > 0]
        return _RIDGE * float(np.median(seen)) if seen.size else 1.0

    def gradient(
        self, light: NDArray[np.float32], samples: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The gradient of f, (N,), at patterns (N,) for the wanted samples y (M,)."""
        misfit = self.light.forward(light)
        misfit -= samples
        misfit *= self.weights
        gradient = self.light.adjoint(misfit)
        gradient += np.float32(self.ridge) * light
        return gradient

    def solve(
        self, samples: NDArray[np.float32], start: NDArray[np.float32], iterations: int
    ) -> NDArray[np.float32]:
        """The patterns (N,) float32 in [0, 1] after so many iterations from the start (N,)."""
        bounds = self._bounds + np.float32(self.ridge)
        pattern = np.clip(start, 0, 1).astype(np.float32)
        ahead, momentum = pattern, 1.0
        for _ in range(iterations):
            # A projected gradient step from the point ahead.
            updated = ahead - self.gradient(ahead, samples) / bounds
            np.clip(updated, 0, 1, out=updated)
            step = updated - pattern
            # Restart once the step goes against the gradient.
            if float(((ahead - updated) * bounds) @ step) > 0:
                momentum = 1.0
            grown = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = updated + np.float32((momentum - 1) / grown) * step
            pattern, momentum = updated, grown
        return pattern
