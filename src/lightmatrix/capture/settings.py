"""`ReadSettings`: how the photographs of a capture are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.camera.raw_levels import check_exposures, check_levels
from lightmatrix.errors import InputError
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.ranges import check_number
from lightmatrix.reprs import short_repr


@dataclass(frozen=True, eq=False)
class ReadSettings:
    """How the photographs of a capture are read.

    These are the options of the command line and the keys of capture.json. The defaults describe a
    linear camera at exposure 1 without black level.

    Parameters
    ----------
    black : str, Path or float, optional
        Photograph under a black pattern, which is subtracted. A number is a `black_level`.
    black_exposure : float, optional
        Exposure of the black frame, > 0. None: that of the frames, which must then be equal.
    black_level : float or (K,), optional
        Raw level without any light, the camera's electronic pedestal, >= 0. None: 0. It sets the
        unit of T, which the room light in a black frame does not change.
    white : str or Path, optional
        Photograph under a white pattern; becomes one more frame.
    clip : float or (K,), optional
        Raw level at which the camera clips, > 0. None: `full_scale`, or where a measured response
        ends.
    full_scale : float, optional
        Raw level that the response calls 1, > 0. None: the end of the range (255, 65535, or 1 for
        float).
    exposure : float or (K,)
        Exposure of each frame, > 0, in any unit; T is for exposure 1.
    response : Response or str, optional
        See `Response.parse`. None: linear, with a warning where the files say otherwise.
    projector_response : str, Path or ProjectorResponse, optional
        The light of the patterns' grey values, or "auto": `estimate` finds it in the photographs.
        None: proportional to them.
    mask : str or Path, optional
        Image that is 0 where camera pixels are left out. None: all count.
    mosaic : bool
        Whether each pixel of a raw camera file is a sample behind its colour of the filter, not
        interpolated to three channels.

    Raises
    ------
    InputError
        On levels and exposures out of range, and two black levels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> for k in range(8):
    ...     lm.write_image(f"photos/{k}.png", capture.frame(k))
    >>> settings = lm.ReadSettings(clip=250, black_level=4, response="linear")
    >>> lm.Capture.from_folders(capture.patterns, "photos", settings).decoder.clip
    250.0
    """

    black: str | Path | float | None = None
    black_exposure: float | None = None
    black_level: float | NDArray[Any] | None = None
    white: str | Path | None = None
    clip: float | NDArray[Any] | None = None
    full_scale: float | None = None
    exposure: float | NDArray[Any] = 1.0
    response: Response | str | None = None
    projector_response: str | Path | ProjectorResponse | None = None
    mask: str | Path | None = None
    mosaic: bool = False

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if isinstance(self.black, (int, float)):
            if self.black_level is not None:
                raise InputError(
                    f"black levels of {self.black:g} and {self.black_level}",
                    hint="give the black level once",
                )
            object.__setattr__(self, "black_level", float(self.black))
            object.__setattr__(self, "black", None)
        for name in ("black_level", "clip", "exposure"):
            value = getattr(self, name)
            if value is not None:
                levels = np.asarray(value, np.float64)
                object.__setattr__(self, name, levels if levels.ndim else float(levels))
        check_levels(self.clip, self.black_level, self.full_scale)
        check_exposures(self.exposure)
        if self.black_exposure is not None:
            check_number(
                "a black exposure", self.black_exposure, above=True,
                hint="use a positive number, in the unit of the frames' exposures",
            )  # fmt: skip
