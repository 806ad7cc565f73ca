"""`singular_values`: how low the rank of the light is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_finite, check_seed
from lightmatrix.transport.operator import TransportOperator

# Random directions beyond the singular values that are asked for, and how often T'T is applied to
# them. Direct light has a flat spectrum, for which Halko et al. advise several rounds: the 20
# largest values of metal then agree with a dense SVD to 1 % (tests/transport/test_operator.py).
_MORE_DIRECTIONS = 20
_ROUNDS = 6


def singular_values(
    transport: TransportOperator, count: int = 20, *, seed: int = 0
) -> NDArray[np.float64]:
    """The largest singular values of T, by a randomised SVD.

    Each value is the strength of one pair of a pattern and the image that it makes. Values that
    fall quickly mean that few numbers describe the light (diffuse light), a flat spectrum that each
    projector pixel lights its own place (direct light). T is only multiplied, never made dense.

    Parameters
    ----------
    transport : LightTransport or StoredTransport
        T. A store is read block by block, 14 times.
    count : int
        Number of values, from 1 to min(M, N).
    seed : int
        Seed of the random directions.

    Returns
    -------
    (count,) float64
        Descending, in camera full scale at exposure 1. Each is at most the true one.

    Raises
    ------
    InputError
        If T does not have so many, or has entries that are not finite.

    References
    ----------
    Halko, Martinsson & Tropp 2011, "Finding structure with randomness", algorithms 4.4 and 5.1.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> values = lm.singular_values(lm.truth("metal").transport(), 3)
    >>> bool(values[0] > values[1] > values[2])
    True
    """
    check_seed(seed)
    rows, pixels = transport.shape
    most = min(rows, pixels)
    if not hasattr(count, "__index__") or not 1 <= int(count) <= most:
        raise InputError(
            f"{count} singular values of a matrix of {rows} x {pixels}", hint=f"ask for 1 to {most}"
        )
    directions = min(int(count) + _MORE_DIRECTIONS, most)
    random = np.random.default_rng(seed)
    basis = random.standard_normal((pixels, directions))
    for _ in range(_ROUNDS):
        image, _ = np.linalg.qr(transport @ basis)
        basis, _ = np.linalg.qr(transport.T @ image)
    image = transport @ basis
    check_finite("entries of T", image)
    values = np.linalg.svd(image, compute_uv=False)
    return np.asarray(values[: int(count)], np.float64)
