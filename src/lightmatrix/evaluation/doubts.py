"""What is wrong with T although unseen photographs are predicted well, and the error to state.

Photographs held out of an estimate do not show what is wrong with all photographs alike, nor what
none of them shows. Its rows tell some of this (`lightmatrix.estimators.coherent.row_errors`). Where
they do, no error of T is stated, and the reason stands in its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import rank_filter

from lightmatrix.evaluation.metrics import row_energies
from lightmatrix.transport.matrix import LightTransport

# All values were chosen on the training half of the honesty benchmark, 180 captures of 16 x 16 and
# 32 x 32 pixels (python -m benchmarks.honesty).
#
# Light that does not follow the brightness of patterns, relative to the mean sample: intact
# captures have at most .03, those with a pedestal or a leak .09 to .45.
_CONSTANT = 0.05
# Residuals that bend with the prediction, relative to the contrast of rows: intact captures have
# -.003 at least, those through a gamma curve -.07 to -.013.
_BENT = -0.01
# Share of the squared light in rows that are only bounded: intact captures have .6 at most, those
# exposed four times too long .7 to 1. Below it, such rows err by about the second value, relative
# to their length: .04 to .17.
_BOUNDED, BOUNDED_ERROR = 0.65, 0.12
# A sample lies in a highlight if three of its eight neighbours clip in almost as large a share of
# the frames. Chosen on the bundled scene `metal`: its brightest pixel clips in .81 of 32 frames,
# its neighbours in up to .72. Pixels around a lone glint clip in few.
_HIGHLIGHT, _APART = 3, 0.15


@dataclass(frozen=True, eq=False)
class OwnError:
    """What the diagnostics of an estimate say of its error, each computed once."""

    transport: LightTransport

    @cached_property
    def doubts(self) -> list[str]:
        """Why no error of T can be stated, in sentences; none for most estimates."""
        return [*self._doubts()]

    @cached_property
    def stated(self) -> float | None:
        """The relative error of T that the estimate states.

        It follows from the estimated errors of its rows and from the share of the light that only
        has a lower bound. None if no row has an estimated error, or if there are `doubts`.
        """
        if self.estimated is None or self.doubts:
            return None
        return float(np.hypot(self.estimated, BOUNDED_ERROR * np.sqrt(self._bounded_share)))

    @cached_property
    def estimated(self) -> float | None:
        """The relative error of T that follows from the estimated errors of its rows.

        It is ||error of T|| / ||T|| in the Frobenius norm, over the rows that have an estimate of
        their error; None if no row has.
        """
        errors = _diagnostic(self.transport, "estimated_error")
        known = np.flatnonzero(np.isfinite(errors))
        if not known.size:
            return None
        energy = self._energies[known]
        total = float(energy.sum())
        wrong = float((energy * errors[known] ** 2).sum())
        return float(np.sqrt(wrong / total)) if total else float(np.median(errors[known]))

    @cached_property
    def _energies(self) -> NDArray[np.float64]:
        return row_energies(self.transport)

    @cached_property
    def _bounded_share(self) -> float:
        """Share of the squared light in rows that are only bounded."""
        bounded = _diagnostic(self.transport, "only_bounded")
        total = float(self._energies.sum())
        return float(self._energies[bounded > 0].sum()) / total if bounded.size and total else 0.0

    def _doubts(self) -> Iterator[str]:
        transport = self.transport
        light = np.asarray(transport.sparse.sum(axis=1), float).ravel()
        light = light + transport.background.sum(axis=1, dtype=float)
        constant = _mean(_diagnostic(transport, "constant_light"), light)
        if constant > _CONSTANT:
            yield (
                f"About {100 * constant:.0f} % of the light does not follow the patterns: an "
                "electronic pedestal, light of the room, or a projector whose black is not dark. "
                "Take a photograph under a black pattern, and give it as --black."
            )
        if _mean(_diagnostic(transport, "bend"), self._energies) < _BENT:
            yield (
                "Bright samples are darker than T predicts: the camera does not seem linear in "
                "light. Give its response (--response), or take raw photographs."
            )
        glints = _glints(transport)
        if glints:
            pixels = "1 camera sample clips" if glints == 1 else f"{glints} camera samples clip"
            yield (
                f"{pixels} in most photographs, and none shows how bright it is: a glint, or a "
                "hot pixel. Mask it, or add photographs of shorter exposure."
            )
        elif self._bounded_share > _BOUNDED:
            yield (
                "Most of the light comes from camera pixels that clip whenever the projector pixel "
                "that they see is lit. Add photographs of shorter exposure."
            )


def _glints(transport: LightTransport) -> int:
    """Number of camera samples that may be far brighter than their bound.

    Where neighbours clip nearly as often, the sample lies in a highlight, and is about as bright.
    """
    glint = _diagnostic(transport, "glint") > 0
    if not glint.any():
        return 0
    rows, cols = transport.camera_shape[:2]
    image = _diagnostic(transport, "clipped_share").reshape(rows, cols, -1)
    neighbours = rank_filter(image, -1 - _HIGHLIGHT, size=(3, 3, 1))
    return int((glint & (image - neighbours > _APART).ravel()).sum())


def _diagnostic(transport: LightTransport, name: str) -> NDArray[np.float64]:
    return np.asarray(transport.diagnostics.get(name, np.zeros(0)), float)


def _mean(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """The weighted mean of what is known; 0 if nothing is."""
    known = np.isfinite(values)
    if not known.any() or not weights[known].sum():
        return 0.0
    return float(np.average(values[known], weights=weights[known]))
