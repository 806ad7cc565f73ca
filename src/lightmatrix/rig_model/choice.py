"""Which terms are there: one after the other, as long as they explain what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.rig_model.least_squares import Regression
from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Term

Array = NDArray[np.float64]

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
