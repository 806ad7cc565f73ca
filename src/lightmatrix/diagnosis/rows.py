"""Which camera pixels can be told by: those that vary much and clip little."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.survey import Survey

# Camera pixels that clip more often are only used where there are too few others.
_CLIPPED = (0.02, 0.1, 0.2, 0.3, 0.5)
# Of the spread of the most lively pixels.
_LIVELY = 0.15
# Correlations with all projector pixels, in multiplications: about half a second.
_WORK = 6e9
FEWEST, MOST = 40, 600


def lively_rows(survey: Survey) -> NDArray[np.int64]:
    """Rows of the survey whose samples tell most, at random among equals; sorted, perhaps none."""
    known = survey.statistics
    usable = survey.valid & survey.inner & (known.highest > known.lowest)
    if not usable.any():
        return np.empty(0, np.int64)
    wanted = int(np.clip(_WORK / (survey.count * survey.patterns.pixels), FEWEST, MOST))
    lively = usable & (known.spread > _LIVELY * np.quantile(known.spread[usable], 0.9))
    generator = np.random.default_rng(0)
    found: list[NDArray[np.int64]] = []
    left, least = wanted, -1.0
    for most in _CLIPPED:
        some = np.flatnonzero(lively & (known.clipped > least) & (known.clipped <= most))
        found.append(generator.permutation(some)[:left])
        left, least = left - len(found[-1]), most
    return np.sort(np.concatenate(found))
