"""Pictures of measured responses: light over level, and how far to trust it."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np

from lightmatrix.calibration.responses.curve_fit import Residuals
from lightmatrix.camera.camera_curve import Response
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.pictures.style import COLOURS, STYLE
from lightmatrix.pictures.transport import Picture


def draw_camera_response(response: Response, residuals: Residuals, gamma: float) -> Picture:
    """A camera's curve beside known ones, and its residuals."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(7.2, 3.2), layout="constrained")
        curve, deviations = drawing.subplots(1, 2)
        top = response.full_scale or 1.0
        share = np.linspace(0, 1, 256)
        curve.plot(top * share, response.linearise(share), color=COLOURS[0], label="measured")
        _known(curve, top, gamma)
        curve.set(xlabel="raw level", ylabel="light", title="Response of the camera")
        curve.legend()
        deviations.axhline(0, color="0.7", linewidth=0.8)
        deviations.plot(residuals.light, 100 * residuals.off, "o-", color=COLOURS[1], markersize=4)
        most = max(1.0, 120 * residuals.largest)
        deviations.set(
            xlabel="light", ylabel="% of full light", xlim=(0, 1), ylim=(-most, most),
            title="Light of a pixel, less what its exposure says",
        )  # fmt: skip
    return drawing


def draw_projector_response(response: ProjectorResponse) -> Picture:
    """A projector's light over its grey values."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(3.8, 3.2), layout="constrained")
        curve = drawing.subplots()
        grey = np.linspace(0, 1, 256)
        curve.plot(255 * grey, response.light_of(grey), color=COLOURS[0], label="measured")
        curve.plot(response.levels, response.light, "o", color=COLOURS[0], markersize=4)
        _known(curve, 255.0, response.gamma)
        curve.set(xlabel="grey value", ylabel="light", title="Response of the projector")
        curve.legend()
    return drawing


def _known(axes: Any, top: float, gamma: float) -> None:
    share = np.linspace(0, 1, 256)
    axes.plot(top * share, share, color="0.6", linewidth=1, label="linear")
    axes.plot(
        top * share, share**gamma, ":", color=COLOURS[1], linewidth=1.2, label=f"gamma {gamma:.2f}"
    )
