"""Some pixels or blocks of a projector, as a pattern set of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.pattern_set import ImagePatterns


@dataclass(frozen=True, eq=False)
class RestrictedPatterns(ImagePatterns):
    """Chosen columns of a pattern set, which keeps the means of its whole patterns.

    Diffuse light comes from the whole projector, so the background's column, the patterns' means,
    must not change with the pixels that are looked at. Unlike in other sets the sum of a pattern
    is therefore not its mean times the number of pixels.

    Parameters
    ----------
    stack : (K, 1, n) float
        The chosen columns.
    whole_means : (K,) float64
        Means of the whole patterns.
    """

    whole_means: NDArray[np.float64]

    @cached_property
    def means(self) -> NDArray[np.float64]:
        return self.whole_means

    @cached_property
    def sums(self) -> NDArray[np.float64]:
        return self.matrix.sum(axis=1, dtype=np.float64)

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "restricted", "pixels": self.pixels, "count": self.count}
