"""A small light transport matrix, and an estimate of it that is stored tile by tile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse
from scipy.sparse import csr_array

from lightmatrix.transport.checkpoint import Checkpoint
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

TILES = ((0, 8), (8, 16), (16, 20))
FINGERPRINT = {"capture": "0123", "regularization": 0.3}


def transport(
    camera: tuple[int, ...] = (5, 4), seed: int = 0, density: float = 0.2
) -> LightTransport:
    generator = np.random.default_rng(seed)
    rows = int(np.prod(camera))
    sparse = scipy.sparse.random_array((rows, 42), density=density, rng=generator)
    background = generator.random((rows, 6)).astype(np.float32)
    background[::3] = 0
    return LightTransport(
        csr_array(sparse, dtype=np.float32),
        background,
        camera,
        (6, 7),
        (2, 3),
        {"gap": generator.random(rows), "converged": generator.random(rows) < 0.5},
        {"solver": "none", "seed": seed, "nested": {"list": [1, 2.5, None]}},
    )


def assert_same(found: LightTransport, expected: LightTransport) -> None:
    assert (found.sparse != expected.sparse).nnz == 0
    assert found.sparse.dtype == np.float32
    np.testing.assert_array_equal(found.background, expected.background)
    assert found.camera_shape == expected.camera_shape
    assert found.projector_shape == expected.projector_shape
    assert found.background_grid == expected.background_grid
    assert dict(found.provenance) == dict(expected.provenance)


def write_tile(running: Checkpoint, start: int, stop: int) -> None:
    whole = transport()
    rows = SparseRows(whole.sparse, whole.background, whole.diagnostics)
    running.write(start, stop, rows.rows(slice(start, stop)))


def finish(running: Checkpoint) -> LightTransport:
    whole = transport()
    return running.finish(
        camera_shape=whole.camera_shape,
        projector_shape=whole.projector_shape,
        background_grid=whole.background_grid,
        provenance=whole.provenance,
    )


def run(path: Path, fail_at: int | None = None, overwrite: bool = False) -> int:
    """Compute all tiles; returns how many rows an earlier run had finished."""
    with Checkpoint.open(path, FINGERPRINT, overwrite=overwrite) as running:
        resumed = sum(stop - start for start, stop in running.spans())
        for start, stop in TILES:
            if start == fail_at:
                raise KeyboardInterrupt
            if (start, stop) not in running.spans():
                write_tile(running, start, stop)
        finish(running)
    return resumed
