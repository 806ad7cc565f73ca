"""Projector pixels that lose light beside dark ones: liquid crystals, small mirrors."""

from __future__ import annotations

from functools import partial

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


def neighbours(images: Array) -> Array:
    """Means of the left and right, and of the upper and lower neighbours, (2, n, rows, cols)."""
    padded = np.pad(images, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across = (padded[:, 1:-1, :-2] + padded[:, 1:-1, 2:]) / 2
    down = (padded[:, :-2, 1:-1] + padded[:, 2:, 1:-1]) / 2
    return np.stack([across, down])


class Crosstalk(Term):
    """A pixel loses a share of its light for each dark neighbour: p (1 - sum_j a_j (1 - n_j))."""

    name = "crosstalk"
    advice = "use patterns of larger pixels"
    # On grey patterns, T itself errs by about half of this.
    least = 0.01
    between = (0, 1)

    def regressors(self, seen: Prediction) -> Array:
        def lost(images: Array, before: Array, side: int) -> Array:
            return -images * (1 - neighbours(images)[side])

        return np.stack([seen.under(partial(lost, side=side)) for side in (0, 1)])

    def take_out(self, values: Array, draft: Draft) -> None:
        def dimmed(images: Array, before: Array) -> Array:
            dark = 1 - neighbours(images)
            return images * (1 - np.tensordot(values, dark, axes=1))

        draft.patterns.append(dimmed)

    def sentence(self, values: Array) -> str:
        return f"a projector pixel between dark ones loses {100 * values.sum():.0f} % of its light"
