"""Layers: maps over the camera, and the dual image, that the page shows on request."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.pictures import maps
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.matrix_data import white_level
from lightmatrix.viewer.packed import packed

# Colours of a scale that are sent. A map with fewer would show bands.
_COLOURS = 256


@dataclass(frozen=True)
class Layer:
    """What a layer shows, for which side, and the diagnostic that it is made from, if any."""

    title: str
    side: str
    make: Callable[[LightTransport], bytes]
    diagnostic: str = ""


def available_layers(transport: LightTransport) -> dict[str, dict[str, str]]:
    """The layers that a matrix has, by name: title and side, "camera" or "projector"."""
    return {
        name: {"title": layer.title, "side": layer.side}
        for name, layer in LAYERS.items()
        if not layer.diagnostic or maps.has_diagnostic(transport, layer.diagnostic)
    }


def colour_scale(name: str) -> NDArray[np.uint8]:
    """A Matplotlib colour map as (256, 3) bytes, dark to bright or white to red."""
    shown = maps.Map("", "", "", np.zeros((1, 1)), 0, 1, name).colour_map
    return np.asarray(shown(np.linspace(0, 1, _COLOURS), bytes=True))[:, :3]


def _map(make: Callable[[LightTransport], maps.Map]) -> Callable[[LightTransport], bytes]:
    def layer(transport: LightTransport) -> bytes:
        shown = make(transport)
        colours = np.asarray(shown.colour_map(np.linspace(0, 1, _COLOURS), bytes=True))
        header: dict[str, Any] = {
            "title": shown.title,
            "label": shown.label,
            "low": shown.low,
            "high": shown.high,
            "logarithmic": shown.logarithmic,
        }
        values = shown.values.astype(np.float32)
        return packed(header, {"values": values, "colours": colours[:, :3]})

    return layer


def _dual(transport: LightTransport) -> bytes:
    image = transport.dual_image()
    header = {"title": "Dual image: seen from the projector", "white": white_level(image)}
    return packed(header, {"values": image})


def _places(which: int) -> Callable[[LightTransport], maps.Map]:
    return lambda transport: maps.correspondence_maps(correspondence(transport))[which]


LAYERS = {
    "dual": Layer("Dual image", "projector", _dual),
    "row": Layer("Correspondence: row", "camera", _map(_places(0))),
    "column": Layer("Correspondence: column", "camera", _map(_places(1))),
    "confidence": Layer("Correspondence: confidence", "camera", _map(_places(2))),
    "clipping": Layer("Clipped samples", "camera", _map(maps.clipping_map), "clipped_share"),
    "estimated-error": Layer(
        "Stated error", "camera", _map(maps.estimated_error_map), "estimated_error"
    ),
    "footprint": Layer("Footprint size", "camera", _map(maps.footprint_map), "footprint"),
    "gap": Layer("Duality gap", "camera", _map(maps.gap_map), "gap"),
}
