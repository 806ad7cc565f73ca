"""Rows that stay as they are: those around which nothing changed in the round before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from lightmatrix.estimators.coherent.neighbourhood import REACH
from lightmatrix.transport.sparse_rows import SparseRows

# The fact that tells by which share of its light a row changed in its last round.
CHANGE = "change"
# Rows with no larger change around them settle. After three rounds on a grid, of made-up scenes, a
# tenth to a quarter of the rows have one.
STILL = 0.02


def with_change(found: SparseRows, before: SparseRows) -> SparseRows:
    """Rows with the share of their light that changed."""
    off = np.asarray(abs(found.coefficients - before.coefficients).sum(axis=1), np.float64)
    light = np.asarray(abs(found.coefficients).sum(axis=1), np.float64)
    change = np.divide(off, light, out=(off > 0).astype(np.float64), where=light > 0)
    return replace(found, diagnostics={**found.diagnostics, CHANGE: change.astype(np.float32)})


def unsettled(rows: SparseRows, camera: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Which rows of a whole camera have a change around them, (M,)."""
    change = rows.diagnostics[CHANGE].reshape(camera)
    side = 2 * REACH + 1
    around = maximum_filter(change, size=(side, side, 1), mode="nearest")
    return np.asarray(around > STILL).ravel()


def as_they_were(rows: SparseRows) -> SparseRows:
    """Rows that were not solved again."""
    nothing = np.zeros(rows.count, np.float32)
    return replace(rows, diagnostics={**rows.diagnostics, CHANGE: nothing})


def replaced(rows: SparseRows, found: SparseRows, places: NDArray[np.int64]) -> SparseRows:
    """Rows as they were, but those at some places as they were found now."""
    order = np.arange(rows.count)
    order[places] = rows.count + np.arange(found.count)
    return SparseRows.joined([as_they_were(rows), found]).rows(order)
