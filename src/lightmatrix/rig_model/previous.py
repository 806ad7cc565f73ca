"""Light of the picture before: a slow panel, the lag of a camera."""

from __future__ import annotations

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class Previous(Term):
    """Each photograph holds a share a of the pattern before its own."""

    name = "previous"
    advice = "wait longer after each change of pattern (`lightmatrix rig settle` measures how long)"
    between = (0, 1)

    def regressors(self, seen: Prediction) -> Array:
        return seen.under(lambda images, before: before - images)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        share = float(values[0])
        draft.patterns.append(lambda images, before: (1 - share) * images + share * before)

    def added(self, values: Array, step: Array) -> Array:
        # T has taken on the light of the pattern itself, 1 - a of what it should be.
        return values + step / (1 + step)

    def sentence(self, values: Array) -> str:
        return f"each photograph shows {100 * values[0]:.1f} % of the picture before it"
