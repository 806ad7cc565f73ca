"""`LightTransport`: every view of T agrees with the dense matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import open as open_store
from lightmatrix.transport.store import save

sizes = st.integers(1, 6)


@st.composite
def transports(draw: st.DrawFn) -> LightTransport:
    camera = tuple(draw(st.lists(sizes, min_size=2, max_size=3)))
    projector = (draw(sizes), draw(sizes))
    grid = (draw(st.integers(1, projector[0])), draw(st.integers(1, projector[1])))
    random = np.random.default_rng(draw(st.integers(0, 1000)))
    rows, pixels = int(np.prod(camera)), projector[0] * projector[1]
    dense = random.random((rows, pixels)) * (random.random((rows, pixels)) < 0.4)
    background = random.random((rows, grid[0] * grid[1])).astype(np.float32)
    matrix = csr_array(dense, dtype=np.float32)
    return LightTransport(matrix, background, camera, projector, grid)


def _dense(transport: LightTransport) -> np.ndarray:
    """T by its definition, one projector pixel at a time."""
    rows, cols = transport.projector_shape
    grid_rows, grid_cols = transport.background_grid
    result = transport.sparse.toarray().astype(float)
    block = np.array(
        [[r * grid_rows // rows * grid_cols + c * grid_cols // cols for c in range(cols)]
         for r in range(rows)]
    ).ravel()  # fmt: skip
    for pixel, own in enumerate(block):
        result[:, pixel] += transport.background[:, own] / (block == own).sum()
    return result


@given(transports(), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_all_views_agree_with_the_dense_matrix(transport: LightTransport, seed: int) -> None:
    dense = _dense(transport)
    random = np.random.default_rng(seed)
    patterns = random.random((3, *transport.projector_shape)).astype(np.float32)
    expected = patterns.reshape(3, -1) @ dense.T
    images = transport.relight(patterns)
    assert images.shape == (3, *transport.camera_shape)
    np.testing.assert_allclose(images.reshape(3, -1), expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(transport.relight(patterns[1]), images[1], rtol=1e-5)

    lights = random.random(transport.camera_shape)
    dual = transport.dual(lights)
    np.testing.assert_allclose(dual.ravel(), dense.T @ lights.ravel(), rtol=1e-4, atol=1e-5)

    camera = tuple(int(random.integers(size)) for size in transport.camera_shape)
    row = int(np.ravel_multi_index(camera, transport.camera_shape))
    np.testing.assert_allclose(transport.row(*camera).ravel(), dense[row], rtol=1e-5)
    place = tuple(int(random.integers(size)) for size in transport.projector_shape)
    pixel = int(np.ravel_multi_index(place, transport.projector_shape))
    np.testing.assert_allclose(transport.column(*place).ravel(), dense[:, pixel], rtol=1e-5)
    whole = transport.to_matrix(dense_background=True).toarray()
    np.testing.assert_allclose(whole, dense, rtol=1e-5)
    np.testing.assert_array_equal(transport.to_matrix().toarray(), transport.sparse.toarray())


def test_bad_shapes_are_refused() -> None:
    matrix = csr_array((6, 4), dtype=np.float32)
    good = LightTransport.from_matrix(matrix, (2, 3), (2, 2))
    for call, message in (
        (lambda: LightTransport.from_matrix(matrix, (2, 2), (2, 2)), r"must be \(4, 4\)"),
        (
            lambda: LightTransport(matrix, np.zeros((6, 2), np.float32), (2, 3), (2, 2)),
            "background",
        ),
        (lambda: good.relight(np.ones((3, 3))), "resize the pattern"),
        (lambda: good.dual(np.ones((3, 3))), r"give shape \(2, 3\)"),
        (
            lambda: LightTransport.from_matrix(
                matrix, (2, 3), (2, 2), diagnostics={"gap": np.zeros(3)}
            ),
            "one value for each row",
        ),
    ):
        with pytest.raises(InputError, match=message):
            call()


def _parts(**changed: Any) -> dict[str, Any]:
    """What a small matrix consists of, with something changed."""
    sparse = csr_array((np.ones(4), np.arange(4), np.array([0, 1, 2, 3, 4, 4, 4])), shape=(6, 4))
    for name in ("data", "indices", "indptr"):
        setattr(sparse, name, changed.pop(name, getattr(sparse, name)))
    usual = {"sparse": sparse, "background": np.zeros((6, 1), np.float32)}
    return {**usual, "camera_shape": (2, 3), "projector_shape": (2, 2), **changed}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        # As MATLAB counts. SciPy accepts them, and reads what lies behind the vector.
        ({"indices": np.array([1, 2, 3, 4])}, "outside the 4 columns.*\n.*MATLAB counts from 1"),
        ({"indices": np.array([-1, 1, 2, 3])}, "outside"),
        ({"indptr": np.array([0, 1, 2, 3, 9, 4, 4])}, "indptr does not rise"),
        ({"data": np.array([1, np.nan, 1, 1], np.float32)}, "not finite"),
        ({"data": np.array([1, 1e39, 1, 1])}, "not finite"),
        ({"data": np.ones(4, complex)}, "complex128 values"),
        ({"sparse": np.ones((6, 4))}, "ndarray as the sparse part.*\n.*from_matrix"),
        ({"sparse": None}, "NoneType as the sparse part"),
        ({"background": np.full((6, 1), np.inf)}, "background that are not all finite"),
        ({"background": np.ma.MaskedArray(np.ones((6, 1)), mask=True)}, "6 masked values"),
        ({"camera_shape": (2, 3.0)}, "camera_shape is no shape"),
        ({"projector_shape": 4}, "projector_shape is no shape"),
        ({"diagnostics": {"a/b": np.zeros(6)}}, "letters, digits"),
        ({"diagnostics": {"gap": np.zeros(6, "O")}}, "'gap' of type object"),
        ({"diagnostics": [1]}, "list in place of diagnostics"),
        ({"provenance": None}, "NoneType in place of a provenance"),
    ],
)  # fmt: skip
def test_what_no_store_could_hold_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LightTransport(**_parts(**changed))


def test_what_is_accepted_can_be_saved_and_opened(tmp_path: Path) -> None:
    listed = LightTransport(
        **_parts(
            data=np.ones(4, int),
            background=np.zeros((6, 1)),
            camera_shape=[2, 3],
            diagnostics={"gap": [0] * 6},
        )
    )
    empty = LightTransport.from_matrix(np.zeros((6, 4)), (2, 3), (2, 2))
    for number, transport in enumerate((listed, empty)):
        save(tmp_path / f"{number}.zarr", transport)
        again = open_store(tmp_path / f"{number}.zarr")
        np.testing.assert_array_equal(again.sparse.toarray(), transport.sparse.toarray())
        assert again.camera_shape == (2, 3)
    listed.sparse.data[0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        save(tmp_path / "changed.zarr", listed)


@pytest.mark.parametrize(
    "pattern",
    [
        np.full((6, 7), 255, np.uint8),
        np.full((6, 7), 2, np.int64),
        np.full((6, 7), -1, np.int16),
        np.full((6, 7), 1.5),
        np.full((6, 7), -0.1, np.float32),
        np.full((6, 7), np.nan),
        np.full((6, 7), 1j),
    ],
)
def test_values_outside_0_to_1_are_refused(pattern: NDArray[Any]) -> None:
    matrix = LightTransport.from_matrix(csr_array(np.ones((4, 42))), (2, 2), (6, 7))
    with pytest.raises(InputError, match=r"the pattern has values|a pattern of type complex"):
        matrix.relight(pattern)
    lit = np.ones((6, 7))
    for kind in (np.uint8, np.bool_, np.int64, np.float64):
        np.testing.assert_array_equal(matrix.relight(lit.astype(kind)), matrix.relight(lit))
