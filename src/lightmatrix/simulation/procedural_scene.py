"""A light transport matrix of any size without a renderer, for scale tests and fuzzing.

Each camera pixel sees, through a depth map with edges, a footprint of 2 x 2 projector pixels
(direct light), a few dozen interreflections around it, and a faint low-rank background.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.sparse_rows import stacked


@dataclass(frozen=True)
class ProceduralScene:
    """Parameters of a made-up scene; rows depend on the seed and their place only.

    Parameters
    ----------
    camera_shape, projector_shape : (rows, cols)
    seed : int
    bounces : int
        Entries of sparse interreflection per row.
    indirect : float
        Energy of the interreflection as a share of the direct light.
    background : float
        Energy of the low-rank background as a share of the direct light; 0 leaves T sparse. It
        is held by 64 entries a row, a sample of the smooth whole.
    relief : float
        Largest disparity of the depth map, as a share of the projector's width.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> scene = lm.ProceduralScene((1024, 1024), (768, 1024))
    >>> rows, direct = scene.rows(524_288, 524_292)
    >>> rows.shape, len(direct) == rows.nnz
    ((4, 786432), True)
    """

    camera_shape: tuple[int, int]
    projector_shape: tuple[int, int]
    seed: int = 0
    bounces: int = 32
    indirect: float = 0.3
    background: float = 0.05
    relief: float = 0.08

    def __post_init__(self) -> None:
        for what, shape in (("camera", self.camera_shape), ("projector", self.projector_shape)):
            if min(shape) < 1:
                raise InputError(f"a {what} of {shape[0]} x {shape[1]}", hint="use at least 1 x 1")
        for name in ("bounces", "indirect", "background"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise InputError(f"{name} is {getattr(self, name)}", hint="use 0 or more")
        if not 0 <= self.relief <= 1:
            raise InputError(f"a relief of {self.relief}", hint="use a share from 0 to 1")

    @property
    def row_entries(self) -> int:
        """Entries that a row of T has at most."""
        return 4 + self.bounces * bool(self.indirect) + 64 * bool(self.background)

    def rows(self, start: int, stop: int) -> tuple[csr_array, NDArray[np.float32]]:
        """Rows start..stop of T, and the direct part of each stored entry."""
        index = np.arange(start, stop)
        rows, cols = self.projector_shape
        v, u, level = self._geometry(index)
        row, col, value, direct = [], [], [], []

        def add(dv: NDArray[np.float64], du: NDArray[np.float64], weight: NDArray[np.float64],
                straight: bool) -> None:  # fmt: skip
            inside = (dv >= 0) & (dv < rows) & (du >= 0) & (du < cols) & (weight > 0)
            which = np.broadcast_to(np.arange(len(index))[:, None], dv.shape)[inside]
            row.append(which)
            col.append(dv[inside].astype(np.int64) * cols + du[inside].astype(np.int64))
            value.append(weight[inside])
            direct.append(weight[inside] if straight else np.zeros(int(inside.sum())))

        # Direct light: bilinear weights of a point between projector pixels.
        corner_v, corner_u = np.floor(v), np.floor(u)
        part_v, part_u = v - corner_v, u - corner_u
        weights = np.stack(
            [
                (1 - part_v) * (1 - part_u), (1 - part_v) * part_u,
                part_v * (1 - part_u), part_v * part_u,
            ], 1,
        )  # fmt: skip
        at_v = corner_v[:, None] + [0, 0, 1, 1]
        at_u = corner_u[:, None] + [0, 1, 0, 1]
        add(at_v, at_u, level[:, None] * weights, straight=True)

        random = _hash_uniform(self.seed, index, 2 * self.bounces + 2 * 64)
        if self.bounces and self.indirect:
            # Interreflection falls off with distance: a heavy-tailed cloud around the footprint.
            angle = 2 * np.pi * random[:, : self.bounces]
            distance = 1.5 / np.maximum(random[:, self.bounces : 2 * self.bounces], 1e-3)
            share = self.indirect / self.bounces * level[:, None]
            add(
                np.floor(v[:, None] + distance * np.sin(angle)),
                np.floor(u[:, None] + distance * np.cos(angle)),
                np.broadcast_to(share, angle.shape),
                straight=False,
            )
        if self.background:
            places = random[:, 2 * self.bounces :]
            at_v, at_u = np.floor(places[:, :64] * rows), np.floor(places[:, 64:] * cols)
            glow = 1 + np.cos(np.pi * at_v / rows) * np.cos(np.pi * at_u / cols)
            add(at_v, at_u, self.background / 64 * level[:, None] * glow, straight=False)

        entries = np.concatenate(row), np.concatenate(col)
        shape = (len(index), rows * cols)
        whole = csr_array((np.concatenate(value).astype(np.float32), entries), shape=shape)
        straight = csr_array((np.concatenate(direct).astype(np.float32), entries), shape=shape)
        return whole, straight.data

    def blocks(self, size: int = 65_536) -> Iterator[tuple[int, csr_array, NDArray[np.float32]]]:
        """All rows in blocks: (first row, rows, direct part)."""
        total = self.camera_shape[0] * self.camera_shape[1]
        for start in range(0, total, size):
            yield start, *self.rows(start, min(start + size, total))

    def truth(self) -> Truth:
        """The whole matrix."""
        parts = list(self.blocks())
        matrix = stacked([part for _, part, _ in parts])
        direct = np.concatenate([straight for _, _, straight in parts])
        metadata = {"scene": "procedural", "seed": self.seed}
        return Truth(matrix, direct, self.camera_shape, self.projector_shape, metadata)

    def _geometry(
        self, index: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Projector coordinates (row, col) that each camera pixel sees, and its brightness."""
        rows, cols = self.camera_shape
        y, x = (index // cols + 0.5) / rows, (index % cols + 0.5) / cols
        random = np.random.default_rng(self.seed).random((12, 5))
        depth = 0.2 * (np.sin(3 * x + 5 * random[0, 0]) + np.cos(4 * y + 5 * random[0, 1]))
        albedo = np.full(len(index), 0.5)
        for cx, cy, radius, height, white in random:
            inside = np.maximum(abs(x - cx), abs(y - cy)) < 0.05 + 0.15 * radius
            depth = np.where(inside, height, depth)
            albedo = np.where(inside, 0.2 + 0.8 * white, albedo)
        projector_rows, projector_cols = self.projector_shape
        v = y * projector_rows - 0.5
        u = (x + self.relief * (depth - 0.5)) * projector_cols - 0.5
        return v, u, albedo


def _hash_uniform(seed: int, index: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Uniform numbers that depend on (seed, row, position) only: any block size gives the same."""
    with np.errstate(over="ignore"):
        state: NDArray[Any] = index.astype(np.uint64)[:, None] * np.uint64(count)
        state = state + np.arange(count, dtype=np.uint64)
        state += np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x632BE59BD9B4E019)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            state = (state ^ (state >> np.uint64(shift))) * np.uint64(factor)
        state ^= state >> np.uint64(31)
    return np.asarray(state >> np.uint64(11), np.float64) / 2.0**53
