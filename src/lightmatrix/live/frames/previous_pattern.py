"""How much of the pattern shown before is in a frame.

A picture that comes late may come within the exposure. The frame is then (1 - a) times its own
pattern's and a times that of the pattern before, and a is found by weighted least squares, with a
standard error, from what is predicted for both. The frame's own contrast and level are fitted too:
predictions err in these, by more than the shares that matter and in all samples alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Standard errors of a share beyond which it is doubted that there is none, and beyond which it is
# certain that there is one.
_DOUBTED, _CERTAIN = 1.5, 5.0
# Shares that add less light than this, or less than the noise, do no harm. One that does is doubted
# unless chance takes so many standard errors off it, which it does once in 40 times.
_HARMLESS, _MISSED = 0.01, 2.0
# Rows at one end of the image: among so many looks, some go far by chance, and errors of the
# prediction are alike where they are near to each other.
_TORN, _TORN_ERRORS = 0.015, 6.0
# Samples at one end of the image that tell of a torn frame; one alone may be a glint.
_FEWEST_TORN = 4


@dataclass(frozen=True)
class Mixture:
    """Share of another pattern in a frame.

    Parameters
    ----------
    share : float
        All over the frame.
    error : float
        Standard error of it.
    torn : bool
        Whether some rows at the top or bottom show the other pattern.
    contrast : float
        How far apart the light of both patterns is (root mean square), in levels.
    """

    share: float
    error: float
    torn: bool
    contrast: float

    def excluded(self, noise: float) -> bool:
        """Whether no share that does harm is in the frame.

        Parameters
        ----------
        noise : float
            Standard deviation of a sample, in levels.
        """
        harmful = max(_HARMLESS, noise / max(self.contrast, 1e-9))
        seen = (_DOUBTED + _MISSED) * self.error <= harmful
        return seen and self.share <= _DOUBTED * self.error

    def said(self) -> str | None:
        """What is wrong with the frame; None if nothing is certain."""
        if self.share > _CERTAIN * self.error:
            return f"shows {100 * min(self.share, 1):.0f} % of the pattern before"
        if self.torn:
            return "shows some of the pattern before in some of its rows"
        return None


def find_mixture(
    missed: NDArray[np.float64],
    other: NDArray[np.float64],
    own: NDArray[np.float64],
    error: NDArray[np.float64],
    rows: NDArray[np.int64],
) -> Mixture:
    """How much of another pattern a frame shows, all over or from some row up or down.

    Parameters
    ----------
    missed : (m,) float
        What each sample is off the prediction of its own pattern.
    other, own : (m,) float
        The predictions of the other pattern and of its own.
    error : (m,) float
        Standard deviation of what is missed where all is right.
    rows : (m,) int
        The image row of each sample.
    """
    known, _ = np.linalg.qr(np.column_stack([own, np.ones_like(own)]) / error[:, None])

    def besides(values: NDArray[np.float64]) -> NDArray[np.float64]:
        weighted = values / error
        return np.asarray(weighted - known @ (known.T @ weighted))

    left, towards = besides(missed), besides(other)
    order = np.argsort(rows, kind="stable")
    scale = max(1.0, float(np.sqrt((left**2).mean())))
    torn = False
    for ordered in (order[::-1], order):
        weight = np.maximum(np.cumsum(towards[ordered] ** 2), 1e-9)
        share = np.cumsum(left[ordered] * towards[ordered]) / weight
        clear = (share > _TORN) & (share * np.sqrt(weight) > _TORN_ERRORS * scale)
        torn = torn or bool(clear[_FEWEST_TORN - 1 :].any())
    contrast = float(np.sqrt(((other - own) ** 2).mean()))
    return Mixture(float(share[-1]), scale / float(np.sqrt(weight[-1])), torn, contrast)
