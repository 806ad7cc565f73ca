"""Which terms are there: they join one after the other, as long as they explain what is left.

A projected least squares gives all numbers of all terms at once, and of any subset of them.

T has swallowed a part of every fault. The strongest entries of a row, a constant and the prediction
itself are therefore projected out of its samples and of the regressors (variable projection, Golub
and Pereyra, SIAM J. Numer. Anal. 10, 1973). What is left of the samples, r, is explained by
sum_j x_j f_j:

    minimize  sum over rows m of  w_m || R_m (r_m - sum_j x_j f_jm) ||^2,

where R_m projects. The regressor of a number of one frame is zero in all other frames, so that the
normal equations are sums over rows of products of two frames' values. The weights w_m are 1 over
the variance of what a row misses, and the standard errors are right as far as they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Term

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
    # The blocks of the normal equations that were needed so far.
    _blocks: dict[tuple[str, str], Array] = field(default_factory=dict)

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

    def solve(self, names: Sequence[str]) -> tuple[dict[str, Array], dict[str, Array], float]:
        """Numbers of some terms, (P,) or (P, K), their standard errors, and what they explain."""
        part = np.block([[self._block(one, two) for two in names] for one in names])
        left, each = self.weight[:, None] * self.seen.left, self.per_frame
        sides = ((f"pmk,mk->p{'k' * each[name]}", self._parts[name]) for name in names)
        side = np.concatenate([np.einsum(along, one, left).ravel() for along, one in sides])
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


# A term explains at least this share of what the first one does, and changes the photographs by
# this share of what was taken out before. A smaller one may be a trace of large ones.
_BESIDE = 0.1


def choose_terms(
    seen: Prediction, terms: Sequence[Term], known: Mapping[str, Array], largest: float = 0.0
) -> tuple[dict[str, Array], dict[str, Array], float]:
    """The numbers of the terms that are there, and their standard errors, by name.

    Third comes the largest share by which one of them changes the photographs. Those of `known`
    terms are steps from their values. Other terms must change the photographs by more than a tenth
    of the `largest` that was taken out before. Rows count by the inverse of what they miss anyway,
    so that glossy rows invent no curve.
    """
    # Rows tell something if three samples or more are left beside what T has swallowed.
    telling = seen.free >= 3
    found: dict[str, Array] = {}
    errors: dict[str, Array] = {}
    if telling.sum() < 100:
        return found, errors, largest
    asked = {each.name: each for each in terms}
    every = {name: each.regressors(seen) for name, each in asked.items()}
    regressors = {name: each for name, each in every.items() if each is not None}
    per_frame = {name: asked[name].per_frame for name in regressors}
    least = {
        name: Term.least if name in known else max(each.least, _BESIDE * largest)
        for name, each in asked.items()
    }
    left = seen.left
    # Once more, with the weights of what is left.
    for _ in range(2):
        missed = (left**2).sum(axis=1) / np.maximum(seen.free, 1)
        weight = np.where(telling, 1 / (missed + np.median(missed[telling])), 0)
        regression = Regression(seen, regressors, per_frame, weight)
        found, errors = _forward(regression, asked, least, known)
        if not found:
            break
        effects = [regression.effect(name, numbers) for name, numbers in found.items()]
        left = seen.left - seen.projected(sum(effects, np.zeros_like(seen.left)))
    sizes = [regression.size(*each) for each in found.items()]
    return found, errors, max([largest, *sizes])


def _forward(
    regression: Regression,
    terms: dict[str, Term],
    smallest: dict[str, float],
    known: Mapping[str, Array],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """The terms that are there, chosen by what they explain beyond chance."""
    free = float(regression.seen.free[regression.weight > 0].sum())
    chosen: list[str] = []
    found: dict[str, Array] = {}
    errors: dict[str, Array] = {}
    explained, first = 0.0, 0.0
    while True:
        candidates = []
        for name in regression.number_count:
            if name in chosen or name not in terms:
                continue
            numbers, stated, together = regression.solve([*chosen, name])
            more, rest = together - explained, regression.total - explained
            by_chance = regression.number_count[name] / free * (regression.total - together)
            # It explains at least 25 times what as many random numbers would.
            score = more - 25 * by_chance
            lowest, highest = terms[name].between
            after = numbers[name]
            if name in known:
                after = terms[name].added(known[name], after)
            if not terms[name].per_frame and not lowest <= after.sum() <= highest:
                continue
            # It explains at least a hundredth of what is left.
            if score <= 0 or more < max(0.01 * rest, _BESIDE * first):
                continue
            # A term that takes the place of a chosen one cannot be told from it.
            if any(_total(numbers[n]) < _total(found[n]) / 2 for n in chosen):
                continue
            if regression.size(name, numbers[name]) > smallest[name]:
                candidates.append((score, name, numbers, stated, together))
        best = max((each[0] for each in candidates), default=0.0)
        # Numbers that all frames share go before those of each frame. A camera with a gamma of 2.2
        # changes glossy scenes as light that varies does, and explains half of what that explains;
        # where light truly varies, no curve explains more than a fiftieth of it.
        common = [
            each for each in candidates if not terms[each[1]].per_frame and each[0] >= best / 4
        ]
        candidates = common or candidates
        # Of terms that explain nearly the same, the one with the fewest numbers is there: light
        # that varies along the rows may vary alike in all of them.
        enough = 0.75 * max((each[0] for each in candidates), default=0.0)
        alike = [each for each in candidates if each[0] >= enough]
        candidate = min(
            alike, key=lambda each: (regression.number_count[each[1]], -each[0]), default=None
        )
        if candidate is None:
            # Pictures that move are blurred in T, which looks as if the camera sharpened them.
            if "shift" in found and "camera-sharpening" in found:
                others = {name: each for name, each in terms.items() if name != "camera-sharpening"}
                return _forward(regression, others, smallest, known)
            return found, errors
        _, name, found, errors, explained = candidate
        chosen.append(name)
        first = first or explained


def _total(numbers: Array) -> float:
    """How strong a term is: the size of its numbers, or of the sum of those that frames share."""
    return float(np.std(numbers) if numbers.ndim > 1 else abs(numbers.sum()))
