"""The decoder: from raw levels of a camera to linear samples."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response, check_exposures, check_levels, per_frame
from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.reprs import ShortRepr


@dataclass(frozen=True, eq=False, repr=False)
class Decoder(ShortRepr):
    """From raw levels to linear samples.

    Parameters
    ----------
    clip : float or (K,)
        Raw level at which each frame clips.
    full_scale : float
        Raw level that the response calls 1.
    black_level : float or (K,)
        Raw level without any light (the camera's pedestal), below `clip`.
    response : Response
        Undone before the black level is subtracted.
    exposure : float or (K,)
        Exposure of each frame; the samples are divided by it.
    black_frame : (M,) float, optional
        Raw levels of each camera sample under a black pattern; subtracted instead of
        `black_level`, which still sets the scale.
    black_exposure : float, optional
        Exposure of the black frame; its light above `black_level` grows with the exposure. None
        means that of the frames, which must then be one.
    clip_assumed : bool
        Whether the clip level was not stated and is the end of the range of the files.

    Raises
    ------
    InputError
        On levels out of range, or a black frame without exposure where the frames' differ.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> samples = lm.Decoder(clip=255, full_scale=255).decode(np.array([[0, 51, 255]], np.uint8))
    >>> samples.values.tolist(), samples.clipped.tolist()
    ([[0.0, 0.20000000298023224, 1.0]], [[False, False, True]])
    """

    clip: float | NDArray[Any]
    full_scale: float
    black_level: float | NDArray[Any] = 0.0
    response: Response = field(default_factory=Response)
    exposure: float | NDArray[Any] = 1.0
    black_frame: NDArray[Any] | None = None
    black_exposure: float | None = None
    clip_assumed: bool = False

    def __post_init__(self) -> None:
        check_levels(self.clip, self.black_level, self.full_scale)
        check_exposures(self.exposure)
        if self.black_exposure is not None and not 0 < self.black_exposure < np.inf:
            hint = "use a positive number, in the unit of the frames' exposures"
            raise InputError(f"a black frame of exposure {self.black_exposure}", hint=hint)
        if (
            self.black_frame is not None
            and self.black_exposure is None
            and np.ptp(self.exposure) > 0
        ):
            raise InputError(
                "a black frame of unknown exposure, while the frames differ in exposure",
                hint="give the exposure of the black frame in capture.json",
            )

    @cached_property
    def _table(self) -> NDArray[np.float32]:
        levels = np.arange(int(self.full_scale) + 1)
        return self.response.linearise(levels / self.full_scale).astype(np.float32)

    def _light(self, levels: float | NDArray[Any]) -> NDArray[np.float64]:
        share = np.asarray(levels, np.float64) / self.full_scale
        return self.response.linearise(share)

    @property
    def hot(self) -> NDArray[np.bool_] | None:
        """Samples that clip even without light, (M,); None without a black frame."""
        if self.black_frame is None:
            return None
        return np.asarray(np.asarray(self.black_frame) >= np.min(self.clip))

    def check_count(self, count: int, samples: int | None = None) -> None:
        """Refuse lists of exposures or levels that do not have one number for each frame.

        With `samples`, also a black frame of another size.
        """
        if samples is not None and self.black_frame is not None:
            size = np.size(self.black_frame)
            if size != samples:
                raise InputError(
                    f"a black frame of {size} samples for images of {samples}",
                    hint="give one raw level for each camera sample",
                )
        for name in ("clip", "black_level", "exposure"):
            value = np.asarray(getattr(self, name))
            if value.ndim and value.shape != (count,):
                hint = "give one number, or one for each frame"
                raise InputError(f"{name} has {value.size} values for {count} frames", hint=hint)

    def select(self, frames: NDArray[np.integer]) -> "Decoder":
        """The decoder of the frames of the given indices."""
        values = {name: getattr(self, name) for name in ("clip", "black_level", "exposure")}
        return replace(
            self,
            **{name: value[frames] if np.ndim(value) else value for name, value in values.items()},
        )

    def decode(self, raw: NDArray[Any], *, first_row: int = 0, first_frame: int = 0) -> Samples:
        """Samples of the raw levels (m, n) of m camera samples in n frames.

        They are in units of the clip level above `black_level`, at exposure 1. `first_row` and
        `first_frame` say where this tile begins in the whole capture.
        """
        rows, frames = raw.shape
        stop = first_frame + frames
        clip = per_frame(self.clip, first_frame, stop, "clip levels")
        pedestal = self._light(per_frame(self.black_level, first_frame, stop, "black levels"))
        exposure = per_frame(self.exposure, first_frame, stop, "exposures")
        if raw.dtype.kind == "u":
            # Whole levels are compared with the first that is not below the clip level.
            clipped = raw >= np.ceil(clip).astype(raw.dtype)
            light = self._table[np.minimum(raw, int(self.full_scale))]
        else:
            clipped = raw >= clip.astype(np.float32)
            light = self._light(raw).astype(np.float32)
        ceiling = self._light(clip)
        black = pedestal
        if self.black_frame is not None:
            dark = self._light(self.black_frame[first_row : first_row + rows])[:, None]
            ratio = 1.0 if self.black_exposure is None else exposure / self.black_exposure
            black = pedestal + (dark - pedestal) * ratio
        scale = 1 / ((ceiling - pedestal) * exposure)
        values = (light - black.astype(np.float32)) * scale.astype(np.float32)
        level = ((ceiling - black) * scale).astype(np.float32)
        # Clipped values are exactly the clip level, without rounding.
        np.copyto(values, np.broadcast_to(level, values.shape), where=clipped)
        return Samples(values, clipped, level)
