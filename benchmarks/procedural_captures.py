"""Packed captures of the procedural scene, photographed strip by strip in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.packing import pack
from lightmatrix.capture.sensor import Sensor
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.transport.sparse_rows import stack_rows


class Scene(Protocol):
    """The procedural scene, or a part of its camera."""

    @property
    def camera_shape(self) -> tuple[int, int]: ...

    @property
    def seed(self) -> int: ...

    def rows(self, start: int, stop: int) -> tuple[csr_array, Any]: ...


def photograph(output: Path, scene: Scene, patterns: PatternSet) -> None:
    """Write the capture that `lm.simulate` would make of the scene's truth."""
    sensor = Sensor(0.8, read_noise=0.003, bits=8)
    frames = _Photographs(scene, patterns, sensor)
    provenance = {"scene": "procedural", "seed": scene.seed}
    pack(Capture(patterns, frames, sensor.decoder(), provenance=provenance), output)


@dataclass(frozen=True)
class _Photographs:
    """Photographs that are taken as they are read, some camera pixels at a time.

    Packing reads them by `levels`; no whole photograph, selection or part of them exists.
    """

    scene: Scene
    patterns: PatternSet
    sensor: Sensor

    @property
    def count(self) -> int:
        return self.patterns.count

    @property
    def shape(self) -> tuple[int, ...]:
        return self.scene.camera_shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.sensor.dtype

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        parts = [self.scene.rows(k, min(k + 8192, stop))[0] for k in range(start, stop, 8192)]
        return self.sensor.expose(irradiance(stack_rows(parts), self.patterns), first_row=start)

    def name(self, index: int) -> str:
        return f"image_{index:04d}"

    def read(self, index: int) -> NDArray[Any]:
        raise NotImplementedError

    def select(self, index: Sequence[int]) -> _Photographs:
        raise NotImplementedError

    def part(self, rows: slice, cols: slice) -> _Photographs:
        raise NotImplementedError
