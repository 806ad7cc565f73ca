"""What a report tells of: an estimate, its capture, and what was found out about the two."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.evaluation.estimate_errors import Errors, errors_by_rows
from lightmatrix.evaluation.metrics import relative_error, squared_errors
from lightmatrix.evaluation.verdict import (
    FAIR,
    Verdict,
    estimated_error,
    level_of,
    limited,
    percent,
    singly_clipped,
    verdict,
)
from lightmatrix.report.validation import HeldOut
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport

# A camera pixel below this share of a bright one's white level sees next to nothing.
_DARK = 0.02
# Kinds of rows are told by looking at all entries of T, zeros included.
_MOST_ENTRIES = 1 << 30
# A prediction that is no better than this share of the error of the mean photograph says little.
_BARELY_BETTER = 0.5


@dataclass(frozen=True, eq=False)
class FrameFacts:
    """What was seen in each frame.

    Parameters
    ----------
    clipped : (K,) float
        Share of the samples that count that clipped.
    level : (K,) float
        Their mean, as a share of the clip level.
    """

    clipped: NDArray[np.float64]
    level: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Facts:
    """All that the sections of a report are made from.

    Parameters
    ----------
    transport : LightTransport
        The estimate.
    capture : Capture
        What it was made from.
    truth : LightTransport or None
        T, where it is known.
    held : HeldOut or str
        Photographs held out; or why there are none, in words.
    """

    transport: LightTransport
    capture: Capture
    truth: LightTransport | None
    held: HeldOut | str

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
        """Which projector pixel each camera pixel sees most."""
        return correspondence(self.transport)

    @cached_property
    def white(self) -> NDArray[np.float32]:
        """The camera image under a white pattern, of the camera's shape."""
        return self.transport.relight(np.ones(self.transport.projector_shape, np.float32))

    @cached_property
    def dark_share(self) -> float:
        """Share of the camera pixels that the projector hardly reaches."""
        white = self.white if self.white.ndim == 2 else self.white.sum(axis=2)
        return float(np.mean(white <= _DARK * np.quantile(white, 0.99)))

    @cached_property
    def singly_clipped(self) -> float:
        """Share of the rows whose strongest single response clips at every exposure."""
        return singly_clipped(self.transport, float(self.capture.exposures.min()))

    @cached_property
    def relative_error(self) -> float | None:
        """Of T against the truth."""
        return None if self.truth is None else relative_error(self.transport, self.truth)

    @cached_property
    def errors(self) -> Errors | None:
        """Errors against the truth, over kinds of rows; None too where telling them takes long."""
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

    @cached_property
    def verdict(self) -> Verdict:
        """What to think of the estimate: by photographs held out where there are some."""
        told, errors = [], []
        if isinstance(self.held, HeldOut):
            error, trivial = self.held.error, self.held.trivial_error
            errors.append(error if error < _BARELY_BETTER * trivial else max(error, 2 * FAIR))
            count = len(self.held.frames)
            some = "1 photograph held out is" if count == 1 else f"{count} photographs held out are"
            told.append(
                f"{some} predicted within {percent(error)} (by the mean of the others: "
                f"{percent(trivial)})"
            )
        if self.relative_error is not None:
            errors.append(self.relative_error)
            told.append(f"T is within {percent(self.relative_error)} of the truth")
        stated = estimated_error(self.transport)
        if stated is not None:
            errors.append(stated)
            told.append(f"its rows state an error of T of {percent(stated)}")
        if not told:
            return verdict(self.transport, f"no photograph was held out: {self.held}")
        level, unseen = level_of(max(errors)), list[str]()
        if self.relative_error is None:
            level, unseen = limited(level, self.singly_clipped)
        return Verdict(level, "; ".join([*told, *unseen]))
