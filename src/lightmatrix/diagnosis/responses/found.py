"""What was found of a response, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.camera.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.responses.bend import points
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.outputs.kinds import RESPONSE
from lightmatrix.outputs.writing import check_output
from lightmatrix.reprs import short_repr


@dataclass(frozen=True, eq=False)
class FoundResponse:
    """A camera's response as the photographs of a capture show it; made by `find_response`.

    Parameters
    ----------
    response : Response
        The curve.
    gamma : float
        Its gamma; of a curve that is no gamma, the power of the level that is nearest.
    uncertainty : float
        Uncertainty of the gamma: twice its standard error, and at least 0.5 % of it.
    difference : float
        Largest difference from the response that the capture states, as a share of full light.
    estimates : int
        How many times T was estimated to find it.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.FoundResponse(lm.Response.parse("gamma:2.2"), 2.2, 0.01, 0.36, 1)
    >>> print(found)
    gamma 2.20 +- 0.01
    """

    response: Response
    gamma: float
    uncertainty: float
    difference: float
    estimates: int

    __repr__ = short_repr

    def __str__(self) -> str:
        kind = "gamma" if self.is_gamma else "a curve near gamma"
        return f"{kind} {self.gamma:.2f} +- {self.uncertainty:.2f}"

    @property
    def is_gamma(self) -> bool:
        """Whether the curve is a gamma, 1 included."""
        return self.response.levels is None or self.response.name.startswith("gamma:")

    def applied_to(self, capture: Capture) -> Capture:
        """The capture, read by this response."""
        return with_response(capture, self.response)

    def as_dict(self) -> dict[str, Any]:
        """Everything besides the curve, JSON-ready."""
        return {
            "response": self.response.name,
            "gamma": round(self.gamma, 4),
            "uncertainty": round(self.uncertainty, 4),
            "difference": round(self.difference, 4),
            "estimates": self.estimates,
        }

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the curve as JSON, which `Response.parse` and capture.json read.

        Raises
        ------
        OutputError
            If a file of another kind is there or must not be replaced, or the disk fails.
        """
        check_output(path, RESPONSE, overwrite=overwrite)
        levels, light = points(self.response)
        # Level 1 is that of the capture's files, so the file names no raw level.
        curve = CurveFile("camera", levels, light / light[-1], self.as_dict())
        curve.save(path, overwrite=overwrite)


def with_response(capture: Capture, response: Response) -> Capture:
    """The capture, read by another response."""
    return replace(capture, decoder=replace(capture.decoder, response=response))


def largest_difference(one: Response, other: Response) -> float:
    """The largest difference of two curves, as a share of full light."""
    return float(np.abs(points(one)[1] - points(other)[1]).max())
