"""Layers: maps over the camera, and the dual image, that the page shows on request."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from lightmatrix.errors import InputError
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.pictures import maps
from lightmatrix.shape.layers import Layers, layers
from lightmatrix.shape.shape import Shape
from lightmatrix.shape.triangulation import triangulate
from lightmatrix.transport.correspondence import Correspondence, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import StoredTransport
from lightmatrix.uses.separation import Separation, separate
from lightmatrix.viewer.lights import Light
from lightmatrix.viewer.packed import halves, packed

# T as the page takes it: column by column, in half precision.

# Row indices below this number take two bytes.
_SHORT_ROWS = 1 << 16


def page_size(matrix: LightTransport | StoredTransport) -> int:
    """Bytes that a matrix takes in the page, but for a short header."""
    samples, pixels = matrix.shape
    entries = matrix.sparse.nnz if isinstance(matrix, LightTransport) else matrix.entries
    cells = matrix.background_grid[0] * matrix.background_grid[1]
    return entries * (4 if samples <= _SHORT_ROWS else 6) + 4 * (pixels + 1) + 2 * samples * cells


def matrix_data(transport: LightTransport) -> bytes:
    """T as bytes, see `packed`.

    The arrays are ``ends`` (where the entries of each column end, from 0), ``rows`` and ``values``
    of the entries, and ``background``, cell by cell. The values are in half precision, divided by
    ``value_scale`` and ``background_scale``.
    """
    by_columns = csc_array(transport.sparse)
    by_columns.sort_indices()
    short = transport.shape[0] <= _SHORT_ROWS
    values, value_scale = halves(by_columns.data)
    background, background_scale = halves(transport.background)
    header = {
        "value_scale": value_scale,
        "background_scale": background_scale,
        "white": maps.white_level(transport.relight(np.ones(transport.projector_shape))),
    }
    arrays = {
        "ends": by_columns.indptr.astype(np.uint32),
        "rows": by_columns.indices.astype(np.uint16 if short else np.uint32),
        "values": values,
        "background": background.T,
    }
    return packed(header, arrays)


# The most entries of a matrix that is separated, and with which pictures are compensated for, on
# request. 3 million take 1.6 s of a core.
COMPUTED_ENTRIES = 1 << 22


class LayerSource:
    """The layers of a matrix, each computed when it is first asked for; depth by a geometry."""

    def __init__(
        self, matrix: LightTransport | Light, geometry: RigGeometry | str | Path | None = None
    ) -> None:
        self.matrix = matrix
        self.whole = matrix if isinstance(matrix, LightTransport) else matrix.matrix
        self.geometry = geometry
        self.facts = matrix if isinstance(matrix, LightTransport) else matrix.facts
        # The colour scales that the page itself uses.
        self.colours = {
            "false": maps.colour_bytes("viridis"),
            "faint": maps.colour_bytes("inferno"),
        }
        self._lock = threading.Lock()
        self._made: dict[str, bytes] = {}

    @cached_property
    def available(self) -> dict[str, dict[str, str]]:
        """The layers by name: title and side, "camera" or "projector"."""
        return {
            name: {"title": layer.title, "side": layer.side}
            for name, layer in LAYERS.items()
            if layer.exists(self)
        }

    def get(self, name: object) -> bytes:
        """A layer; refused if there is none of this name."""
        if not isinstance(name, str) or name not in self.available:
            raise InputError(f"there is no layer {name!r}", hint="choose one of the list")
        with self._lock:
            if name not in self._made:
                made = LAYERS[name].make(self)
                self._made[name] = packed_map(made) if isinstance(made, maps.Map) else made
            return self._made[name]

    @cached_property
    def correspondence(self) -> Correspondence:
        """The projector pixel that each camera pixel sees most."""
        return correspondence(self.whole)

    @cached_property
    def separation(self) -> Separation:
        """Direct and global light, of a matrix in memory; refused if T cannot be separated."""
        assert isinstance(self.matrix, LightTransport)
        return separate(self.matrix)

    @cached_property
    def shape(self) -> Shape:
        """The surface, from T where it is in memory, else from its correspondence."""
        matrix = self.matrix if isinstance(self.matrix, LightTransport) else self.correspondence
        assert self.geometry is not None
        return triangulate(matrix, self.geometry)

    @cached_property
    def surfaces(self) -> Layers:
        """All that camera pixels see, one through the other, of a matrix in memory."""
        assert isinstance(self.matrix, LightTransport)
        assert self.geometry is not None
        return layers(self.matrix, self.geometry)

    @property
    def layered(self) -> bool:
        """Whether there are surfaces behind others: the geometry is known, and T is in memory."""
        return self.geometry is not None and isinstance(self.matrix, LightTransport)

    @property
    def separable(self) -> bool:
        """Whether direct and global light can be computed in a few seconds."""
        matrix = self.matrix
        if not isinstance(matrix, LightTransport) or matrix.sparse.nnz > COMPUTED_ENTRIES:
            return False
        return min(matrix.sparse.data.min(initial=0), matrix.background.min(initial=0)) >= 0


@dataclass(frozen=True)
class Layer:
    """What a layer shows, for which side, and whether a matrix has it."""

    title: str
    make: Callable[[LayerSource], maps.Map | bytes]
    exists: Callable[[LayerSource], bool] = lambda source: True
    side: str = "camera"


def packed_map(shown: maps.Map) -> bytes:
    """A map with its colours."""
    header: dict[str, Any] = {
        "title": shown.title,
        "label": shown.label,
        "low": shown.low,
        "high": shown.high,
        "logarithmic": shown.logarithmic,
    }
    values = shown.values.astype(np.float32)
    return packed(header, {"values": values, "colours": maps.colour_bytes(shown.colour_map)})


def _image(image: NDArray[np.floating], **more: Any) -> bytes:
    """An image over the camera or the projector, with the light that is shown as white."""
    return packed({**more, "white": maps.white_level(image)}, {"values": image})


def _light(light: LightTransport) -> bytes:
    """Light under a white pattern, shown like the photograph."""
    return _image(light.relight(np.ones(light.projector_shape)), gained=True)


def _parallax(source: LayerSource) -> maps.Map:
    values = source.separation.parallax.astype(np.float64)
    known = values[np.isfinite(values)]
    # Wrong matches may lie at either end.
    low, high = np.quantile(known, (0.01, 0.99)).tolist() if known.size else (0.0, 1.0)
    high = max(high, low + 1e-6 * max(1.0, abs(low)))
    label = "parallax along the epipolar line, projector pixels"
    return maps.Map("Parallax", label, values, low, high)


def _places(name: str, which: int) -> Layer:
    title = f"Correspondence: {name}"
    return Layer(title, lambda s: maps.correspondence_maps(s.correspondence)[which])


def _diagnostic(title: str, make: Callable[[LightTransport], maps.Map], name: str) -> Layer:
    return Layer(title, lambda s: make(s.facts), lambda s: maps.has_diagnostic(s.facts, name))


LAYERS = {
    "direct": Layer(
        "Direct light of white", lambda s: _light(s.separation.direct), lambda s: s.separable
    ),
    "global": Layer(
        "Global light of white", lambda s: _light(s.separation.global_), lambda s: s.separable
    ),
    "depth": Layer("Depth", lambda s: s.shape.depth_map, lambda s: s.geometry is not None),
    "probability": Layer(
        "Probability of the depth",
        lambda s: s.shape.probability_map,
        lambda s: s.geometry is not None,
    ),
    "first": Layer(
        "Depth of the first surface", lambda s: s.surfaces.depth_maps[0], lambda s: s.layered
    ),
    "behind": Layer(
        "Depth of the surface behind it", lambda s: s.surfaces.depth_maps[1], lambda s: s.layered
    ),
    "mirrors": Layer(
        "Light by mirrors", lambda s: _image(s.surfaces.mirrored_light), lambda s: s.layered
    ),
    "parallax": Layer("Parallax", _parallax, lambda s: s.separable),
    "dual": Layer(
        "Dual image",
        lambda s: _image(s.whole.dual_image(), title="Dual image: seen from the projector"),
        side="projector",
    ),
    "row": _places("row", 0),
    "column": _places("column", 1),
    "confidence": _places("confidence", 2),
    "clipping": _diagnostic("Clipped samples", maps.clipping_map, "clipped_share"),
    "estimated-error": _diagnostic("Estimated error", maps.estimated_error_map, "estimated_error"),
    "footprint": _diagnostic("Footprint size", maps.footprint_map, "footprint"),
    "gap": _diagnostic("Duality gap", maps.gap_map, "gap"),
}
