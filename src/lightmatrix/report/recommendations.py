"""Recommendations for the next capture, one sentence or two for each problem."""

from __future__ import annotations

import numpy as np

from lightmatrix.evaluation.judgement import FAIR, GOOD, SINGLY_CLIPPED, percent
from lightmatrix.pictures.maps import has_diagnostic
from lightmatrix.report.facts import Facts
from lightmatrix.report.validation import Validation

# The report recommends something if more than these shares of the rows clip in half of their
# samples, do not converge, or hardly see the projector. All limits here were chosen by hand.
_OFTEN_CLIPPED, _UNFINISHED, _DARK = 0.1, 0.01, 0.2
# A longer exposure is recommended if the brightest frame's mean lies below this share of the clip
# level and hardly any sample clips. It is to reach half of the clip level in one step of at most 8.
_DIM, _HARDLY_ANY = 0.1, 0.001
_WANTED_LEVEL, _LONGEST_STEP = 0.5, 8.0
# A projector in focus has footprints of fewer projector pixels than this (median over the rows).
_WIDE = 12
# A background that holds more than this share of the light is worth coarse patterns.
_DIFFUSE = 0.3


def recommendations(facts: Facts) -> tuple[str, ...]:
    """Recommendations for the user, the most urgent first."""
    sentences = [
        *_about_exposure(facts),
        *_about_prediction(facts),
        *_about_convergence(facts),
        *_about_the_rig(facts),
    ]
    return tuple(sentences) or (
        "Nothing needs to change: use the same exposure, patterns and number of photographs.",
    )


def _about_exposure(facts: Facts) -> list[str]:
    sentences = []
    shares = np.asarray(facts.transport.diagnostics.get("clipped_share", np.zeros(1)))
    often = float(np.mean(shares > 0.5))
    if facts.singly_clipped > SINGLY_CLIPPED:
        sentences.append(
            f"{percent(facts.singly_clipped)} of the rows clip under a single projector pixel, so "
            "their strongest entry is only a lower bound. Take a few frames at a quarter of the "
            "exposure (`lightmatrix plan` says how many)."
        )
    elif often > _OFTEN_CLIPPED:
        sentences.append(
            f"{percent(often)} of the rows clipped in more than half of their samples. Choose an "
            "exposure at which a white pattern just does not clip, or light fewer projector pixels "
            "at a time (`lightmatrix plan` on a white frame)."
        )
    brightest = float(facts.frames.level.max())
    if brightest < _DIM and float(facts.frames.clipped.max()) < _HARDLY_ANY:
        factor = min(_LONGEST_STEP, _WANTED_LEVEL / max(brightest, 1e-3))
        sentences.append(
            f"The brightest frame reaches {percent(brightest)} of the clip level on average, and "
            f"nothing clips. An exposure {factor:.2g} times as long would leave less noise."
        )
    return sentences


def _about_prediction(facts: Facts) -> list[str]:
    validation = facts.validation
    if not isinstance(validation, Validation):
        return [
            f"The estimate was not tested on unseen photographs: {validation}. A few more random "
            "patterns would make a test possible."
        ]
    if validation.error <= GOOD:
        return []
    error = f"Prediction error on unseen photographs: {percent(validation.error)}."
    count = facts.capture.count
    if validation.error <= FAIR:
        return [f"{error} More patterns ({2 * count} instead of {count}) would lower it."]
    return [
        f"{error} Check that the frames follow the patterns, that they are linear in light and "
        f"that the camera did not move. If so, take twice the patterns ({2 * count}), or average "
        "projector pixels (--bin-projector 2)."
    ]


def _about_convergence(facts: Facts) -> list[str]:
    converged = facts.transport.diagnostics.get("converged")
    if converged is None or 1 - float(np.mean(converged)) <= _UNFINISHED:
        return []
    return [
        f"{percent(1 - float(np.mean(converged)))} of the rows reached the iteration limit. Raise "
        "it with --iterations."
    ]


def _about_the_rig(facts: Facts) -> list[str]:
    sentences = []
    transport = facts.transport
    if facts.dark_share > _DARK:
        sentences.append(
            f"{percent(facts.dark_share)} of the camera pixels hardly see the projector. A mask "
            "(--mask), or a camera that sees only the lit part, saves their time."
        )
    if has_diagnostic(transport, "footprint"):
        size = float(np.nanmedian(transport.diagnostics["footprint"]))
        if size > _WIDE:
            sentences.append(
                f"Footprints cover {size:.0f} projector pixels (median). Focus the projector, or "
                "take more patterns."
            )
    is_mixed = int(np.max(facts.capture.patterns.kinds)) > 0
    if transport.background_share > _DIFFUSE and not is_mixed:
        sentences.append(
            f"{percent(transport.background_share)} of the light is in the faint background. A few "
            "coarse patterns among the fine ones resolve it (`lightmatrix patterns mix`)."
        )
    return sentences
