"""Patterns that determine T: each camera sample of all of them follows from T, and T from these."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import COHERENT_UP_TO

Floats = NDArray[np.float64]
# A `PatternSet`, which is not imported, since it imports this file.
Patterns = Any


@dataclass(frozen=True, eq=False)
class Inverse:
    """Rows of T, (m, N), from samples (m, K), and the noise of their pixels, (N,).

    `gains` are in units of a sample's noise. Pixels that no pattern lights have none, and no light.
    """

    solve: Callable[[NDArray[Any]], Floats]
    gains: Floats
    # Whether each pattern lights one pixel at most, so that a sample is an entry of T.
    lone: bool = False


def inverse_of(patterns: Patterns) -> Inverse | None:
    """The inverse of patterns that light one pixel each, and of as many as pixels or more.

    None if least squares amplify the noise by far more than orthogonal patterns do.
    """
    if lights_one(patterns):
        lit = patterns.squares > 0
        scale = np.where(lit, 1 / np.where(lit, patterns.squares, 1), 0)
        return Inverse(lambda y: patterns.adjoint(y) * scale, np.sqrt(scale), lone=True)
    if patterns.transform is not None and patterns.count == patterns.transform[0]:
        return _hadamard(patterns, *patterns.transform)
    # Beyond these sizes the inverse takes minutes and gigabytes.
    if not patterns.pixels <= patterns.count <= (1 << 25) // patterns.pixels:
        return None
    matrix = patterns.dense().astype(np.float64)
    gram = matrix.T @ matrix
    try:
        inverted = np.linalg.inv(gram)
    except np.linalg.LinAlgError:
        return None
    gains = np.sqrt(np.maximum(np.diag(inverted), 0))
    # Orthogonal pixels have a gain of 1 / |column|, Hadamard patterns of 1.414 times that (but for
    # one pixel), and random ones of twice that from twice as many patterns as pixels on. Sets that
    # are not as regular need as many as row by row estimates are for: others know sparsity.
    relative = np.sort(gains * np.sqrt(np.diag(gram)))
    regular = len(gains) > 2 and np.ptp(relative[:-1]) < 1e-3
    if not (relative[-2:].min() <= 2 and (regular or patterns.count > COHERENT_UP_TO)):
        return None
    if not np.allclose(gram @ inverted, np.eye(len(gram)), atol=1e-6):
        return None
    return Inverse(lambda y: np.asarray(y @ matrix @ inverted), gains)


def lights_one(patterns: Patterns) -> bool:
    """Whether each pattern lights one pixel at most."""
    if patterns.sums.max() > 1 + 1e-6:
        return False
    return all(bool((np.count_nonzero(part, axis=1) <= 1).all()) for _, part in patterns.chunks())


def _hadamard(
    patterns: Patterns, size: int, selected: NDArray[np.int64], position: NDArray[np.int64]
) -> Inverse:
    """The fast inverse of a complete set, one of which is white; see `PatternSet.transform`."""
    white = int(np.flatnonzero(selected == 0)[0])

    def solve(samples: NDArray[Any]) -> Floats:
        signed = 2.0 * samples - samples[:, [white]]
        back = 2 * patterns.adjoint(signed) - signed.sum(axis=1, keepdims=True)
        return np.asarray(back / size)

    # The pixel that all patterns light is known from the difference of sums only.
    gains = np.where(position == 0, 1.0, 2 / np.sqrt(size))
    return Inverse(solve, gains)
