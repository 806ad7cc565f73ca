"""`Facts`: an estimate, its capture, and everything computed from the two for the report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.evaluation.evaluate import Errors, errors_by_rows
from lightmatrix.evaluation.judgement import (
    FAIR,
    OwnError,
    Verdict,
    level_of,
    limited,
    percent,
    relighting_verdict,
    singly_clipped,
    stored_findings,
    verdict_by_rows,
)
from lightmatrix.evaluation.metrics import relative_error, squared_errors
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.report.validation import Validation
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport

# A camera pixel hardly sees the projector if its white level is below this share of a bright one's
# (0.99 quantile). Chosen by hand, as in `planning`.
_DARK = 0.02
# Errors over kinds of rows are computed only if T has at most this many entries, zeros included:
# finding the diffuse rows of larger matrices takes minutes.
_MOST_ENTRIES = 1 << 30
# An estimate is doubtful if its prediction error exceeds this share of the error of the mean
# photograph, which knows nothing of T. Chosen by hand.
_BARELY_BETTER = 0.5


@dataclass(frozen=True, eq=False)
class FrameFacts:
    """The share of clipped samples of each frame, (K,), and its mean relative to the clip level."""

    clipped: NDArray[np.float64]
    level: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Facts:
    """What the sections of a report show."""

    transport: LightTransport
    capture: Capture
    truth: LightTransport | None
    # The test on unseen photographs, or the reason why there is none.
    validation: Validation | str
    # Where camera and projector stand, if known.
    geometry: RigGeometry | None = None

    @cached_property
    def frames(self) -> FrameFacts:
        """Clipping and brightness of each frame."""
        count = max(1, int(self.capture.valid.sum()))
        clipped, level = np.zeros(self.capture.count), np.zeros(self.capture.count)
        for _, tile in self.capture.tiles():
            clipped += tile.clipped.sum(axis=0)
            level += tile.values.sum(axis=0, dtype=np.float64)
        return FrameFacts(clipped / count, level / count * self.capture.exposures)

    @cached_property
    def correspondence(self) -> Correspondence:
        """The projector pixel that each camera pixel sees most."""
        return correspondence(self.transport)

    @cached_property
    def white(self) -> NDArray[np.float32]:
        """The camera image under a white pattern, of the camera's shape."""
        return self.transport.relight(np.ones(self.transport.projector_shape, np.float32))

    @cached_property
    def dark_share(self) -> float:
        """Share of the camera pixels that hardly see the projector."""
        white = self.white if self.white.ndim == 2 else self.white.sum(axis=2)
        return float(np.mean(white <= _DARK * np.quantile(white, 0.99)))

    @cached_property
    def singly_clipped(self) -> float:
        """Share of the rows whose strongest single response clips at every exposure."""
        return singly_clipped(self.transport, float(self.capture.exposures.min()))

    @cached_property
    def relative_error(self) -> float | None:
        """Relative error of T, where the truth is known."""
        return None if self.truth is None else relative_error(self.transport, self.truth)

    @cached_property
    def errors(self) -> Errors | None:
        """Errors over kinds of rows, where the truth is known and T is not too large."""
        if self.truth is None or self.transport.shape[0] * self.transport.shape[1] > _MOST_ENTRIES:
            return None
        return errors_by_rows(self.transport, self.truth, float(self.capture.exposures.max()))

    @cached_property
    def row_errors(self) -> NDArray[np.float64] | None:
        """Relative error of each camera pixel's rows, (rows, cols); NaN where T is dark."""
        if self.truth is None:
            return None
        shape = (*self.transport.camera_shape[:2], -1)
        wrong, total = (
            part.reshape(shape).sum(axis=2) for part in squared_errors(self.transport, self.truth)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(total > 0, np.sqrt(wrong / total), np.nan)

    @property
    def relighting_verdict(self) -> Verdict:
        """The verdict on T's predictions, by the unseen photographs where there are any."""
        if not isinstance(self.validation, Validation):
            return relighting_verdict(self.transport, stored_findings(self.transport))
        error = _validation_error(self.validation)
        return Verdict(level_of(error), None, (_validation_sentence(self.validation),))

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict by the worst of the prediction error, the true and the estimated error."""
        own = OwnError(self.transport)
        errors = [] if own.stated is None else [own.stated]
        reasons = list[str]()
        if isinstance(self.validation, Validation):
            errors.append(_validation_error(self.validation))
            reasons.append(_validation_sentence(self.validation))
        if self.relative_error is not None:
            errors.append(self.relative_error)
            reasons.append(f"Error of T against the truth: {percent(self.relative_error)}.")
        if not errors:
            why = f"It was not tested on unseen photographs: {self.validation}."
            return verdict_by_rows(self.transport, why)
        level = level_of(max(errors))
        if self.relative_error is None:
            level, warnings = limited(level, self.singly_clipped)
            if own.doubts:
                level = "doubtful"
            reasons += [*own.doubts, *warnings]
        return Verdict(level, own.stated, tuple(reasons))


def _validation_error(validation: Validation) -> float:
    """The prediction error; doubtful where the mean photograph predicts nearly as well."""
    error, baseline = validation.error, validation.mean_error
    return error if error < _BARELY_BETTER * baseline else max(error, 2 * FAIR)


def _validation_sentence(validation: Validation) -> str:
    count = len(validation.frames)
    photographs = "1 unseen photograph" if count == 1 else f"{count} unseen photographs"
    return (
        f"Prediction error on {photographs}: {percent(validation.error)} "
        f"({percent(validation.mean_error)} for the mean photograph)."
    )
