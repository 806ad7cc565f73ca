"""Linear samples, each with its own clip state, and their means over blocks of camera pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.reprs import ShortRepr


@dataclass(frozen=True, eq=False, repr=False)
class Samples(ShortRepr):
    """Linear camera samples of m rows under K patterns, every one with its own clip state.

    Parameters
    ----------
    values : (m, K) float32 or float64
        In units of the clip level at exposure 1; where clipped, a lower bound.
    clipped : (m, K) bool
        Whether the sample, or any camera pixel binned into it, is clipped.
    clip_level : (K,) or (m, K), dtype of the values
        The value at which each sample clips.
    weights : (K,) or (m, K) float, optional
        Weight of each sample in the data term, >= 0; 0 masks it, and frames of much lower
        exposure weigh less. None means 1.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> values = np.array([[0.2, 1.0]], np.float32)
    >>> lm.Samples(values, clipped=values >= 1, clip_level=np.ones(2, np.float32)).count
    1
    """

    values: NDArray[Any]
    clipped: NDArray[np.bool_]
    clip_level: NDArray[Any]
    weights: NDArray[Any] | None = None

    @property
    def count(self) -> int:
        """Number of rows m."""
        return len(self.values)

    def check(self, patterns: int) -> None:
        """Refuse samples that cannot belong to K patterns.

        Raises
        ------
        InputError
            On mismatched shapes, samples that are not finite, or weights out of range.
        """
        values = self.values
        if values.ndim != 2 or values.shape[1] != patterns:
            raise InputError(
                f"samples have shape {values.shape}, but there are {patterns} patterns",
                hint="give samples as (camera samples, patterns)",
            )
        if values.dtype not in (np.float32, np.float64):
            raise InputError(f"samples are {values.dtype}", hint="convert them to float32")
        if self.clipped.shape != values.shape or self.clipped.dtype != np.bool_:
            raise InputError(
                f"the clipped mask is {self.clipped.dtype} {self.clipped.shape}, "
                f"the samples are {values.shape}",
                hint="give one boolean for each sample",
            )
        for name, array in (("clip_level", self.clip_level), ("weights", self.weights)):
            if array is not None and array.shape not in (values.shape, values.shape[1:]):
                raise InputError(
                    f"{name} has shape {array.shape}, the samples {values.shape}",
                    hint=f"use {values.shape[1:]} (one a pattern) or {values.shape}",
                )
        if not np.isfinite(values).all():
            row, frame = np.argwhere(~np.isfinite(values))[0]
            raise InputError(
                f"the sample of camera row {row}, pattern {frame} is {values[row, frame]}",
                hint="mask it with weight 0 and set its value to 0",
            )
        if self.weights is not None and not (
            np.isfinite(self.weights).all() and (self.weights >= 0).all()
        ):
            raise InputError("a weight is negative or not finite", hint="use 0 to mask a sample")

    def rows(self, index: slice | NDArray[np.integer] | NDArray[np.bool_]) -> "Samples":
        """The samples of some rows; arrays with one value for each pattern are shared."""
        parts: tuple[Any, ...] = self.values, self.clipped, self.clip_level, self.weights
        own = (part is not None and part.ndim == 2 for part in parts)
        return Samples(*(part[index] if o else part for part, o in zip(parts, own, strict=True)))

    def frames(self, index: NDArray[np.integer]) -> "Samples":
        """The samples under some patterns, in contiguous arrays."""
        chosen: list[Any] = [
            part if part is None else np.ascontiguousarray(part[..., index])
            for part in (self.values, self.clipped, self.clip_level, self.weights)
        ]
        return Samples(*chosen)

    @classmethod
    def joined(cls, parts: "Sequence[Samples]") -> "Samples":
        """The rows of one or more parts below each other, each sample with its clip level."""
        weighted = any(part.weights is not None for part in parts)
        return cls(
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.clipped for part in parts]),
            np.concatenate([part.clip_levels_of_all() for part in parts]),
            np.concatenate([part.weights_of_all() for part in parts]) if weighted else None,
        )

    def weights_of_all(self) -> NDArray[Any]:
        """Weights of all samples, (m, K), in the dtype of the values."""
        if self.weights is None:
            return np.ones(self.values.shape, self.values.dtype)
        return np.broadcast_to(self.weights, self.values.shape).astype(self.values.dtype)

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Which samples have a weight above 0, (m, K)."""
        return self.weights_of_all() > 0

    def clip_levels_of_all(self) -> NDArray[Any]:
        """Clip levels of all samples, (m, K), in the dtype of the values."""
        return np.broadcast_to(self.clip_level, self.values.shape).astype(self.values.dtype)


def bin_samples(
    decoded: Samples,
    valid: NDArray[np.bool_] | None,
    shape: tuple[int, ...],
    block: tuple[int, int],
) -> Samples:
    """Means over blocks of camera pixels.

    A binned sample is clipped if any of its pixels is, and is then a lower bound like theirs.
    Pixels that are not `valid`, (M,), are left out; a block without any is 0 and not clipped.
    Blocks at the border may be smaller.

    `decoded` are samples (M, n) of whole frames of `shape`, (rows, cols[, channels]).
    """
    grid = (*shape[:2], shape[2] if len(shape) == 3 else 1)
    weight = np.ones(grid) if valid is None else valid.reshape(grid).astype(np.float64)
    counts = _block_sums(weight[..., None], block)
    share = 1 / np.maximum(counts, 1)

    def mean(samples: NDArray[Any]) -> NDArray[np.float32]:
        sums = _block_sums(samples.reshape(*grid, -1) * weight[..., None], block)
        return (sums * share).reshape(-1, sums.shape[-1]).astype(np.float32)

    any_clipped = mean(decoded.clipped.astype(np.float32)) > 0
    level = decoded.clip_level
    if level.ndim == 2:
        level = mean(np.broadcast_to(level, decoded.values.shape))
    return Samples(mean(decoded.values), any_clipped, level)


def _block_sums(values: NDArray[Any], block: tuple[int, int]) -> NDArray[np.float64]:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], block[0]), axis=0, dtype=float)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], block[1]), axis=1)
