"""The projected least squares: all numbers of all terms at once, and any subset of the terms.

T has swallowed a part of every fault. The strongest entries of a row, a constant and the prediction
itself are therefore projected out of its samples and of the regressors (variable projection, Golub
and Pereyra, SIAM J. Numer. Anal. 10, 1973). What is left of the samples, r, is explained by
sum_j x_j f_j:

    minimize  sum over rows m of  w_m || R_m (r_m - sum_j x_j f_jm) ||^2,

where R_m projects. The regressor of a number of one frame is zero in all other frames, so that the
normal equations are sums over rows of products of two frames' values. The weights w_m are 1 over
the variance of what a row misses, and the standard errors are right as far as they are.
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
    def number_count(self) -> dict[str, int]:
        """How many numbers each term has."""
        return {
            name: len(each) * (self.seen.count if self.per_frame[name] else 1)
            for name, each in self.regressors.items()
        }

    @cached_property
    def _parts(self) -> dict[str, Array]:
        """The usable part of each regressor, (P, m, K); projected if all frames share a number."""
        seen = self.seen
        return {
            name: each * seen.usable
            if self.per_frame[name]
            else np.stack([seen.projected(one) for one in each])
            for name, each in self.regressors.items()
        }

    def _swallowed(self, one: Array, two: Array) -> Array:
        """The inner products (K, K) of what the strongest pixels hold of two values (m, K)."""
        basis, root = self.seen.basis, np.sqrt(self.weight)[:, None]
        total = np.zeros((self.seen.count, self.seen.count))
        # Rows are taken some at a time, so that the products with the basis stay in the cache.
        step = max(1, (1 << 18) // (basis.shape[1] * basis.shape[2]))
        for start in range(0, len(basis), step):
            some = slice(start, start + step)
            first, second = (
                ((root[some] * each[some])[:, None, :] * basis[some]).reshape(-1, len(total))
                for each in (one, two)
            )
            total += first.T @ second
        return total

    @cached_property
    def _blocks(self) -> dict[tuple[str, str], Array]:
        return {}

    def _block(self, one: str, two: str) -> Array:
        """The normal equations between the numbers of two terms, made when they are needed."""
        if (one, two) in self._blocks:
            return self._blocks[one, two]
        first, second = self._parts[one], self._parts[two]
        weight, count = self.weight[:, None], self.seen.count
        if self.per_frame[one] and self.per_frame[two]:
            blocks = [[np.empty((count, count))] * len(second) for _ in first]
            for i, f in enumerate(first):
                for j, g in enumerate(second):
                    # The blocks of a term with itself lie symmetrically.
                    if one == two and j < i:
                        blocks[i][j] = blocks[j][i].T
                        continue
                    blocks[i][j] = np.diag((weight * f * g).sum(axis=0)) - self._swallowed(f, g)
            block = np.block(blocks)
            if one == two:
                # The mean over the frames is T's own: a change that all share explains nothing. A
                # strong penalty, ten times the mean of the diagonal, holds it at 0.
                mean = np.full((count, count), 10 * np.trace(block) / len(block) / count)
                block += np.kron(np.eye(len(first)), mean)
        elif self.per_frame[one]:
            block = np.einsum("pmk,jmk->pkj", weight * first, second).reshape(-1, len(second))
        elif self.per_frame[two]:
            block = self._block(two, one).T
        else:
            block = np.einsum("imk,jmk->ij", weight * first, second)
        self._blocks[one, two], self._blocks[two, one] = block, block.T
        return block

    def _right_hand_side(self, name: str) -> Array:
        along = "pmk,mk->pk" if self.per_frame[name] else "pmk,mk->p"
        return np.einsum(along, self._parts[name], self.weight[:, None] * self.seen.left).ravel()

    def solve(self, names: Sequence[str]) -> tuple[dict[str, Array], dict[str, Array], float]:
        """Numbers of some terms, (P,) or (P, K), their standard errors, and what they explain."""
        part = np.block([[self._block(one, two) for two in names] for one in names])
        side = np.concatenate([self._right_hand_side(name) for name in names])
        scale = 1 / np.sqrt(np.maximum(np.diag(part), 1e-30))
        strength, vectors = np.linalg.eigh(part * scale * scale[:, None])
        # Weaker directions are rounding errors of regressors that depend on each other.
        kept = strength > 1e-6 * strength[-1]
        strength, vectors = strength[kept], vectors[:, kept]
        along = vectors.T @ (side * scale)
        numbers = scale * (vectors @ (along / strength))
        errors = scale * np.sqrt((vectors**2 / strength).sum(axis=1))
        found, stated, start = {}, {}, 0
        for name in names:
            stop = start + self.number_count[name]
            shape = (len(self.regressors[name]), -1) if self.per_frame[name] else (-1,)
            found[name] = numbers[start:stop].reshape(shape)
            stated[name] = errors[start:stop].reshape(shape)
            start = stop
        return found, stated, float((along**2 / strength).sum())

    @cached_property
    def _counted(self) -> Array:
        """The weight of each sample, (m, K)."""
        return self.weight[:, None] * self.seen.usable

    def size(self, name: str, numbers: Array) -> float:
        """The share by which a term changes the photographs (root mean square)."""
        change = (self._counted * self.effect(name, numbers) ** 2).sum()
        return float(np.sqrt(change / (self._counted * self.seen.predicted**2).sum()))

    def effect(self, name: str, numbers: Array) -> Array:
        """What the samples (m, K) change by with the numbers of a term."""
        each = self.regressors[name]
        if self.per_frame[name]:
            return np.einsum("pmk,pk->mk", each, numbers)
        return np.tensordot(numbers, each, axes=1)
