"""The projected least squares: all numbers of all terms at once, and any subset of the terms.

T has swallowed a part of every fault. The strongest entries of a row and a constant are therefore
projected out of its samples and of the regressors (variable projection, Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973). What is left of the samples, r, is explained by sum_j x_j f_j:

    minimize  sum over rows m of  w_m || R_m (r_m - sum_j x_j f_jm) ||^2,

where R_m projects. A number of one frame only has a regressor that is zero in all other frames, so
its normal equations are sums over rows of products of two frames' values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.rig_model.prediction import Prediction

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Regression:
    """The normal equations of all terms of a prediction under one weight of each row.

    `regressors` are (P, m, K) by name, and `per_frame` says which have a number for each frame.
    """

    seen: Prediction
    regressors: Mapping[str, Array]
    per_frame: Mapping[str, bool]
    weight: Array

    @property
    def total(self) -> float:
        """The weighted squares that the terms could explain."""
        return float((self.weight[:, None] * self.seen.left**2).sum())

    @cached_property
    def places(self) -> dict[str, NDArray[np.int64]]:
        """Where the numbers of each term stand among all."""
        found, start = {}, 0
        for name, each in self.regressors.items():
            size = len(each) * (self.seen.count if self.per_frame[name] else 1)
            found[name] = np.arange(start, start + size)
            start += size
        return found

    @cached_property
    def equations(self) -> tuple[Array, Array]:
        """The normal matrix of all numbers, and its right side."""
        seen, weight = self.seen, self.weight[:, None]
        count = seen.count
        size = sum(map(len, self.places.values()))
        matrix, side = np.zeros((size, size)), np.zeros(size)
        single, shared = [], []
        for name, each in self.regressors.items():
            for number, values in enumerate(each):
                if self.per_frame[name]:
                    place = self.places[name][number * count : (number + 1) * count]
                    values = values * seen.usable
                    swallowed = (np.sqrt(weight) * values)[:, None, :] * seen.basis.transpose(
                        0, 2, 1
                    )
                    single.append((place, values, swallowed.reshape(-1, count)))
                else:
                    shared.append((self.places[name][number], seen.projected(values)))
        for number, (place, values, swallowed) in enumerate(single):
            side[place] = (weight * values * seen.left).sum(axis=0)
            for other, others, also in single[: number + 1]:
                block = np.diag((weight * values * others).sum(axis=0)) - swallowed.T @ also
                matrix[np.ix_(place, other)] = block
                matrix[np.ix_(other, place)] = block.T
            for one, projected in shared:
                matrix[place, one] = matrix[one, place] = (weight * values * projected).sum(axis=0)
        for one, projected in shared:
            side[one] = (weight * projected * seen.left).sum()
            for two, others in shared:
                matrix[one, two] = (weight * projected * others).sum()
        # The mean over the frames is T's own: a term that all frames share would explain nothing.
        scale = np.trace(matrix) / max(1, size)
        for place, _, _ in single:
            matrix[np.ix_(place, place)] += 10 * scale / count
        return matrix, side

    def solve(self, names: Sequence[str]) -> tuple[dict[str, Array], dict[str, Array], float]:
        """The numbers of some terms, (P,) or (P, K), their standard errors, and what they explain."""
        matrix, side = self.equations
        index = np.concatenate([self.places[name] for name in names])
        part = matrix[np.ix_(index, index)]
        scale = 1 / np.sqrt(np.maximum(np.diag(part), 1e-30))
        strength, vectors = np.linalg.eigh(part * scale * scale[:, None])
        kept = strength > 1e-6 * strength[-1]
        strength, vectors = strength[kept], vectors[:, kept]
        along = vectors.T @ (side[index] * scale)
        numbers = scale * (vectors @ (along / strength))
        errors = scale * np.sqrt((vectors**2 / strength).sum(axis=1))
        found, stated, start = {}, {}, 0
        for name in names:
            stop = start + len(self.places[name])
            shape = (len(self.regressors[name]), -1) if self.per_frame[name] else (-1,)
            found[name] = numbers[start:stop].reshape(shape)
            stated[name] = errors[start:stop].reshape(shape)
            start = stop
        return found, stated, float((along**2 / strength).sum())

    def effect(self, name: str, numbers: Array) -> Array:
        """What the samples (m, K) change by with the numbers of a term."""
        each = self.regressors[name]
        if self.per_frame[name]:
            return np.einsum("pmk,pk->mk", each, numbers)
        return np.tensordot(numbers, each, axes=1)
