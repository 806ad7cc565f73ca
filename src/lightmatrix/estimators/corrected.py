"""Estimates without what the rig did wrong: `lm.fit_rig`, and the corrections of `lm.estimate`."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.check.refusals import refuse_unusable
from lightmatrix.errors import InputError
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.defocused import defocused
from lightmatrix.progress import Progress
from lightmatrix.rig_model.model import RIG, RigModel
from lightmatrix.rig_model.terms import TERMS, allowed_terms
from lightmatrix.transport.matrix import LightTransport, prediction_error

# Up to eight estimates follow the first one: two suffice for six faults at once, pictures that move
# by a third of a pixel take four to eight. A correction stays if photographs held out are predicted
# better by two per cent, which chance does not reach. Terms that join later must help by a tenth,
# since what large faults leave may look like others.
_MOST_ESTIMATES, _BETTER, _CLEARLY = 8, 0.98, 0.9


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
    >>> lm.fit_rig(capture.crop((16, 16), (32, 32)))
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
    progress: Progress | None = None,
) -> tuple[RigModel, LightTransport]:
    """What the rig did wrong, and T without it; `first` is the estimate with all faults.

    A correction stays as long as photographs held out are predicted better with it.
    """
    model, best, now = RigModel(), first, capture
    before: LightTransport | None = None
    # Estimates row by row hold no photographs out.
    if not allowed or prediction_error(first) is None:
        return model, first
    # What a large fault leaves as long as it is not known well looks like others. So others are
    # looked for at first, and again once those that were found are settled.
    others = True
    for number in range(_MOST_ESTIMATES):
        better = model.refined(now, capture, best, allowed if others else tuple(model.values))
        # Terms that are found without the regression, which states errors, go first or not at all.
        alone = number == 0 and better is not None and not better.errors
        # Moved pictures are known better by a better T, also where their numbers are right.
        if not (better or others) and now.correction and now.correction.added is not None:
            better = model
        # Whether terms are there that were not known.
        more = better is not None and better.values.keys() != model.values.keys()
        left = 1.0
        if better is not None:
            moved = "shift" in better.values
            without = better.corrected(capture, _ahead(best, before if moved else None))
            transport = estimate(without)
            left = _missed(transport) / max(_missed(best), 1e-12)
            if left <= (_CLEARLY if number and more else _BETTER):
                before = best if model.values else None
                model, best, now = better, transport, without
            elif alone:
                allowed = [name for name in allowed if name not in better.values]
        if left > _BETTER and others and not alone:
            break
        others = left > _CLEARLY or alone
    # Detail between the pixels of the camera is looked for once T is known apart from it.
    for limit in (_CLEARLY, _BETTER, _BETTER) if "shift" in model.values else ():
        better = replace(model, detail=True)
        transport = estimate(better.corrected(capture, _ahead(best, before)))
        if _missed(transport) > limit * _missed(best):
            break
        model, best, before = better, transport, best if model.detail else None
    # Photographs are sharper than what a blurred T predicts, as if the camera sharpened them. So
    # beside others, or if it is the camera's sharpening, a term stays only if it helps by a tenth.
    for name in tuple(model.values):
        rest = {other: each for other, each in model.values.items() if other != name}
        if rest or name == "camera-sharpening":
            simpler = replace(model, values=rest)
            transport = estimate(simpler.corrected(capture, best)) if rest else first
            if _missed(transport) * _CLEARLY <= _missed(best):
                model, best = simpler, transport
    if "camera-blur" in allowed and (
        focused := defocused(model.corrected(capture, best), best, progress)
    ):
        blur, best = focused
        model = replace(model, values={**model.values, "camera-blur": np.array([blur])})
    provenance = {**first.provenance, "certificate": best.provenance["certificate"]}
    provenance |= {RIG: model.as_dict()} if model.names else {}
    return model, replace(best, provenance=provenance)


def _ahead(now: LightTransport, before: LightTransport | None) -> LightTransport:
    """T half a step further: the estimates of moved pictures approach T by small steps."""
    if before is None or before.background.shape != now.background.shape:
        return now
    sparse, background = 1.5 * now.sparse, 1.5 * now.background - 0.5 * before.background
    return replace(now, sparse=sparse - 0.5 * before.sparse, background=background)


def _missed(transport: LightTransport) -> float:
    """The prediction error of photographs held out; infinite if none was."""
    missed = prediction_error(transport)
    return float("inf") if missed is None else missed


def terms_to_correct(correct: str | Sequence[str]) -> tuple[str, ...]:
    """The terms that a `correct` of `estimate` allows; an InputError if it names none."""
    if correct == "none":
        return ()
    if correct == "auto":
        return tuple(TERMS)
    names = [correct] if isinstance(correct, str) else list(correct)
    terms = allowed_terms(names)
    if terms is None:
        known = sorted({each.label or name for name, each in TERMS.items()} | {"exposure"})
        hint = f"use auto, none, or some of {', '.join(known)}"
        raise InputError(f"no correction is called {', '.join(map(str, names))}", hint=hint)
    return terms
