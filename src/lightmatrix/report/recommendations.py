"""What to do better next time: one sentence for each thing that was found wanting."""

from __future__ import annotations

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.evaluation.verdict import FAIR, GOOD, SINGLY_CLIPPED, percent
from lightmatrix.pictures.maps import has_diagnostic
from lightmatrix.report.facts import Facts
from lightmatrix.report.validation import HeldOut

# Of the rows: more that clip in half of their samples, that did not converge, or see no projector,
# are worth a word.
_OFTEN_CLIPPED, _UNFINISHED, _DARK = 0.1, 0.01, 0.2
# Brighter frames than this use the camera's range.
_DIM = 0.1
# Projector pixels of a footprint of a projector in focus, and the light in a large background.
_WIDE, _DIFFUSE = 12, 0.3


def advice(facts: Facts) -> tuple[str, ...]:
    """Sentences for the user, the most urgent first."""
    found = [
        *_about_exposure(facts),
        *_about_prediction(facts),
        *_about_solving(facts),
        *_about_the_rig(facts),
    ]
    return tuple(found) or (
        "Nothing was found wanting. The same exposure, patterns and number of photographs will do "
        "again.",
    )


def _about_exposure(facts: Facts) -> list[str]:
    found = []
    shares = np.asarray(facts.transport.diagnostics.get("clipped_share", np.zeros(1)))
    often = float(np.mean(shares > 0.5))
    if facts.singly_clipped > SINGLY_CLIPPED:
        found.append(
            f"{percent(facts.singly_clipped)} of the rows clip under a single projector pixel: "
            "their strongest entry is only a lower bound. Take a few frames at a quarter of the "
            "exposure (`lightmatrix plan` says how many)."
        )
    elif often > _OFTEN_CLIPPED:
        found.append(
            f"{percent(often)} of the rows clipped in more than half of their samples. Expose so "
            "that a white pattern just does not clip, or light fewer projector pixels at a time "
            "(`lightmatrix plan` on a white frame)."
        )
    brightest = float(facts.frames.level.max())
    if brightest < _DIM and float(facts.frames.clipped.max()) < 0.001:
        found.append(
            f"The brightest frame reaches {percent(brightest)} of the clip level on average and "
            f"nothing clips: {min(8.0, 0.5 / max(brightest, 1e-3)):.2g} times the exposure would "
            "leave less noise."
        )
    return found


def _about_prediction(facts: Facts) -> list[str]:
    held = facts.held
    if not isinstance(held, HeldOut):
        return [f"No photograph was held out: {held}. A few random patterns more would tell."]
    if held.error <= GOOD:
        return []
    count = facts.capture.count
    if held.error <= FAIR:
        return [
            f"Photographs held out are met within {percent(held.error)}: more patterns "
            f"({2 * count} instead of {count}) bring that down where it matters to you."
        ]
    return [
        f"Photographs held out are missed by {percent(held.error)}. Do the frames follow the "
        "patterns, linear in light, with the camera still? If so, take twice the patterns "
        f"({2 * count}), or average projector pixels (--bin-projector 2)."
    ]


def _about_solving(facts: Facts) -> list[str]:
    finished = facts.transport.diagnostics.get("converged")
    if finished is None or 1 - float(np.mean(finished)) <= _UNFINISHED:
        return []
    return [
        f"{percent(1 - float(np.mean(finished)))} of the rows reached the iteration limit: raise "
        "it with --iterations."
    ]


def _about_the_rig(facts: Facts) -> list[str]:
    found = []
    if facts.dark_share > _DARK:
        found.append(
            f"{percent(facts.dark_share)} of the camera pixels hardly see the projector: a mask "
            "(--mask) or a camera that looks at the lit part alone saves their time."
        )
    if has_diagnostic(facts.transport, "footprint"):
        size = float(np.nanmedian(facts.transport.diagnostics["footprint"]))
        if size > _WIDE:
            found.append(
                f"Footprints cover {size:.0f} projector pixels (median): focus the projector, or "
                "take more patterns."
            )
    if facts.transport.background_share > _DIFFUSE and not _mixed(facts.capture):
        found.append(
            f"{percent(facts.transport.background_share)} of the light is in the faint background: "
            "a few coarse patterns among the fine ones resolve it (`lightmatrix patterns mix`)."
        )
    return found


def _mixed(capture: Capture) -> bool:
    return int(np.max(capture.patterns.kinds)) > 0
