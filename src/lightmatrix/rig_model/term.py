"""The base class of the terms: one thing that a rig does wrong."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.rig_model.prediction import Prediction

Array = NDArray[np.float64]
# From patterns as images (n, rows, cols), and those of the frames before, to what is shown.
PatternChange = Callable[[Array, Array], Array]
# From images of the camera, (1, rows, cols, channels, K) with a margin, and the places of their
# inner pixels from 0 to 1, (2, rows, cols), to what is added to the inner ones.
ImageChange = Callable[[NDArray[Any], Array], Array]


@dataclass
class Draft:
    """The correction of a capture while the terms write it."""

    capture: Capture
    gain: Array
    ambient: Array
    profile: Array | None = None
    lag: NDArray[np.int64] | None = None
    patterns: list[PatternChange] = field(default_factory=list)
    images: list[ImageChange] = field(default_factory=list)
    # `shift` says where each frame lies, (2, K), in camera pixels down and to the right. Terms that
    # move or brighten images undo it in `back`, for what T p misses.
    shift: Array | None = None
    back: list[ImageChange] = field(default_factory=list)


class Term(ABC):
    """One thing that a rig does wrong, with P unknown numbers, or P of each frame, (P, K).

    The photographs change by the sum of each number times its regressor, an image of m samples.
    """

    # `per_frame` terms have numbers for each frame. T is that of the first frame, whose numbers are
    # 0 (`of_first_frame`), or of the mean over all frames.
    name: ClassVar[str]
    per_frame: ClassVar[bool] = False
    of_first_frame: ClassVar[bool] = True
    # A term that changes the photographs by a smaller share (root mean square) is not named. T
    # errs by 1 to 4 % anyway.
    least: ClassVar[float] = 0.004
    # The name that the user reads, where several terms describe one thing.
    label: ClassVar[str] = ""
    # What to change on the rig.
    advice: ClassVar[str]
    # The sum of the numbers of a term that all frames share lies in this range.
    between: ClassVar[tuple[float, float]] = (-np.inf, np.inf)

    def found(self, seen: Prediction) -> Array | None:
        """The numbers where they are found without the regression; None if nothing is wrong."""
        return None

    def regressors(self, seen: Prediction) -> Array | None:
        """What photographs change by with each number, (P, m, K); None if they cannot change."""
        return None

    @abstractmethod
    def take_out(self, values: Array, draft: Draft) -> None:
        """Write into the draft how the term is taken out, or what to predict with it."""

    @abstractmethod
    def sentence(self, values: Array) -> str:
        """What the rig did, in the user's words and units, without a full stop."""

    def added(self, values: Array, step: Array) -> Array:
        """The numbers after a further step, which was found once they were taken out."""
        return values + step

    def label_of(self, values: Array) -> str:
        """The name that the user reads."""
        return self.label or self.name

    def based(self, values: Array) -> Array:
        """The numbers as changes from the first frame."""
        return values - values[:, :1] if self.per_frame and self.of_first_frame else values


def deviation(values: Array) -> float:
    """The root mean square of a frame's numbers around their mean."""
    return float(np.sqrt(((values - values.mean(axis=-1, keepdims=True)) ** 2).sum(axis=0).mean()))
