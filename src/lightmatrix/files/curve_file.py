"""Files of measured response curves: JSON of levels and the light that belongs to each."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import RESPONSE, RESPONSE_FORMAT
from lightmatrix.files.reading import read_json
from lightmatrix.files.writing import atomic_file
from lightmatrix.paths import as_path

_VERSION = 1


@dataclass(frozen=True, eq=False)
class CurveFile:
    """The response curve of a camera or projector, as a file holds it."""

    # "camera" or "projector".
    device: str
    # Points of the curve: increasing levels from 0, light from 0 to 1 that never decreases.
    levels: NDArray[np.float64]
    light: NDArray[np.float64]
    # Further entries of the file, JSON-ready.
    facts: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write it as JSON, whole or not at all."""
        content = {
            "format": RESPONSE_FORMAT,
            "version": _VERSION,
            "device": self.device,
            **self.facts,
            "levels": _short(self.levels),
            "light": _short(self.light),
        }
        with atomic_file(path, RESPONSE, overwrite=overwrite) as part:
            part.write_text(json.dumps(content, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path, device: str) -> "CurveFile":
        """Read what `save` wrote for a camera or for a projector."""
        file = as_path(path)
        content = read_json(file, RESPONSE_FORMAT, _VERSION)
        if content.get("device") != device:
            other = str(content.get("device"))[:20]
            hint = "`camera_response` measures cameras, `projector_response` projectors"
            raise InputError(f"{file}: is the response of a {other}, not of a {device}", hint=hint)
        levels, light = _numbers(content.get("levels")), _numbers(content.get("light"))
        if (
            levels is None
            or light is None
            or len(levels) != len(light)
            or not (levels[0] == 0 <= light[0] and light[-1] == 1)
            or not ((np.diff(levels) > 0).all() and (np.diff(light) >= 0).all())
        ):
            raise InputError(
                f"{file}: holds no curve: levels that increase from 0, and light from 0 to 1",
                hint="measure it again with `lightmatrix response`",
            )
        known = {"format", "version", "device", "levels", "light"}
        facts = {key: value for key, value in content.items() if key not in known}
        return cls(device, levels, light, facts)


def _short(values: Sequence[float] | NDArray[np.float64]) -> list[float]:
    """Numbers of seven digits, more than a measurement has."""
    return [float(f"{value:.7g}") for value in values]


def _numbers(values: Any) -> NDArray[np.float64] | None:
    """The numbers of a JSON list; None if it is no such list."""
    # A 16-bit camera has no more levels than that.
    if not isinstance(values, list) or not 2 <= len(values) <= 65_536:
        return None
    # Compared by type, since Python takes True for a number; no device reaches a level of 1e9.
    if any(type(value) not in (int, float) or abs(value) > 1e9 for value in values):
        return None
    return np.array(values, np.float64)
