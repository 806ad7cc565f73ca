"""The test of an estimate on photographs that it has not seen.

A duality gap certifies that a solver solved its problem. Whether the solution is what the camera
sees, only unseen photographs can show. So some frames are held out, T is estimated again from the
others, and its predictions are compared with the frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import LightMatrixError
from lightmatrix.estimators.camera_window import mean_image, window_of_light
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.coherent.row_errors import FEWEST, HeldOut
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.solvers.loop import Progress
from lightmatrix.transport.matrix import LightTransport

# At most this many unseen photographs are shown and predicted. Chosen by hand: a second estimate
# needs nearly all frames.
_MOST = 4
# Cameras of more samples are tested on a rectangle of about this many, as the docs say.
MOST_ROWS = 16_384


class Estimator(Protocol):
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

    @property
    def difference(self) -> NDArray[np.float32]:
        """Predictions minus photographs, 0 where samples are not counted or both clip."""
        return np.where(self.counted, self.predictions - self.photographs, 0)


def validate(
    capture: Capture, estimator: Estimator | EstimateSettings, *, progress: Progress | None = None
) -> Validation | str:
    """Estimate T without some frames and predict them; or the reason why that is impossible.

    Cameras of more than 16,384 samples are tested on a rectangle of about as many, around the
    middle of their light.
    """
    held = HeldOut.choose(capture.patterns, judged=_MOST)
    frames = held.judged
    if capture.count < FEWEST:
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
        frames,
        images(samples.values),
        images(predictions),
        counted.T.reshape(-1, *tested.camera_shape),
        error(predictions),
        error(baseline),
        len(others),
        region,
    )
