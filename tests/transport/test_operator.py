"""T as a linear operator: products, its transpose, SciPy, indices, and singular values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.linalg import aslinearoperator, lsqr

import lightmatrix as lm
from lightmatrix.pictures.transport import spectrum
from lightmatrix.transport.operator import TransportOperator
from tests.helpers.stores import transport as small_transport

CAMERAS = ((5, 4), (3, 2, 3))


@pytest.fixture(params=["memory", "store"])
def held(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(request.param)


def _operator(camera: tuple[int, ...], held: str, folder: Path) -> TransportOperator:
    matrix = small_transport(camera)
    if held == "memory":
        return matrix
    lm.save(folder / "T.zarr", matrix)
    return lm.StoredTransport.open(folder / "T.zarr")


def _dense(camera: tuple[int, ...]) -> np.ndarray:
    return small_transport(camera).to_matrix(dense_background=True).toarray().astype(float)


@pytest.mark.parametrize("camera", CAMERAS)
def test_products_are_those_of_the_dense_matrix(
    camera: tuple[int, ...], held: str, tmp_path: Path
) -> None:
    operator, dense = _operator(camera, held, tmp_path), _dense(camera)
    random = np.random.default_rng(0)
    several, lights = random.standard_normal((42, 3)), random.standard_normal((dense.shape[0], 2))
    np.testing.assert_allclose(operator @ several, dense @ several, atol=1e-5)
    np.testing.assert_allclose(operator @ several[:, 0], dense @ several[:, 0], atol=1e-5)
    np.testing.assert_allclose(operator.T @ lights, dense.T @ lights, atol=1e-5)
    np.testing.assert_allclose(operator.T.T @ several, dense @ several, atol=1e-5)
    image = several[:, 1].reshape(6, 7)
    assert (operator @ image).shape == camera
    np.testing.assert_allclose((operator @ image).ravel(), dense @ several[:, 1], atol=1e-5)
    light = lights[:, 1].reshape(camera)
    assert (operator.T @ light).shape == (6, 7)
    np.testing.assert_allclose((operator.T @ light).ravel(), dense.T @ lights[:, 1], atol=1e-5)


def test_the_transpose_is_the_adjoint_to_double_precision(held: str, tmp_path: Path) -> None:
    operator = _operator((5, 4), held, tmp_path)
    random = np.random.default_rng(1)
    pattern, light = random.standard_normal(42), random.standard_normal(20)
    there, back = light @ (operator @ pattern), pattern @ (operator.T @ light)
    assert there == pytest.approx(back, rel=1e-6)
    assert (operator @ pattern).dtype == np.float64
    assert (operator @ pattern.astype(np.float32)).dtype == np.float32


def test_scipy_solves_with_it(held: str, tmp_path: Path) -> None:
    operator = _operator((5, 4), held, tmp_path)
    linear = aslinearoperator(operator)
    assert linear.shape == (20, 42)
    light = np.random.default_rng(2).random(20)
    solved = lsqr(linear, light)[0]
    expected = np.linalg.lstsq(_dense((5, 4)), light, rcond=None)[0]
    np.testing.assert_allclose(solved, expected, atol=1e-3)


def test_relighting_and_dual_are_its_products(held: str, tmp_path: Path) -> None:
    operator = _operator((5, 4), held, tmp_path)
    assert isinstance(operator, lm.LightTransport | lm.StoredTransport)
    pattern = np.random.default_rng(3).random((6, 7)).astype(np.float32)
    np.testing.assert_allclose(operator.relight(pattern), operator @ pattern, rtol=1e-5)
    light = np.random.default_rng(3).random((5, 4)).astype(np.float32)
    np.testing.assert_allclose(operator.dual(light), operator.T @ light, rtol=1e-5)


@pytest.mark.parametrize("shape", [(41,), (6, 8), (2, 6, 7), (42, 2, 2), ()])
def test_other_shapes_are_refused(shape: tuple[int, ...], held: str, tmp_path: Path) -> None:
    with pytest.raises(lm.InputError, match="matrix of 20 x 42") as error:
        _operator((5, 4), held, tmp_path) @ np.zeros(shape)
    assert "a vector of 42" in (error.value.hint or "")


def test_words_and_complex_numbers_are_refused() -> None:
    for wrong in (np.full(42, "1"), np.full(42, 1j)):
        with pytest.raises(lm.InputError, match="real numbers"):
            small_transport() @ wrong
    with pytest.raises(lm.InputError, match=r"write transport\.T @ c"):
        np.zeros(20) @ small_transport()


def test_what_is_outside_is_named(held: str, tmp_path: Path) -> None:
    operator = _operator((3, 2, 3), held, tmp_path)
    assert isinstance(operator, lm.LightTransport | lm.StoredTransport)
    for index in ((3, 0, 0), (0, 0, -1), (0, 0), (0.5, 0, 0), ()):
        with pytest.raises(lm.InputError, match="there is no camera sample") as error:
            operator.row(*index)
        assert "0, 0, 0 to 2, 1, 2" in (error.value.hint or "")
    for row, col in ((6, 0), (0, -1)):
        with pytest.raises(lm.InputError, match="there is no projector pixel"):
            operator.column(row, col)
    assert operator.row(2, 1, 2).shape == operator.row(0, 0, 0).shape == (6, 7)


@pytest.mark.parametrize("rows", [0, 1, 12])
def test_the_spectrum_of_a_matrix_also_if_it_is_dark_or_of_one_sample(rows: int) -> None:
    dense = np.random.default_rng(0).random((max(rows, 1), 20)) * (rows > 0)
    shape = (max(rows, 1), 1), (4, 5)
    transport = lm.LightTransport.from_matrix(csr_array(dense), *shape)
    expected = np.linalg.svd(dense, compute_uv=False)
    found = spectrum(transport)["values"]
    np.testing.assert_allclose(found, expected[: len(found)], rtol=1e-5)
    assert len(found) == max(1, rows - 1)
