"""Response curves: how one may differ from the one that is assumed, and what was found of it.

`responses/curves.py` measures curves from photographs that are taken for this purpose.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC, Response, nearest_gamma
from lightmatrix.capture.capture import Capture
from lightmatrix.files.curve_file import CurveFile
from lightmatrix.files.kinds import RESPONSE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.reprs import ShortRepr

# The entry of an estimate's provenance that holds the response that was found.
FOUND_RESPONSE = "found_response"
Floats = NDArray[np.float64]

# Gammas of cameras, displays and projectors lie well within this range.
GAMMAS = (0.2, 6.0)


def bends(response: Response, levels: Floats) -> Floats:
    """How light may bend at levels (...) besides a gamma, which is nearly the first bend, (3, ...).

    They are u (1 - v) C_k(2 v - 1) with light u, level v and Chebyshev polynomials C_k, k < 3, and
    vanish at black and at full light.
    """
    shape = response.linearise(levels) * (1 - levels)
    chebyshev = np.polynomial.chebyshev.chebval
    return np.stack([shape * chebyshev(2 * levels - 1, each) for each in np.eye(3)])


def bent(response: Response, sizes: Floats) -> Response:
    """The response with bends of some sizes (3,), kept increasing."""
    levels, light = points(response)
    bent = light + np.tensordot(sizes, bends(response, levels), axes=1)
    # A hundredth of the mean slope remains everywhere.
    least = 0.01 / (len(levels) - 1)
    rising = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(bent), least))])
    return Response(levels, rising / rising[-1], "curve found in the capture")


def raised(response: Response, power: float) -> Response:
    """The response with its light raised to a power, which is a gamma if it was one."""
    if response.levels is None or response.name.startswith("gamma:"):
        return gamma_response(exponent(response) * power)
    levels, light = points(response)
    return Response(levels, light**power, f"{response.name}, to the power {power:.3f}")


def gamma_response(gamma: float) -> Response:
    """The response of a gamma; linear for 1."""
    return Response() if gamma == 1 else Response.parse(f"gamma:{np.clip(gamma, *GAMMAS):.4f}")


def exponent(response: Response) -> float:
    """The gamma of a response that is one; otherwise the power that is nearest to its curve."""
    if response.name.startswith("gamma:"):
        return float(response.name.removeprefix("gamma:"))
    if response.levels is None:
        return 1.0
    return nearest_gamma(*points(response))


def points(response: Response) -> tuple[Floats, Floats]:
    """Levels and light of a curve, both as a share of full scale, at evenly spaced levels."""
    # Four times as dense as the levels of a camera of 10 bits.
    levels = np.linspace(0, 1, 4097)
    return levels, response.linearise(levels)


@dataclass(frozen=True, eq=False, repr=False)
class FoundResponse(ShortRepr):
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
    projector : ProjectorResponse, optional
        The projector's response, if it was looked for.
    projector_uncertainty : float
        Uncertainty of its gamma.
    """

    response: Response
    gamma: float
    uncertainty: float
    difference: float
    estimates: int
    projector: ProjectorResponse | None = None
    projector_uncertainty: float = 0.0

    def __str__(self) -> str:
        kind = "gamma" if self.is_gamma else "a curve near gamma"
        text = f"{kind} {self.gamma:.2f}"
        text += f" +- {self.uncertainty:.2f}" if self.uncertainty else ", as stated"
        if self.projector is None:
            return text
        of_projector = f"{self.projector.gamma:.2f} +- {self.projector_uncertainty:.2f}"
        return f"{text}; the projector's gamma {of_projector}"

    @property
    def is_gamma(self) -> bool:
        """Whether the curve is a gamma, 1 included."""
        return self.response.levels is None or self.response.name.startswith("gamma:")

    def applied_to(self, capture: Capture) -> Capture:
        """The capture, read by this response, with the light of its grey values if it was found."""
        read = with_response(capture, self.response)
        return read if self.projector is None else with_projector(read, self.projector)

    def as_dict(self) -> dict[str, Any]:
        """Everything besides the curve, JSON-ready."""
        facts = {
            "response": self.response.name,
            "gamma": round(self.gamma, 4),
            "uncertainty": round(self.uncertainty, 4),
            "difference": round(self.difference, 4),
            "estimates": self.estimates,
        }
        if self.projector is not None:
            facts["projector_gamma"] = round(self.projector.gamma, 4)
            facts["projector_uncertainty"] = round(self.projector_uncertainty, 4)
        return facts

    def provenance(self) -> dict[str, Any]:
        """What the provenance of an estimate keeps of it: `as_dict`, and a curve's light."""
        kept = self.as_dict()
        if not self.is_gamma:
            kept["light"] = points(self.response)[1].tolist()
        if self.projector is not None:
            kept["projector_gamma"] = self.projector.gamma
        return kept

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


def with_projector(capture: Capture, projector: ProjectorResponse) -> Capture:
    """The capture, with the grey values of its patterns read as light."""
    patterns = projector.light_of_patterns(capture.patterns)
    provenance = {**capture.provenance, **projector.as_provenance}
    return replace(capture, patterns=patterns, provenance=provenance, projector_unknown=False)


def as_estimated(capture: Capture, provenance: Mapping[str, Any]) -> Capture:
    """The capture of an estimate, read by the responses that were found if it leaves them open."""
    found = provenance.get(FOUND_RESPONSE)
    if found is None:
        return capture
    if capture.decoder.response.name == AUTOMATIC:
        if "light" in found:
            light = np.array(found["light"])
            response = Response(np.linspace(0, 1, len(light)), light, found["response"])
        else:
            response = Response.parse(found["response"])
        capture = with_response(capture, response)
    if capture.projector_unknown:
        projector = ProjectorResponse.of_gamma(found["projector_gamma"])
        capture = with_projector(capture, projector)
    return capture


def largest_difference(one: Response, other: Response) -> float:
    """The largest difference of two curves, as a share of full light."""
    return float(np.abs(points(one)[1] - points(other)[1]).max())
