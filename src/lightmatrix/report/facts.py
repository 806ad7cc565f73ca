"""`Facts`: an estimate, its capture, and everything computed from the two for the report."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE
from lightmatrix.errors import LightMatrixError
from lightmatrix.estimators.camera_window import mean_image, window_of_light
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.coherent.row_errors import FEWEST, HeldOut
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.judgement import judgement as judging
from lightmatrix.judgement.evaluate import Errors, errors_by_rows
from lightmatrix.judgement.metrics import relative_error, squared_errors
from lightmatrix.progress import Progress
from lightmatrix.reprs import percent
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport

# The test of an estimate on photographs that it has not seen.
#
# A duality gap certifies that a solver solved its problem. Whether the solution is what the camera
# sees, only unseen photographs can show. So some frames are held out, T is estimated again from the
# others, and its predictions are compared with the frames.

# Cameras of more samples are tested on a rectangle of about this many, as the docs say.
MOST_ROWS = 16_384


class AnyEstimator(Protocol):
    """The estimator of the second estimate."""

    def estimate(self, capture: Capture, *, progress: Progress | None = None) -> LightTransport:
        """Estimate T from a capture."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Unseen photographs and predictions, (h, *camera_shape), in clip levels at their exposures."""

    # The frames that were held out, (h,).
    frames: NDArray[np.int64]
    photographs: NDArray[np.float32]
    predictions: NDArray[np.float32]
    # Samples that the error counts: neither masked, nor clipped in both images.
    counted: NDArray[np.bool_]
    # Relative L2 error of the predictions, and of the mean of the other photographs.
    error: float
    mean_error: float
    # Photographs that the second estimate was made from.
    others: int
    # Rows and columns of the camera that were tested; None for all.
    region: tuple[slice, slice] | None


def validate(
    capture: Capture,
    estimator: AnyEstimator | EstimateSettings,
    *,
    progress: Progress | None = None,
) -> Validation | str:
    """Estimate T without some frames and predict them; or the reason why that is impossible.

    Cameras of more than 16,384 samples are tested on a rectangle of about as many, around the
    middle of their light.
    """
    # More would leave too few for the second estimate. Chosen by hand.
    held = HeldOut.choose(capture.patterns, judged=4)
    frames = held.judged
    # Four of fewer than 16 would be missed; each row's own error holds out one at a time.
    if capture.count < FEWEST or (len(frames) and capture.count < FEWEST_BLACK_AND_WHITE):
        return f"{capture.count} photographs are too few to hold any out"
    if not len(frames):
        return "each photograph is needed, or follows from others whatever T is (as in a Gray code)"
    region = window_of_light(capture, frames, MOST_ROWS)
    tested = capture if region is None else capture.window(*region)
    others = np.setdiff1d(np.arange(capture.count), held.frames)
    try:
        seen = tested.select(others)
        if isinstance(estimator, EstimateSettings):
            estimator = choose_estimator(seen, estimator)
        transport = estimator.estimate(seen, progress=progress)
    except LightMatrixError as refusal:
        return f"the estimate is impossible without the unseen photographs ({refusal.message})"
    samples = tested.select(frames).samples()
    exposures = capture.exposures[frames].astype(np.float32)
    level = samples.clip_levels_of_all()
    patterns = np.stack([capture.patterns.images(k, k + 1)[0] for k in frames])
    light = transport.relight(patterns).reshape(len(frames), -1).T
    # Predictions clip as the camera does, so that samples clipped in both count as right.
    predictions = np.minimum(light, level)
    baseline = np.minimum(mean_image(tested, others)[:, None], level)
    counted = samples.counted

    def error(guess: NDArray[np.float32]) -> float:
        # Errors count at each frame's exposure, at which the noise of all frames is alike.
        missed, whole = ((guess - samples.values) * exposures)[counted], samples.values * exposures
        energy = float(np.square(whole[counted], dtype=np.float64).sum())
        return float(np.sqrt(np.square(missed, dtype=np.float64).sum() / max(energy, 1e-300)))

    def images(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.ascontiguousarray((values * exposures).T).reshape(-1, *tested.camera_shape)

    return Validation(
        frames, images(samples.values), images(predictions),
        counted.T.reshape(-1, *tested.camera_shape), error(predictions), error(baseline),
        len(others), region,
    )  # fmt: skip


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
    def own(self) -> judging.OwnError:
        """What the diagnostics say of the error."""
        return judging.OwnError(self.transport)

    @cached_property
    def relative_error(self) -> float | None:
        """Relative error of T, where the truth is known."""
        return None if self.truth is None else relative_error(self.transport, self.truth)

    @cached_property
    def errors(self) -> Errors | None:
        """Errors over kinds of rows, where the truth is known and T is not too large."""
        # Finding the diffuse rows of matrices with more entries, zeros included, takes minutes.
        if self.truth is None or self.transport.shape[0] * self.transport.shape[1] > 1 << 30:
            return None
        return errors_by_rows(self.transport, self.truth, float(self.capture.exposures.max()))

    @property
    def diffuse_error(self) -> float:
        """Relative error over the rows that hardly see direct light; 0 where that is unknown."""
        known = {} if self.errors is None else self.errors.as_dict()
        return known.get("relative_error_diffuse", 0.0)

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
    def relighting_verdict(self) -> judging.Verdict:
        """The verdict on T's predictions, by the unseen photographs where there are any."""
        if not isinstance(self.validation, Validation):
            return judging.relighting_verdict(
                self.transport, judging.stored_findings(self.transport)
            )
        error = float(np.hypot(_validation_error(self.validation), self.own.beyond_clip))
        level = "doubtful" if self.own.light_doubts else judging.level_of(error)
        sentence = _validation_sentence(self.validation)
        return judging.Verdict(level, None, (sentence, *self.own.light_doubts, *self.own.warnings))

    @cached_property
    def verdict(self) -> judging.Verdict:
        """The verdict by the worst of the prediction error, the true and the estimated error."""
        own = self.own
        errors = [] if own.stated is None else [own.stated]
        reasons = list[str]()
        if isinstance(self.validation, Validation):
            errors.append(_validation_error(self.validation))
            reasons.append(_validation_sentence(self.validation))
        if self.relative_error is not None:
            errors.append(self.relative_error)
            reasons.append(f"Error of T against the truth: {percent(self.relative_error)}.")
        if self.diffuse_error > 2 * judging.GOOD:
            reasons.append(
                f"In rows that hardly see direct light it is {percent(self.diffuse_error)}."
            )
        if not errors:
            why = f"It was not tested on unseen photographs: {self.validation}."
            return judging.verdict_by_rows(self.transport, why)
        level = judging.level_of(max(errors))
        if self.relative_error is None:
            if own.doubts:
                level = "doubtful"
            reasons += [*own.doubts, *own.warnings]
        return judging.Verdict(level, own.stated, tuple(reasons))


def _validation_error(validation: Validation) -> float:
    """The prediction error; doubtful where the mean photograph predicts nearly as well."""
    error, baseline = validation.error, validation.mean_error
    # The mean photograph knows nothing of T. The factor was chosen by hand.
    return error if error < 0.5 * baseline else max(error, 2 * judging.FAIR)


def _validation_sentence(validation: Validation) -> str:
    count = len(validation.frames)
    photographs = "1 unseen photograph" if count == 1 else f"{count} unseen photographs"
    return (
        f"Prediction error on {photographs}: {percent(validation.error)} "
        f"(guessing the average photograph: {percent(validation.mean_error)})."
    )
