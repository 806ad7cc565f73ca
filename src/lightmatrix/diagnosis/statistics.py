"""Statistics that several checks share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# The standard deviation of a normal distribution over the median of its absolute deviations.
OF_MEDIAN = 1.4826


def robust_deviation(values: NDArray[np.floating]) -> float:
    """The standard deviation of values (n,) by their median deviation, so that few count little."""
    return OF_MEDIAN * float(np.median(np.abs(values - np.median(values))))


def sums_by_group(values: NDArray[np.float64], group: NDArray[np.int64]) -> NDArray[np.float64]:
    """The sums (G, n) of the rows (m, n) whose number in `group` (m,) is the same."""
    sums = np.zeros((int(group.max(initial=0)) + 1, values.shape[1]))
    np.add.at(sums, group, values)
    return sums
