"""T and its transpose as linear operators: ``transport @ p``, ``transport.T @ c``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError


class Operator(ABC):
    """A matrix of which only products are needed; SciPy's `aslinearoperator` takes it as it is.

    Unlike `LightTransport.relight`, products take any finite values, also in double precision.
    """

    # The precision in which T is stored.
    dtype = np.dtype(np.float32)

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the matrix."""

    @property
    @abstractmethod
    def image_shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The shapes of a result and of an argument as images."""

    @property
    @abstractmethod
    def T(self) -> Operator:  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """The transposed operator."""

    @abstractmethod
    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product with (columns, k) vectors of single or double precision, (rows, k)."""

    def __matmul__(self, other: Any) -> NDArray[Any]:
        """The product with vectors (n[, k]) or with an image, which gives an image as well."""
        values = _floating(other)
        made, taken = self.image_shapes
        flat = values.ndim in (1, 2) and len(values) == self.shape[1]
        if flat:
            result = self.multiplied(values.reshape(self.shape[1], -1))
            return result.reshape(self.shape[0], *values.shape[1:])
        if values.shape == taken:
            return self.multiplied(values.reshape(-1, 1)).reshape(made)
        size = " x ".join(map(str, taken))
        raise InputError(
            f"a product of a matrix of {self.shape[0]} x {self.shape[1]} with values of shape "
            f"{values.shape}",
            hint=f"give a vector of {self.shape[1]}, several as ({self.shape[1]}, k), or an image "
            f"of {size}",
        )

    # NumPy must leave `array @ transport` to this class, which refuses it.
    __array_ufunc__ = None

    def __rmatmul__(self, other: Any) -> NDArray[Any]:
        raise InputError("a product with T on the right", hint="write transport.T @ c")

    def matvec(self, vector: NDArray[Any]) -> NDArray[Any]:
        """The product with a vector, as SciPy's iterative solvers call it."""
        return self @ vector

    def matmat(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product with (n, k) vectors."""
        return self @ vectors

    def rmatvec(self, vector: NDArray[Any]) -> NDArray[Any]:
        """The product of the transpose with a vector."""
        return self.T @ vector

    def rmatmat(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product of the transpose with (m, k) vectors."""
        return self.T @ vectors


@dataclass(frozen=True, eq=False, repr=False)
class Transposed(Operator):
    """The transpose of T: from lights at the camera to the image that the projector would see."""

    matrix: TransportOperator

    def __repr__(self) -> str:
        return f"{self.matrix!r}.T"

    @property
    def shape(self) -> tuple[int, int]:
        """Projector pixels and camera samples (N, M)."""
        return self.matrix.shape[::-1]

    @property
    def image_shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The shapes of the projector and of the camera."""
        return self.matrix.image_shapes[::-1]

    @property
    def T(self) -> TransportOperator:  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """T itself."""
        return self.matrix

    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product with (M, k) lights at the camera, (N, k)."""
        return self.matrix.multiplied_transposed(vectors)


class TransportOperator(Operator):
    """T as an operator; a class that holds T says how it multiplies."""

    @abstractmethod
    def multiplied_transposed(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product of the transpose with (M, k) vectors, (N, k)."""

    @property
    def T(self) -> Transposed:  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """The transpose: ``transport.T @ c`` is what the projector sees of lights c."""
        return Transposed(self)

    def row_number(self, camera_index: tuple[int, ...]) -> int:
        """The row of T of a camera sample; raises InputError if the camera has none there."""
        return _checked_index(camera_index, self.image_shapes[0], "camera sample")

    def column_number(self, row: int, col: int) -> int:
        """The column of T of a projector pixel; raises InputError if there is none."""
        return _checked_index((row, col), self.image_shapes[1], "projector pixel")


def _checked_index(index: tuple[int, ...], shape: tuple[int, ...], what: str) -> int:
    """The place of an index in a flattened image; raises InputError if it is outside."""
    whole = all(hasattr(number, "__index__") for number in index)
    inside = whole and len(index) == len(shape)
    if not (inside and all(0 <= n < size for n, size in zip(index, shape, strict=True))):
        last = ", ".join(str(size - 1) for size in shape)
        raise InputError(
            f"there is no {what} {', '.join(map(str, index)) or '()'}",
            hint=f"give {len(shape)} whole numbers from {', '.join('0' * len(shape))} to {last}",
        )
    return int(np.ravel_multi_index(index, shape))


def _floating(values: Any) -> NDArray[Any]:
    """Values as an array of single or double precision."""
    array = np.asarray(values)
    if array.dtype.kind not in "bfiu":
        raise InputError(
            f"a product of T with {array.dtype} values", hint="give real numbers as an array"
        )
    exact = array.dtype == np.float32
    small = array.dtype.kind == "b" or array.dtype.itemsize <= 2
    return array if exact else array.astype(np.float32 if small else np.float64)
