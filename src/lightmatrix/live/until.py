"""As many photographs as it takes: an estimate after each group of frames, until T is good enough.

The error is the one that the verdict of an estimate states: of T, or of images under photographs
that were held out. If it hardly falls any more, further patterns are not what is missing, and the
diagnostics of the rows say what is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.evaluation.judgement import OwnError, percent
from lightmatrix.evaluation.metrics import row_energies
from lightmatrix.live.session import Session
from lightmatrix.transport.matrix import LightTransport, prediction_error

# Patterns photographed between two estimates, and before the first one: fewer frames hold out too
# few for a stated error.
GROUP, FIRST = 8, 16
# More patterns do not help if the error fell by less than a tenth over this many of them. Before
# the second number, errors may stay high for a while and then fall at once, as is usual in sparse
# estimation. Both are chosen by hand.
_LOOK_BACK, _PATIENT_UNTIL = 24, 64
_LEAST_GAIN = 0.1
# A row counts as clipped if more than this share of its samples clip, and as global light if its
# strongest projector pixel holds less than the second share of it. Chosen by hand.
_CLIPPED, _GLOBAL = 0.5, 0.1
# The cause that holds more than this share of the error is named. Chosen by hand.
_MAIN_CAUSE = 0.4
_CLIPPED_ADVICE = "rows that clip in most frames: lower the exposure"
_GLOBAL_ADVICE = "light from everywhere: add patterns of coarse cells, or accept it"
_NOISE_ADVICE = "noise: expose for longer, open the aperture, or bin the camera"


# How a target begins that is an error of relit images.
_RELIGHTING = "relighting"


@dataclass(frozen=True)
class Target:
    """The error at which to stop: of T, or of images that T predicts."""

    error: float
    relighting: bool = False

    def stated(self, transport: LightTransport) -> float | None:
        """What an estimate states of this error; None if it states none."""
        return prediction_error(transport) if self.relighting else OwnError(transport).stated


@dataclass(frozen=True)
class Outcome:
    """How photographing until a target ended."""

    target: float
    relighting: bool
    # Frames and the stated relative error with them, group by group.
    errors: list[tuple[int, float]]
    reached: bool
    sentence: str


@dataclass
class Until:
    """Photographs the patterns of a session group by group.

    `estimate` returns the estimate from all frames so far.
    """

    target: Target
    estimate: Callable[[], LightTransport]
    _errors: list[tuple[int, float]] = field(default_factory=list)

    def run(self, session: Session) -> Outcome:
        """Photograph until the target is reached, or more patterns do not help or are not there."""
        total = session.patterns.count
        # A session that goes on starts with the frames that it has.
        count = max(FIRST, -(-len(session.record.state.frames) // GROUP) * GROUP)
        while True:
            count = min(count, total)
            session.run(count)
            transport = self.estimate()
            error = self.target.stated(transport)
            frames = len(session.record.state.frames)
            self._errors.append((frames, float("nan") if error is None else error))
            if error is not None and error <= self.target.error:
                return self._outcome(True, f"{percent(error)} after {frames} frames")
            if error is None and frames >= _PATIENT_UNTIL:
                reasons = [] if self.target.relighting else OwnError(transport).doubts
                return self._outcome(False, " ".join(["no error can be stated.", *reasons]))
            if self._stalled:
                return self._outcome(False, f"more patterns do not help; {_cause(transport)}")
            if count == total:
                return self._outcome(False, f"all {total} patterns are photographed: allow more")
            count += GROUP

    @property
    def _stalled(self) -> bool:
        frames, error = self._errors[-1]
        before = [e for n, e in self._errors if n <= frames - _LOOK_BACK]
        return frames >= _PATIENT_UNTIL and bool(before) and error > (1 - _LEAST_GAIN) * min(before)

    def _outcome(self, reached: bool, sentence: str) -> Outcome:
        target = self.target
        return Outcome(target.error, target.relighting, self._errors, reached, sentence)


def parse_until(text: str | float) -> Target:
    """The target of a text such as 0.03, an error of T, or relighting:0.03, of relit images."""
    kind, _, number = str(text).rpartition(":")
    try:
        error = float(number)
    except ValueError:
        error = float("nan")
    if kind not in ("", _RELIGHTING) or not 0 < error < 1:
        raise InputError(
            f"a target of {text}",
            hint="give a relative error of T, such as 0.03 for 3 %, or of relit images, such as "
            "relighting:0.03",
        )
    return Target(error, kind == _RELIGHTING)


def _cause(transport: LightTransport) -> str:
    """What most of the estimated error belongs to, and what to do about it."""
    errors = np.asarray(transport.diagnostics["estimated_error"], float)
    # Dark rows have no error of their own, or an infinite one.
    wrong = row_energies(transport) * np.where(np.isfinite(errors), errors, 0) ** 2
    total = max(float(wrong.sum()), np.finfo(float).tiny)
    clipped = np.asarray(transport.diagnostics["clipped_share"]) > _CLIPPED
    if wrong[clipped].sum() > _MAIN_CAUSE * total:
        return _CLIPPED_ADVICE
    sparse = transport.sparse
    strongest = sparse.max(axis=1).toarray().ravel()
    white = transport.relight(np.ones(transport.projector_shape, np.float32)).ravel()
    spread = strongest < _GLOBAL * white
    return _GLOBAL_ADVICE if wrong[spread].sum() > _MAIN_CAUSE * total else _NOISE_ADVICE
