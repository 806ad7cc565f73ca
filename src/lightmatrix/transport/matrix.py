"""`LightTransport`, the matrix in memory, and `ColourTransport`, one for each primary."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, issparse

from lightmatrix.errors import InputError
from lightmatrix.files.images import encode_image
from lightmatrix.files.numpy_files import as_float32
from lightmatrix.patterns.pattern_set import check_grid
from lightmatrix.ranges import check_finite, check_type, real_array
from lightmatrix.regions import Region
from lightmatrix.reprs import html_table, labelled
from lightmatrix.transport.operator import HOW_TO_GIVE, TransportOperator, cell_means
from lightmatrix.transport.sparse_rows import SparseRows, checked_matrix, checked_shape

# The entry of the provenance with the sizes of several projectors; see `Capture.projectors`.
PROJECTORS = "projectors"
# The entries of the provenance that a summary repeats.
_SUMMARY_KEYS = ("estimator", "solver", "regularization", "certificate", "pattern_digest", "scene")

# The statistics of diagnostics in a summary. Unknown values are NaN and do not count.
_STATISTICS: dict[str, tuple[str, Callable[[NDArray[Any]], Any]]] = {
    "clipped_samples": ("clipped_share", np.mean),
    "rows_half_clipped": ("clipped_share", lambda shares: np.mean(shares > 0.5)),
    "iterations_median": ("iterations", np.median), "converged_rows": ("converged", np.mean),
    "gap_median": ("gap", np.nanmedian), "gap_max": ("gap", np.nanmax),
    "rows_searched_everywhere": ("searched_everywhere", np.mean),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class LightTransport(TransportOperator):
    """T = S + B m: a sparse part and a low-resolution background, in camera full scale.

    ``T p = S p + B m(p)``, where m(p) are the means of the pattern p over the cells of a coarse
    grid. With a grid of 1 x 1 that is one value per camera sample times the mean of the pattern.

    Parameters
    ----------
    sparse : (M, N) csr_array float32
        Sparse part S: camera full scale at exposure 1 per unit of projector pixel.
    background : (M, B) float32
        Background of each camera sample, for the B cells of ``background_grid``.
    camera_shape : (rows, cols) or (rows, cols, channels)
        M = product; camera samples in the order (row, col, channel).
    projector_shape : (rows, cols)
        N = rows * cols.
    background_grid : (int, int)
        Rows and columns of the coarse grid; B = product.
    diagnostics : mapping of str to (M,) array
        Facts about each row: share of clipped samples, gap, iterations, regularization.
    provenance : mapping
        How T was made: versions, parameters, pattern digest, seed. JSON-ready.

    Raises
    ------
    InputError
        If shapes do not match, an index lies outside, or a value is not finite.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> transport = lm.truth("metal").transport()
    >>> stripes = np.zeros(transport.projector_shape)
    >>> stripes[:, ::8] = 1
    >>> transport.relight(stripes).shape, transport.dual(np.ones((64, 64))).shape
    ((64, 64), (64, 64))
    >>> transport.row(20, 30).shape, transport.column(10, 10).shape
    ((64, 64), (64, 64))

    It is a linear operator, also for SciPy's iterative methods:

    >>> (transport @ np.ones(4096)).shape, (transport.T @ np.ones((64, 64))).shape
    ((4096,), (64, 64))
    >>> from scipy.sparse.linalg import aslinearoperator
    >>> aslinearoperator(transport).shape
    (4096, 4096)
    """

    sparse: csr_array
    background: NDArray[np.float32]
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    background_grid: tuple[int, int] = (1, 1)
    diagnostics: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        made = self.provenance.get("estimator") or self.provenance.get("scene")
        by = f", {made}" if made else ""
        return f"LightTransport({self.sizes}, {self.sparse.nnz} entries{by})"

    def _repr_html_(self) -> str:
        # The scene under a white pattern, of at most 256 pixels a side.
        white = self.relight(np.ones(self.projector_shape, np.float32))
        image = white.reshape(*self.camera_shape[:2], -1)[:: -(-white.shape[0] // 256)]
        image = image[:, :: -(-white.shape[1] // 256)]
        image = image if image.shape[2] == 3 else image.mean(axis=2)
        shown = np.clip(image / max(float(np.quantile(image, 0.99)), 1e-12), 0, 1) ** (1 / 2.2)
        picture = encode_image((255 * shown).astype(np.uint8), "png")
        return html_table(
            "Light transport matrix", labelled(self.summary(), main_only=True), picture
        )

    def __post_init__(self) -> None:
        # Compiled routines trust the indices, and a store is only opened if all of this is so.
        sparse = self.sparse
        if getattr(sparse, "format", None) != "csr":
            hint = "give a scipy.sparse.csr_array, or use LightTransport.from_matrix"
            raise InputError(f"{type(sparse).__name__} as the sparse part of T", hint=hint)
        try:
            camera = checked_shape(self.camera_shape, (2, 3), "camera_shape")
            rows, cols = checked_shape(self.projector_shape, (2,), "projector_shape")
            high, wide = checked_shape(self.background_grid, (2,), "background_grid")
        except ValueError as error:
            hint = "give whole numbers from 1, such as (480, 640)"
            raise InputError(f"{error}", hint=hint) from error
        expected = (math.prod(camera), rows * cols)
        if sparse.shape != expected:
            raise InputError(
                f"the matrix has shape {sparse.shape}, for camera {camera} and "
                f"projector {(rows, cols)}",
                hint=f"its shape must be {expected}",
            )
        try:
            sparse = checked_matrix(sparse.data, sparse.indices, sparse.indptr, expected)
        except ValueError as error:
            hint = "count rows and columns from 0 (MATLAB counts from 1), and give real numbers"
            raise InputError(f"the sparse part of T: {error}", hint=hint) from error
        check_grid((rows, cols), (high, wide))
        background = real_array("a background", self.background)
        if background.shape != (expected[0], high * wide):
            hint = f"its shape must be ({expected[0]}, {high * wide})"
            raise InputError(f"the background has shape {background.shape}", hint=hint)
        background = as_float32(background)
        check_finite("values of the background", background)
        check_type("diagnostics by name", self.diagnostics, Mapping, hint="give a dict")
        check_type("a provenance", self.provenance, Mapping, hint="give a dict")
        diagnostics = {}
        for name, given in self.diagnostics.items():
            values = diagnostics[name] = real_array(f"diagnostic {name!r}", given)
            if values.shape != (expected[0],):
                hint = "give one value for each row"
                raise InputError(f"diagnostic {name!r} has shape {values.shape}", hint=hint)
            # Names become those of folders.
            if not name.isidentifier():
                hint = "use letters, digits and underscores"
                raise InputError(f"a diagnostic called {name!r}", hint=hint)
        checked = (sparse, background, camera, (rows, cols), (high, wide), diagnostics)
        for part, value in zip(fields(self), checked, strict=False):
            object.__setattr__(self, part.name, value)

    @classmethod
    def from_matrix(
        cls,
        matrix: csr_array,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        **more: Any,
    ) -> "LightTransport":
        """A light transport without background, such as a rendered truth."""
        # Stated here, because SciPy drops the mask of a masked array.
        dense = matrix if issparse(matrix) else real_array("a matrix", matrix)
        if dense.ndim != 2:
            raise InputError(f"a matrix of shape {dense.shape}", hint="give rows and columns")
        sparse = csr_array(dense)
        background = np.zeros((sparse.shape[0], 1), np.float32)
        return cls(sparse, background, camera_shape, projector_shape, **more)

    def blocks(self) -> Iterator[tuple[int, SparseRows]]:
        """All rows at once: (0, rows)."""
        yield 0, SparseRows(self.sparse, self.background)

    def some_rows(self, start: int, stop: int) -> SparseRows:
        """Some rows without their diagnostics."""
        return SparseRows(csr_array(self.sparse[start:stop]), self.background[start:stop])

    def crop(self, region: Region) -> "LightTransport":
        """The light transport of a rectangle of camera pixels."""
        rows = region.samples(self.camera_shape)
        return replace(
            self, sparse=self.sparse[rows], background=self.background[rows],
            camera_shape=(*region.shape, *self.camera_shape[2:]),
            diagnostics={name: values[rows] for name, values in self.diagnostics.items()},
        )  # fmt: skip

    def cropped_like(self, estimate: "LightTransport") -> "LightTransport":
        """The part that `estimate` covers: of cropped photographs, of one of several projectors."""
        region, number = estimate.region, estimate.provenance.get("projector")
        part = self.split()[number - 1] if number and PROJECTORS in self.provenance else self
        if region is None or estimate.camera_shape[:2] != region.shape:
            return part
        return part.crop(region) if self.camera_shape[:2] == region.whole else part

    def split(self) -> "tuple[LightTransport, ...]":
        """T of each of several projectors that were measured at once; itself if there is one."""
        sizes = self.provenance.get(PROJECTORS)
        if not sizes:
            return (self,)
        places = np.arange(self.shape[1]).reshape(len(sizes), -1, self.projector_shape[1])
        columns, pooling = self.sparse.tocsc(), self.pooling.tocsc()
        kept = {key: value for key, value in self.provenance.items() if key != PROJECTORS}
        result = []
        for number, (rows, cols) in enumerate(sizes, start=1):
            own = places[number - 1, :rows, :cols].ravel()
            high, wide = self.background_grid
            grid = min(max(1, high // len(sizes)), rows), min(wide, cols)
            # What a cell gives each of its pixels, added up over the pixels of each new cell.
            cells = pooling[:, own] @ (cell_means((rows, cols), grid) > 0).T
            background = np.asarray(self.background @ cells, np.float32)
            parts = (csr_array(columns[:, own]), background, self.camera_shape, (rows, cols), grid)
            about = {**kept, "projector": number}
            result.append(LightTransport(*parts, self.diagnostics, about))
        return tuple(result)

    @property
    def region(self) -> Region | None:
        """The rectangle of the photographs that the estimate used; None if all of them."""
        description = self.provenance.get("capture_description")
        crop = description.get("crop") if isinstance(description, Mapping) else None
        if not isinstance(crop, Mapping):
            return None
        pairs = [crop.get(name) for name in ("corner", "shape", "whole")]
        # The provenance of a store may hold anything.
        try:
            return Region(*((int(rows), int(cols)) for rows, cols in pairs))  # type: ignore[misc]
        except (TypeError, ValueError, InputError):
            return None

    def summary(self) -> dict[str, Any]:
        """Shapes, sparsity, clipping, convergence and gaps by name; JSON-ready."""
        entries = np.diff(self.sparse.indptr)
        result: dict[str, Any] = {
            "camera": " x ".join(map(str, self.camera_shape)),
            **({} if self.region is None else {"crop": str(self.region)}),
            "projector": " x ".join(map(str, self.projector_shape)),
            "entries": int(entries.sum()),
            "entries_per_row": float(entries.mean()),
            "background_grid": " x ".join(map(str, self.background_grid)),
            "background_share": self.background_share,
        }
        for name, (diagnostic, statistic) in _STATISTICS.items():
            values = self.diagnostics.get(diagnostic)
            if values is not None and np.isfinite(values).any():
                result[name] = float(statistic(values))
        result |= {name: self.provenance[name] for name in _SUMMARY_KEYS if name in self.provenance}
        parameters = self.provenance.get("solver_parameters")
        if isinstance(parameters, Mapping) and "fidelity" in parameters:
            result["fidelity"] = parameters["fidelity"]
        return result

    @property
    def background_share(self) -> float:
        """The share of the light of the white image that the background holds."""
        # Under a white pattern the mean of every cell is 1.
        diffuse = float(self.background.sum(dtype=np.float64))
        # `sparse.sum()` would copy the whole matrix in double precision.
        total = diffuse + float(self.sparse.data.sum(dtype=np.float64))
        return diffuse / total if total else 0.0

    def to_matrix(self, *, dense_background: bool = False) -> csr_array:
        """T as one sparse matrix.

        `dense_background` spreads the background over all pixels, which is exact but has M x N
        entries. Otherwise the background is omitted.
        """
        if not dense_background:
            return self.sparse
        return csr_array(self.sparse + csr_array(self.background) @ self.pooling)


def prediction_error(transport: LightTransport) -> float | None:
    """The relative error of photographs held out, over all rows; None if none was predicted."""
    errors = np.asarray(transport.diagnostics.get("prediction_error", np.zeros(0)), float)
    known = np.isfinite(errors)
    return float(np.sqrt(np.mean(errors[known] ** 2))) if known.any() else None


@dataclass(frozen=True, eq=False)
class ColourTransport:
    """T of a colour projector: the matrices of red, green and blue, whose light adds up.

    It can be given wherever three matrices can: to `relight`, `evaluate_colour` and `compensate`.

    Parameters
    ----------
    red, green, blue : LightTransport
        T of each primary, of one camera and one size of patterns.

    Raises
    ------
    InputError
        If their shapes differ.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> colour = lm.ColourTransport(known, known, known)
    >>> colour.relight(np.ones((64, 64, 3))).shape, colour.dual_image().shape
    ((64, 64), (64, 64, 3))
    """

    red: LightTransport
    green: LightTransport
    blue: LightTransport

    def __post_init__(self) -> None:
        for other in (self.red, self.green, self.blue):
            check_type("a light transport matrix", other, LightTransport, hint=HOW_TO_GIVE)
            if other.image_shapes != self.red.image_shapes:
                raise InputError(
                    f"matrices of shapes {self.red.image_shapes} and {other.image_shapes}",
                    hint="give red, green and blue of one rig",
                )

    def __iter__(self) -> Iterator[LightTransport]:
        return iter((self.red, self.green, self.blue))

    def __len__(self) -> int:
        return 3

    def __getitem__(self, primary: int) -> LightTransport:
        return (self.red, self.green, self.blue)[primary]

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Rows, columns and channels of a photograph."""
        return self.red.camera_shape

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Rows and columns of a pattern."""
        return self.red.projector_shape

    def relight(self, patterns: NDArray[Any]) -> NDArray[np.float32]:
        """Camera images under patterns in colour, (rows, cols, 3) or (K, rows, cols, 3).

        Grey patterns, (rows, cols), are white light. The images are linear and not clipped.
        """
        shown = real_array("a pattern", patterns)
        if shown.ndim < 3:
            shown = np.repeat(shown[..., None], 3, axis=-1)
        if shown.shape[-1] != 3:
            hint = "give (rows, cols, 3), or (rows, cols) for white light"
            raise InputError(f"a pattern of shape {shown.shape} for a colour projector", hint=hint)
        parts = [one.relight(shown[..., number]) for number, one in enumerate(self)]
        return np.asarray(parts[0] + parts[1] + parts[2])

    def dual_image(self) -> NDArray[np.float32]:
        """The scene seen from the projector in its primaries, lit evenly from the camera.

        (rows, cols, 3): how much of each primary's light at each pixel reaches all channels.
        """
        lights = np.ones(self.camera_shape, np.float32)
        return np.stack([one.dual(lights) for one in self], axis=-1)
