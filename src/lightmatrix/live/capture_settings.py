"""How a rig photographs patterns."""

from __future__ import annotations

from dataclasses import dataclass

from lightmatrix.camera.camera_curve import Response
from lightmatrix.errors import InputError
from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.rig import Rig
from lightmatrix.live.until import parse_until

USUAL_REFERENCE = 32
# Seconds; longer exposures and settle times are refused as mistakes.
_LONGEST = 60


@dataclass(frozen=True)
class CaptureSettings:
    """How a rig photographs patterns.

    Parameters
    ----------
    cell : int
        Projector pixels along a side of each pattern pixel.
    exposure : float, optional
        Seconds, one for all frames. None: as the planner advises, possibly several.
    settle : float, optional
        Seconds to wait after a pattern is shown. None: measured.
    response : str
        The camera's response; see `Response.parse`.
    check : bool
        Whether each frame has to be shown to be that of its pattern.
    reference_every : int
        Frames between two looks at black and white, which notice drift; 0 for none.
    until : float or str, optional
        Relative error of T, such as 0.03, or of relit images, such as relighting:0.03: patterns are
        photographed in groups of eight until an estimate states that it errs by no more, or further
        patterns do not help. None: all patterns are photographed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.CaptureSettings(exposure=0.02, cell=2).reference_every
    32
    """

    cell: int = 1
    exposure: float | None = None
    settle: float | None = None
    response: str = "linear"
    check: bool = True
    reference_every: int = USUAL_REFERENCE
    until: float | str | None = None

    def __post_init__(self) -> None:
        for name, value in (("exposure", self.exposure), ("settle time", self.settle)):
            if value is not None and not 0 <= value <= _LONGEST:
                raise InputError(f"a {name} of {value} s", hint="give seconds, such as 0.02")
        if self.cell < 1:
            raise InputError(f"a cell of {self.cell} pixels", hint="use 1 or more")
        if self.reference_every < 0:
            raise InputError(
                f"a reference every {self.reference_every} frames", hint="use 0 or more"
            )
        if self.until is not None:
            parse_until(self.until)
        Response.parse(self.response)

    def check_rig(self, rig: Rig) -> None:
        """Refuse settings that a rig does not have."""
        shortest, longest = exposure_limits(rig.camera)
        if self.exposure is not None and not shortest <= self.exposure <= longest:
            raise InputError(
                f"an exposure of {self.exposure:g} s",
                hint=f"the camera has {shortest:g} to {longest:g} s",
            )
        largest = min(rig.projector.shape)
        if self.cell > largest:
            raise InputError(f"a cell of {self.cell} pixels", hint=f"use 1 to {largest} pixels")
