"""Packed captures of the procedural scene, photographed strip by strip in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.packing import write_packed
from lightmatrix.capture.sensor import Sensor
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.transport.sparse_rows import stack_rows


def photograph(output: Path, scene: ProceduralScene, patterns: PatternSet) -> None:
    """Write the capture that `lm.simulate` would make of the scene's truth."""
    sensor = Sensor(0.8, read_noise=0.003, bits=8)
    height, width = scene.camera_shape

    def strips(rows: int) -> Iterator[NDArray[Any]]:
        # About four million samples at a time.
        step = rows * max(1, (1 << 22) // (rows * width * max(64, patterns.count)))
        for top in range(0, height, step):
            start, stop = top * width, min(top + step, height) * width
            parts = [scene.rows(k, min(k + 8192, stop))[0] for k in range(start, stop, 8192)]
            light = irradiance(stack_rows(parts), patterns)
            levels = sensor.expose(light, first_row=start)
            yield np.ascontiguousarray(levels.T).reshape(patterns.count, -1, width)

    write_packed(
        output,
        patterns,
        strips,
        decoder=sensor.decoder(),
        shape=scene.camera_shape,
        dtype=sensor.dtype,
        names=[f"image_{k:04d}" for k in range(patterns.count)],
        provenance={"scene": "procedural", "seed": scene.seed},
    )
