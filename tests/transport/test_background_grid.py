"""A background of 16 x 16 cells on a projector of odd size, in every use of T."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from scipy.sparse import csr_array

from lightmatrix.cli import main
from lightmatrix.errors import InputError
from lightmatrix.files.images import read_image, write_image
from lightmatrix.judgement.metrics import relative_error, squared_errors
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport import store
from lightmatrix.transport.matrix import LightTransport

PROJECTOR, CAMERA, GRID = (50, 37), (6, 7), (16, 16)
PIXELS, ROWS = 50 * 37, 42


@pytest.fixture(scope="module")
def fine() -> LightTransport:
    random = np.random.default_rng(4)
    sparse = scipy.sparse.random_array((ROWS, PIXELS), density=0.01, rng=random)
    background = (random.random((ROWS, 256)) * (random.random((ROWS, 256)) < 0.3)).astype("f4")
    background[::5] = 0
    return LightTransport(csr_array(sparse, dtype="f4"), background, CAMERA, PROJECTOR, GRID)


@pytest.fixture(scope="module")
def dense(fine: LightTransport) -> np.ndarray:
    """T by its definition: each cell's value, divided by its number of pixels, at each of them."""
    result = fine.sparse.toarray().astype(float).reshape(ROWS, *PROJECTOR)
    rows, cols = (np.array([i * 16 // n for i in range(n)]) for n in PROJECTOR)
    for i, j in np.ndindex(16, 16):
        inside = np.ix_(np.arange(ROWS), np.flatnonzero(rows == i), np.flatnonzero(cols == j))
        count = (rows == i).sum() * (cols == j).sum()
        result[inside] += (fine.background[:, 16 * i + j] / count)[:, None, None]
    return result.reshape(ROWS, PIXELS)


def test_commands(
    fine: LightTransport, dense: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store.save(tmp_path / "s.zarr", fine)
    assert main(["info", str(tmp_path / "s.zarr"), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["background_grid"] == "16 x 16"
    # The share of the white image, computed from the dense matrix.
    share = 1 - fine.sparse.sum() / dense.sum()
    assert info["background_share"] == pytest.approx(share, rel=1e-4)
    write_image(tmp_path / "p.png", np.full(PROJECTOR, 255, np.uint8))
    assert main(["relight", str(tmp_path / "s.zarr"), str(tmp_path / "p.png"), "-o",
                 str(tmp_path / "o.npy")]) == 0  # fmt: skip
    white = read_image(tmp_path / "o.npy")
    np.testing.assert_allclose(white.ravel(), dense.sum(axis=1), rtol=1e-4)
    known = csr_array(dense, dtype="f4")
    Truth(known, known.data * 0, CAMERA, PROJECTOR).save(tmp_path / "T.npz")
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "s.zarr"), "--truth", str(tmp_path / "T.npz"),
                 "--json"]) == 0  # fmt: skip
    errors = json.loads(capsys.readouterr().out)
    assert errors["relative_error"] < 1e-3
    assert errors["relighting_error"] < 1e-5


def test_errors_of_rows_are_those_of_the_dense_matrix(
    fine: LightTransport, dense: np.ndarray
) -> None:
    random = np.random.default_rng(1)
    known = random.random((ROWS, PIXELS)) * (random.random((ROWS, PIXELS)) < 0.02)
    truth = LightTransport.from_matrix(csr_array(known), CAMERA, PROJECTOR)
    wrong, total = squared_errors(fine, truth)
    np.testing.assert_allclose(wrong, ((dense - known) ** 2).sum(axis=1), rtol=1e-4)
    np.testing.assert_allclose(total, (known**2).sum(axis=1), rtol=1e-5)


def test_errors_need_no_dense_matrix() -> None:
    """The errors of 64 x 64 rows need far less memory than the 67 MB of the dense rows."""
    random = np.random.default_rng(2)
    sparse = scipy.sparse.random_array((4096, 4096), density=0.002, rng=random, dtype="f4")
    background = random.random((4096, 256)).astype("f4")
    estimate = LightTransport(csr_array(sparse), background, (64, 64), (64, 64), GRID)
    truth = LightTransport.from_matrix(csr_array(sparse), (64, 64), (64, 64))
    assert estimate.pooling.shape == (256, 4096)
    tracemalloc.start()
    relative_error(estimate, truth)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 45e6


@pytest.mark.parametrize("grid", [(51, 16), (16, 38), (0, 16)])
def test_grids_that_do_not_fit_are_refused(fine: LightTransport, grid: tuple[int, int]) -> None:
    background = np.zeros((ROWS, grid[0] * grid[1]), np.float32)
    with pytest.raises(InputError, match=f"grid.* {grid[0]} x {grid[1]}"):
        LightTransport(fine.sparse, background, CAMERA, PROJECTOR, grid)
