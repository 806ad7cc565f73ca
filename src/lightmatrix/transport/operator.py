"""T and its transpose as linear operators: ``transport @ p``, ``transport.T @ c``, their SVD."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.numpy_files import as_float32
from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.ranges import check_finite, real_array, whole
from lightmatrix.transport.sparse_rows import SparseRows

# How a matrix is given where something else was, in messages.
HOW_TO_GIVE = (
    "give what `estimate` or `open` returned, or "
    "lm.LightTransport.from_matrix(matrix, camera_shape, projector_shape)"
)


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
    def T(self) -> "Operator":  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """The transposed operator."""

    @abstractmethod
    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product with (columns, k) vectors of single or double precision, (rows, k)."""

    def __matmul__(self, other: Any) -> NDArray[Any]:
        """The product with vectors (n[, k]) or with an image, which gives an image as well."""
        values = real_array("values for a product with T", other)
        made, taken = self.image_shapes
        flat = values.ndim in (1, 2) and len(values) == self.shape[1]
        if flat:
            result = self.multiplied(_floating(values).reshape(self.shape[1], -1))
            return result.reshape(self.shape[0], *values.shape[1:])
        if values.shape == taken:
            return self.multiplied(_floating(values).reshape(-1, 1)).reshape(made)
        rows, size = self.shape[1], " x ".join(map(str, taken))
        hint = f"give a vector of {rows}, several as ({rows}, k), or an image of {size}"
        what = f"a product of a matrix of {self.shape[0]} x {rows} with values of shape"
        raise InputError(f"{what} {values.shape}", hint=hint)

    # NumPy must leave `array @ transport` to this class, which refuses it.
    __array_ufunc__ = None

    def __rmatmul__(self, other: Any) -> NDArray[Any]:
        raise InputError("a product with T on the right", hint="write transport.T @ c")

    def rmatmat(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product of the transpose with a vector (m,) or with (m, k) vectors."""
        return self.T @ vectors

    # SciPy's solvers call products with vectors by these names.
    matvec, matmat, rmatvec = __matmul__, __matmul__, rmatmat


@dataclass(frozen=True, eq=False, repr=False)
class Transposed(Operator):
    """The transpose of T: from lights at the camera to the image that the projector would see."""

    matrix: "TransportOperator"

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
    def T(self) -> "TransportOperator":  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """T itself."""
        return self.matrix

    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The product with (M, k) lights at the camera, (N, k)."""
        return self.matrix.multiplied_transposed(vectors)


class TransportOperator(Operator):
    """T as an operator; a class that holds T has the shapes, and says how it multiplies."""

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    background_grid: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Camera samples and projector pixels (M, N)."""
        return math.prod(self.camera_shape), math.prod(self.projector_shape)

    @property
    def image_shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The shapes of the camera and of the projector."""
        return self.camera_shape, self.projector_shape

    @property
    def sizes(self) -> str:
        """Both shapes in words."""
        camera, projector = (" x ".join(map(str, shape)) for shape in self.image_shapes)
        return f"camera {camera}, projector {projector}"

    @cached_property
    def pooling(self) -> csr_array:
        """The operator m: means over the cells of the background grid, (B, N)."""
        return cell_means(self.projector_shape, self.background_grid)

    @abstractmethod
    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        """All rows in blocks of bounded size: (first row, rows)."""

    @abstractmethod
    def some_rows(self, start: int, stop: int) -> SparseRows:
        """Some rows, whose diagnostics may be missing."""

    def multiplied(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """T p for (N, k) vectors p, block by block."""
        pooled = self.pooling @ vectors
        light = np.empty((self.shape[0], *vectors.shape[1:]), vectors.dtype)
        for start, block in self.blocks():
            part = block.coefficients @ vectors + block.background @ pooled
            light[start : start + block.count] = part
        return light

    def multiplied_transposed(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """T' c for (M,) or (M, k) vectors c, block by block, added in double precision."""
        image = np.zeros((self.shape[1], *vectors.shape[1:]))
        diffuse = np.zeros((math.prod(self.background_grid), *vectors.shape[1:]))
        for start, block in self.blocks():
            part = vectors[start : start + block.count]
            image += block.coefficients.T @ part
            diffuse += block.background.T @ part
        return np.asarray(image + self.pooling.T @ diffuse, vectors.dtype)

    def dense_columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        """Some columns of T, with background: (M, len(index)) float32."""
        pooled = self.pooling[:, index].toarray()
        columns = np.empty((self.shape[0], len(index)), np.float32)
        for start, block in self.blocks():
            values = block.coefficients[:, index].toarray() + block.background @ pooled
            columns[start : start + block.count] = values
        return columns

    def row(self, *camera_index: int) -> NDArray[np.float32]:
        """One row of T as a projector image: how much each pixel lights one camera sample.

        `camera_index` is the row, the column and, for a colour camera, the channel. Raises
        InputError if the camera has no such sample.
        """
        index = self.row_number(camera_index)
        row = self.some_rows(index, index + 1)
        values = row.coefficients.toarray() + row.background @ self.pooling
        return np.asarray(values, np.float32).reshape(self.projector_shape)

    @property
    def T(self) -> Transposed:  # noqa: N802 - the name of a transpose in NumPy and SciPy
        """The transpose: ``transport.T @ c`` is what the projector sees of lights c."""
        return Transposed(self)

    def row_number(self, camera_index: tuple[int, ...]) -> int:
        """The row of T of a camera sample; raises InputError if the camera has none there."""
        return _checked_index(camera_index, self.image_shapes[0], "camera sample")

    def relight(self, patterns: NDArray[Any]) -> NDArray[np.float32]:
        """Camera images under patterns: c = T p, linear, not clipped.

        `patterns` are (rows, cols) or (K, rows, cols) in [0, 1]; integers can only be 0 and 1. The
        images have the shape of the camera and are in units of camera full scale at exposure 1.
        """
        camera, projector = self.image_shapes
        stack = checked_patterns(patterns, projector)
        light = self.multiplied(stack.reshape(-1, self.shape[1]).T)
        images = np.asarray(light.T, np.float32).reshape(-1, *camera)
        return images if stack.ndim == 3 else images[0]

    def dual(self, lights: NDArray[Any]) -> NDArray[np.float32]:
        """The scene seen from the projector, lit from the camera: p = T' c (Sen et al. 2005).

        `lights` has the camera's shape and says how strongly each camera sample acts as a light.
        The result is the image that the projector would see, (rows, cols).
        """
        camera, projector = self.image_shapes
        values = real_array("camera lights", lights)
        if values.shape != camera:
            raise InputError(f"camera lights of shape {values.shape}", hint=f"give shape {camera}")
        light = as_float32(values)
        check_finite("camera lights", light)
        image = self.multiplied_transposed(light.ravel())
        return np.asarray(image, np.float32).reshape(projector)

    def dual_image(self) -> NDArray[np.float32]:
        """The scene seen from the projector, lit evenly from the camera.

        (rows, cols), or (rows, cols, channels) with a colour camera.
        """
        camera, projector = self.image_shapes
        lights = np.tile(
            np.eye(math.prod(camera[2:]), dtype=np.float32), (camera[0] * camera[1], 1)
        )
        return self.multiplied_transposed(lights).reshape(*projector, *camera[2:])

    def column(self, row: int, col: int) -> NDArray[np.float32]:
        """One column of T as a camera image: the response to one lit projector pixel.

        Raises InputError if the projector has no such pixel.
        """
        index = _checked_index((row, col), self.image_shapes[1], "projector pixel")
        return self.dense_columns(np.array([index]))[:, 0].reshape(self.image_shapes[0])


def _checked_index(index: tuple[int, ...], shape: tuple[int, ...], what: str) -> int:
    """The place of an index in a flattened image; raises InputError if it is outside."""
    numbers = [-1 if (number := whole(given)) is None else number for given in index]
    inside = all(0 <= n < size for n, size in zip(numbers, shape, strict=False))
    if len(index) != len(shape) or not inside:
        last = ", ".join(str(size - 1) for size in shape)
        hint = f"give {len(shape)} whole numbers from {', '.join('0' * len(shape))} to {last}"
        raise InputError(f"there is no {what} {', '.join(map(str, index)) or '()'}", hint=hint)
    return int(np.ravel_multi_index(numbers, shape))


def _floating(array: NDArray[Any]) -> NDArray[Any]:
    """Real numbers in single or double precision."""
    exact = array.dtype == np.float32
    small = array.dtype.kind == "b" or array.dtype.itemsize <= 2
    return array if exact else array.astype(np.float32 if small else np.float64)


def checked_patterns(
    patterns: NDArray[Any], projector_shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Patterns as float32; refuses other shapes than the projector's and values outside [0, 1]."""
    values = real_array("a pattern", patterns)
    # Before its values, which a view may have without end.
    if values.shape[-2:] != projector_shape or values.ndim not in (2, 3):
        size, hint = " x ".join(map(str, projector_shape)), "resize the pattern to the projector"
        what = f"the pattern has shape {values.shape}, but the projector has {size}"
        raise InputError(what, hint=hint)
    # Written so that it refuses NaN, too.
    if values.size and not (values.min() >= 0 and values.max() <= 1):
        raw = values.dtype.kind in "iu"
        raise InputError(
            f"the pattern has values from {values.min():g} to {values.max():g}",
            hint="use values in [0, 1]"
            + (": divide raw levels by their largest one, such as 255" if raw else ""),
        )
    return np.asarray(values, np.float32)


def cell_means(projector_shape: tuple[int, int], grid: tuple[int, int]) -> csr_array:
    """The operator m, (B, N) float32: means of a pattern over the B cells of a coarse grid."""
    cell = grid_cells(projector_shape, grid)
    sizes = np.bincount(cell, minlength=grid[0] * grid[1])
    entries = ((1 / sizes[cell]).astype(np.float32), (cell, np.arange(len(cell))))
    return csr_array(entries, shape=(grid[0] * grid[1], len(cell)))
