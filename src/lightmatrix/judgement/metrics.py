"""Metrics of an estimate against the truth, for users, experiments and benchmarks alike."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, kron

from lightmatrix.errors import InputError
from lightmatrix.patterns.blocks import sampled_pixels
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import row_blocks

# A single response counts as unclipped up to this share of the clip level. The margin of 2 % is
# part of the metric's definition, chosen by hand.
UNCLIPPED_RESPONSE = 0.98
# Rows are processed in chunks of about this many bytes.
_CHUNK_BYTES = 64 << 20


def relative_error(
    estimate: LightTransport, truth: LightTransport, rows: NDArray[np.integer] | None = None
) -> float:
    """||T_est - T||_F / ||T||_F over some rows (None: all), background included."""
    wrong, total = squared_errors(estimate, truth)
    chosen = slice(None) if rows is None else rows
    missed, energy = float(wrong[chosen].sum()), float(total[chosen].sum())
    return float(np.sqrt(missed / energy if energy else missed))


def squared_errors(
    estimate: LightTransport, truth: LightTransport
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """||T_est - T||^2 and ||T||^2 of each row, (M,) each, backgrounds included."""
    check_same_rig(estimate, truth)
    wrong = np.empty(truth.sparse.shape[0])
    entries = np.asarray(estimate.sparse.indptr, np.int64) + truth.sparse.indptr
    cells = estimate.background.shape[1] + truth.background.shape[1]
    grids = _Grids.of(estimate.pooling, truth.pooling)
    for rows in _blocks(entries, cells):
        difference = csr_array(estimate.sparse[rows] - truth.sparse[rows], dtype=np.float64)
        backgrounds = [estimate.background[rows], -truth.background[rows]]
        wrong[rows] = _row_energies(difference, backgrounds, grids)
    return wrong, row_energies(truth)


def row_energies(transport: LightTransport) -> NDArray[np.float64]:
    """||T_i||^2 of each row, background included, (M,) float64."""
    result = np.empty(transport.sparse.shape[0])
    cells, grids = transport.background.shape[1], _Grids.of(transport.pooling)
    for rows in _blocks(transport.sparse.indptr, cells):
        sparse = csr_array(transport.sparse[rows], dtype=np.float64)
        result[rows] = _row_energies(sparse, [transport.background[rows]], grids)
    return result


@dataclass(frozen=True)
class _Grids:
    """Means m over the cells of backgrounds, made once for all blocks of rows."""

    # m' of each, (N, B), and the products m m' of each two.
    turned: list[csr_array]
    products: list[list[NDArray[np.float64]]]

    @classmethod
    def of(cls, *means: csr_array) -> Self:
        turned = [csr_array(each.T, dtype=np.float64) for each in means]
        return cls(turned, [[(one @ other).toarray() for other in turned] for one in means])


def _blocks(indptr: NDArray[np.integer], cells: int = 0, bytes_each: int = 32) -> Iterator[slice]:
    """Slices of rows whose entries and background cells, `bytes_each` each, fill a chunk.

    By default an entry takes a double, its square, and two indices.
    """
    ends = np.asarray(indptr, np.int64) + cells * np.arange(len(indptr))
    for start, stop in itertools.pairwise(row_blocks(ends, _CHUNK_BYTES // bytes_each)):
        yield slice(start, stop)


def _row_energies(
    sparse: csr_array, backgrounds: list[NDArray[Any]], grids: _Grids
) -> NDArray[np.float64]:
    """||S + sum B m||^2 of each row, from products of the parts, so that nothing becomes dense."""
    squares = csr_array((sparse.data**2, sparse.indices, sparse.indptr), shape=sparse.shape)
    energy = np.asarray(squares.sum(axis=1), np.float64)
    for i, background in enumerate(backgrounds):
        if not background.any():
            continue
        own = background.astype(np.float64)
        energy += 2 * ((sparse @ grids.turned[i]).toarray() * own).sum(axis=1)
        for j in range(i, len(backgrounds)):
            product = ((own @ grids.products[i][j]) * backgrounds[j]).sum(axis=1)
            energy += product if i == j else 2 * product
    return np.maximum(energy, 0)


def response_rmse(
    estimate: LightTransport,
    truth: LightTransport,
    *,
    clip_level: float = 1.0,
    step: int = 8,
    offset: int = 4,
) -> float:
    """RMSE against one-pixel responses of projector pixels on a grid, as in the paper's Fig. 6.

    The result is in units of `clip_level`, which is 1 / exposure. The grid has the projector pixels
    (offset + step i, offset + step j).
    """
    check_same_rig(estimate, truth)
    columns = sampled_pixels(truth.projector_shape, step, min(offset, step - 1))
    difference = csr_array(estimate.sparse[:, columns] - truth.sparse[:, columns])
    light = [(t.background, t.pooling[:, columns].toarray()) for t in (estimate, truth)]
    (background, cells), (true_background, true_cells) = light
    wrong, size = 0.0, max(1, _CHUNK_BYTES // (4 * max(1, len(columns))))
    for start in range(0, difference.shape[0], size):
        part = slice(start, start + size)
        dense = difference[part].toarray() + background[part] @ cells
        missed = dense - true_background[part] @ true_cells
        wrong += float(np.square(missed, dtype=np.float64).sum())
    count = difference.shape[0] * difference.shape[1]
    return float(np.sqrt(wrong / max(count, 1))) / clip_level


def relighting_error(
    estimates: Sequence[LightTransport],
    truths: Sequence[LightTransport],
    patterns: NDArray[Any],
    rows: NDArray[np.integer] | None = None,
) -> float:
    """Relative L2 error of linear, unclipped images, averaged over patterns (K, rows, cols).

    The light of several matrices adds up. Each shows another pattern, so that the images of a
    colour projector have all colours.
    """
    chosen = slice(None) if rows is None else rows

    def images(matrices: Sequence[LightTransport]) -> NDArray[np.float64]:
        each = (one.relight(np.roll(patterns, k, axis=0)) for k, one in enumerate(matrices))
        light = (image.reshape(len(patterns), -1)[:, chosen].astype(np.float64) for image in each)
        return np.sum(list(light), axis=0)

    for pair in zip(estimates, truths, strict=True):
        check_same_rig(*pair)
    expected = images(truths)
    norm = np.linalg.norm(expected, axis=1)
    errors = np.linalg.norm(images(estimates) - expected, axis=1)
    return float(np.mean(np.divide(errors, norm, out=np.zeros_like(errors), where=norm > 0)))


def unseen_patterns(shape: tuple[int, int]) -> dict[str, NDArray[np.float32]]:
    """Patterns that no estimate has seen: checker, disc, gradient, stripes, random blocks."""
    rows, cols = np.indices(shape)
    centre = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    # Blocks and stripes have cells of 4 projector pixels, checkers of twice as many.
    cells = [-(-side // 4) for side in shape]
    random = np.random.default_rng(0).random(cells) < 0.5
    patterns = {
        "checker": (rows // 8 + cols // 8) % 2,
        "disc": np.hypot(rows - centre[0], cols - centre[1]) < min(shape) / 3,
        "gradient": (rows / shape[0] + 2 * cols / shape[1]) / 3,
        "stripes": cols // 4 % 2,
        "blocks": np.kron(random, np.ones((4, 4)))[: shape[0], : shape[1]],
    }
    return {name: np.asarray(image, np.float32) for name, image in patterns.items()}


def row_maximum(transport: LightTransport) -> NDArray[np.float32]:
    """Strongest single response of each camera sample, (M,) float32."""
    return np.asarray(transport.sparse.max(axis=1).toarray(), np.float32).ravel()


def unclipped_rows(truth: LightTransport, exposure: float) -> NDArray[np.bool_]:
    """Rows whose single responses do not clip at this exposure, (M,) bool."""
    return row_maximum(truth) * exposure <= UNCLIPPED_RESPONSE


def diffuse_rows(matrix: csr_array, projector_shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Lit rows whose strongest 3 x 3 window of projector pixels holds less than half, (M,)."""
    down, right = (
        diags_array([1.0] * 3, offsets=(-1, 0, 1), shape=(n, n)) for n in projector_shape
    )
    windows = csr_array(kron(down, right), dtype=np.float32)
    result = np.zeros(matrix.shape[0], bool)
    # Each entry lies in nine windows, of 8 bytes each.
    for rows in _blocks(matrix.indptr, bytes_each=9 * 8):
        part = matrix[rows]
        strongest = (part @ windows).max(axis=1).toarray().ravel()
        result[rows] = strongest < 0.5 * part.sum(axis=1)
    return result


def check_same_rig(estimate: LightTransport, other: Any, origin: str = "truth") -> None:
    """Raise InputError unless a truth or a capture has the estimate's camera and projector."""
    for name in ("camera_shape", "projector_shape"):
        if getattr(estimate, name) != getattr(other, name):
            raise InputError(
                f"the estimate's {name.replace('_', ' ')} is {getattr(estimate, name)}, "
                f"the {origin}'s is {getattr(other, name)}",
                hint="both must be of one rig, with the same binning",
            )
