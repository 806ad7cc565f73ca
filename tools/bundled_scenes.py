"""Renders the bundled scenes again: python tools/bundled_scenes.py FOLDER.

The files are small: places of entries as bits, values as rounded square roots. The noise of a path
tracer's entry grows with the square root of its value. Square roots, rounded to 1/511 of the root
of each row's maximum, therefore lose equally little everywhere: about a fifth of the renderer's own
noise at 65,536 paths a pixel. Rows keep their sums to single precision.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from lightmatrix.files.kinds import PACKED
from lightmatrix.files.writing import atomic_file
from lightmatrix.simulation.library import BUNDLED, BUNDLED_SIZE
from lightmatrix.simulation.renderer import render
from lightmatrix.simulation.truth import Truth

# Paths per camera pixel.
SAMPLES = 65_536


def write_bundled(path: Path, truth: Truth, *, overwrite: bool = False) -> None:
    """Write a truth as a small file, without entries below 1e-6 of their row's maximum."""
    matrix = truth.matrix
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    largest = np.maximum(matrix.max(axis=1).toarray().ravel(), np.finfo(np.float32).tiny)
    # Square roots have 9 bits, direct shares 8.
    level = np.rint(511 * np.sqrt(matrix.data / largest[row])).astype(np.uint16)
    kept = level > 0
    mask = np.zeros(matrix.shape, bool)
    mask[row[kept], matrix.indices[kept]] = True
    level = level[kept]
    share = np.rint(truth.direct_data[kept] / matrix.data[kept] * 255).astype(np.uint8)
    with (
        atomic_file(path, PACKED, overwrite=overwrite) as temporary,
        open(temporary, "wb") as stream,
    ):
        np.savez_compressed(
            stream,
            lightmatrix_packed=np.array(1),
            mask=np.packbits(mask),
            level_low=level.astype(np.uint8),
            level_high=np.packbits(level > 255),
            sums=matrix.sum(axis=1).astype(np.float32),
            # Most entries hold no direct light.
            direct_at=np.flatnonzero(share).astype(np.uint32),
            direct_share=share[share > 0],
            camera_shape=np.array(truth.camera_shape),
            projector_shape=np.array(truth.projector_shape),
            metadata=np.array(json.dumps(dict(truth.metadata))),
        )


if __name__ == "__main__":
    for name in BUNDLED:
        file = Path(sys.argv[1]) / f"{name}.npz"
        write_bundled(file, render(name, BUNDLED_SIZE, samples=SAMPLES), overwrite=True)
        print(file, f"{file.stat().st_size / 2**20:.1f} MiB")
