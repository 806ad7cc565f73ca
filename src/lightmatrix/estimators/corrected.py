"""Estimates without what the rig did wrong: `lm.fit_rig`, and the corrections of `lm.estimate`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.check.refusals import refuse_unusable
from lightmatrix.errors import InputError
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.rig_model.model import RIG, RigModel
from lightmatrix.rig_model.terms import TERMS, allowed_terms
from lightmatrix.rig_model.torn import torn_rows
from lightmatrix.transport.matrix import LightTransport, prediction_error

# Two estimates follow the first one, which suffice for six faults at once, and up to four where
# pictures move by a third of a pixel: as long as each predicts photographs held out better by a
# tenth, and errs by more than 0.03 there, which estimates on intact rigs do not.
_ESTIMATES, _MOST_ESTIMATES, _BETTER, _INTACT = 2, 4, 0.9, 0.03


def fit_rig(capture: Capture | str | Path, transport: LightTransport | None = None) -> RigModel:
    """Find what the rig did wrong in the course of a capture, by one regression.

    Each fault changes a photograph, to first order, by a small number times an image that T
    predicts. All numbers follow by least squares from what the strongest entries of each row of T
    cannot explain (variable projection, Golub and Pereyra 1973). T is then estimated anew without
    the faults, and the numbers once more. Where no photographs are held out, as in estimates row by
    row, nothing is looked for.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture, or its folder.
    transport : LightTransport, optional
        T, estimated from this capture without any correction. None: it is estimated here.

    Returns
    -------
    RigModel
        Without names if nothing is wrong.

    Raises
    ------
    InputError
        If the capture is unusable.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.15)
    >>> lm.fit_rig(capture)
    RigModel(nothing found)
    """
    capture = open_capture(capture)
    refuse_unusable(capture)
    estimator = choose_estimator(capture)
    first = estimator.estimate(capture) if transport is None else transport
    return corrected(capture, first, estimator.estimate)[0]


def corrected(
    capture: Capture,
    first: LightTransport,
    estimate: Callable[[Capture], LightTransport],
    allowed: Sequence[str] = tuple(TERMS),
) -> tuple[RigModel, LightTransport]:
    """What the rig did wrong, and T without it; `first` is the estimate with all faults.

    A correction stays as long as photographs held out are predicted better with it.
    """
    model, best, now = RigModel(), first, capture
    # Estimates row by row hold no photographs out.
    if prediction_error(first) is None:
        return model, first
    torn = torn_rows(capture) if "torn" in allowed else None
    for number in range(_MOST_ESTIMATES):
        better: RigModel | None = RigModel({"torn": torn}) if torn is not None else None
        if number or better is None:
            better = model.refined(now, capture, best, allowed)
        if better is None:
            break
        now = better.corrected(capture, best)
        transport = estimate(now)
        before, after = prediction_error(best), prediction_error(transport)
        # Two per cent are chance: such a correction would only move the noise.
        if before is None or after is None or after > 0.98 * before:
            break
        model, best = better, transport
        if number + 1 >= _ESTIMATES and (after > _BETTER * before or after < _INTACT):
            break
    provenance = {**first.provenance, **({RIG: model.as_dict()} if model.names else {})}
    return model, replace(best, provenance=provenance)


def terms_to_correct(correct: str | Sequence[str]) -> tuple[str, ...]:
    """The terms that a `correct` of `estimate` allows.

    Raises
    ------
    InputError
        If it names none.
    """
    if correct == "none":
        return ()
    if correct == "auto":
        return tuple(TERMS)
    names = [correct] if isinstance(correct, str) else list(correct)
    terms = allowed_terms(names)
    if terms is None:
        known = sorted({each.label or name for name, each in TERMS.items()} | {"exposure"})
        raise InputError(
            f"no correction is called {', '.join(map(str, names))}",
            hint=f"use auto, none, or some of {', '.join(known)}",
        )
    return terms
