"""How much of the pattern shown before a frame contains.

An image that comes late may come within the exposure. The frame is then (1 - a) times its own
pattern's and a times that of the pattern before. Weighted least squares fits the share a and its
standard error, from predictions for both patterns. The frame's own contrast and level are fitted
too: predictions are off in these, in all samples alike, by more than the shares that matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# In standard errors of a share: beyond the first it is doubtful whether there is none, beyond the
# second it is certain that there is one. Chosen by hand; `python -m tests.live.rig_mixtures`
# measures what passes.
_DOUBTED, _CERTAIN = 1.5, 5.0
# Shares below this are harmless, and so are those that add less light than the noise. A larger
# share is doubted unless chance lowers it by this many standard errors, which happens once in 40
# times.
_HARMLESS, _MISSED = 0.01, 2.0
# Rows at one end of the image are torn if their share is above the first and above so many standard
# errors. The bound is high because many rows are tested, and because predictions of neighbouring
# rows err alike. Chosen by hand.
_TORN, _TORN_ERRORS = 0.015, 6.0
# A torn part is recognized by this many samples at least; a single one may be a glint.
_FEWEST_TORN = 4


@dataclass(frozen=True)
class Mixture:
    """Share of another pattern in a frame."""

    # The share over the whole frame, and its standard error.
    share: float
    error: float
    # Whether some rows at the top or bottom show the other pattern.
    torn: bool
    # Difference between the light of both patterns (root mean square), in levels.
    contrast: float

    def excluded(self, noise: float) -> bool:
        """Whether no harmful share is in the frame; `noise` is that of a sample, in levels."""
        harmful = max(_HARMLESS, noise / max(self.contrast, 1e-9))
        visible = (_DOUBTED + _MISSED) * self.error <= harmful
        return visible and self.share <= _DOUBTED * self.error

    def complaint(self) -> str | None:
        """What is wrong with the frame; None if nothing is certain."""
        if self.share > _CERTAIN * self.error:
            return f"shows {100 * min(self.share, 1):.0f} % of the pattern before"
        if self.torn:
            return "shows some of the pattern before in some of its rows"
        return None


def fit_mixture(
    missed: NDArray[np.float64],
    other: NDArray[np.float64],
    own: NDArray[np.float64],
    error: NDArray[np.float64],
    rows: NDArray[np.int64],
) -> Mixture:
    """Fit the share of another pattern in a frame, as a whole and from each row up and down.

    All are (m,): what the own pattern's prediction `missed`, both predictions, the standard
    deviation of `missed` where all is right, and each sample's image row.
    """
    nuisance, _ = np.linalg.qr(np.column_stack([own, np.ones_like(own)]) / error[:, None])

    def without_nuisance(values: NDArray[np.float64]) -> NDArray[np.float64]:
        weighted = values / error
        return np.asarray(weighted - nuisance @ (nuisance.T @ weighted))

    rest, towards = without_nuisance(missed), without_nuisance(other)
    order = np.argsort(rows, kind="stable")
    scale = max(1.0, float(np.sqrt((rest**2).mean())))
    torn = False
    # The last cumulative sums of the second direction are those of the whole frame.
    for ordered in (order[::-1], order):
        weight = np.maximum(np.cumsum(towards[ordered] ** 2), 1e-9)
        share = np.cumsum(rest[ordered] * towards[ordered]) / weight
        clear = (share > _TORN) & (share * np.sqrt(weight) > _TORN_ERRORS * scale)
        torn = torn or bool(clear[_FEWEST_TORN - 1 :].any())
    contrast = float(np.sqrt(((other - own) ** 2).mean()))
    return Mixture(float(share[-1]), scale / float(np.sqrt(weight[-1])), torn, contrast)
