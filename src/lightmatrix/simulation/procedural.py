"""A scene whose light transport matrix is computed at any size without a renderer.

Each camera pixel sees, through a depth map with edges, a footprint of 2 x 2 projector pixels
(direct light), a few dozen interreflections around it, and a faint low-rank background. Benchmarks
of scale and tests use it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.defaults import PROCEDURAL
from lightmatrix.errors import InputError
from lightmatrix.ranges import as_float, check_seed, check_sides
from lightmatrix.resources.memory import check_memory
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.sparse_rows import stack_rows

# The faint background of a row has this many entries. Chosen by hand: more entries make it smoother
# and T larger.
_GLOW_ENTRIES = 64


@dataclass(frozen=True)
class ProceduralScene:
    """A procedural scene; its rows of T depend on their place and the seed only.

    Parameters
    ----------
    camera_shape, projector_shape : (rows, cols)
        Pixels of each.
    seed : int
        Seed of the depth map and the interreflections.
    bounces : int
        Entries of interreflection per row.
    indirect : float
        Light of the interreflection as a share of the direct light.
    background : float
        Light of the low-rank background as a share of the direct light; 0 leaves T sparse. Each
        row samples the smooth background at 64 pixels.
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
        for device, shape in (("camera", self.camera_shape), ("projector", self.projector_shape)):
            check_sides(f"a {device}", shape)
        check_seed(self.seed)
        for name in ("bounces", "indirect", "background"):
            if not 0 <= as_float(getattr(self, name)) < float("inf"):
                raise InputError(f"{name} is {getattr(self, name)}", hint="use 0 or more")
        if not 0 <= as_float(self.relief) <= 1:
            raise InputError(f"a relief of {self.relief}", hint="use a share from 0 to 1")

    def rows(self, start: int, stop: int) -> tuple[csr_array, NDArray[np.float32]]:
        """Rows start..stop of T, and the direct part of each stored entry."""
        index = np.arange(start, stop)
        rows, cols = self.projector_shape
        v, u, albedo = self._geometry(index)
        bounces = self.bounces
        random = _hash_uniform(self.seed, index, 2 * bounces + 2 * _GLOW_ENTRIES)
        # Each part: projector rows, projector columns and values, (rows of T, entries) each.
        # Direct light comes from the four pixels around the point that is seen, bilinearly.
        part_v, part_u = v - np.floor(v), u - np.floor(u)
        weights = [
            (1 - part_v) * (1 - part_u),
            (1 - part_v) * part_u,
            part_v * (1 - part_u),
            part_v * part_u,
        ]
        at_v, at_u = np.floor(v)[:, None] + [0, 0, 1, 1], np.floor(u)[:, None] + [0, 1, 0, 1]
        parts = [(at_v, at_u, albedo[:, None] * np.stack(weights, 1))]
        if bounces and self.indirect:
            # The interreflection is a heavy-tailed cloud around the footprint.
            angle = 2 * np.pi * random[:, :bounces]
            distance = 1.5 / np.maximum(random[:, bounces : 2 * bounces], 1e-3)
            at_v = np.floor(v[:, None] + distance * np.sin(angle))
            at_u = np.floor(u[:, None] + distance * np.cos(angle))
            share = self.indirect / bounces * albedo[:, None]
            parts.append((at_v, at_u, np.broadcast_to(share, angle.shape)))
        if self.background:
            places = random[:, 2 * bounces :]
            at_v = np.floor(places[:, :_GLOW_ENTRIES] * rows)
            at_u = np.floor(places[:, _GLOW_ENTRIES:] * cols)
            glow = 1 + np.cos(np.pi * at_v / rows) * np.cos(np.pi * at_u / cols)
            parts.append((at_v, at_u, self.background / _GLOW_ENTRIES * albedo[:, None] * glow))

        row, col, value, direct = [], [], [], []
        for number, (at_v, at_u, values) in enumerate(parts):
            inside = (at_v >= 0) & (at_v < rows) & (at_u >= 0) & (at_u < cols) & (values > 0)
            row.append(np.broadcast_to(np.arange(len(index))[:, None], at_v.shape)[inside])
            col.append(at_v[inside].astype(np.int64) * cols + at_u[inside].astype(np.int64))
            value.append(values[inside])
            direct.append(values[inside] if number == 0 else np.zeros(int(inside.sum())))
        where = np.concatenate(row), np.concatenate(col)
        shape = (len(index), rows * cols)
        whole = csr_array((np.concatenate(value).astype(np.float32), where), shape=shape)
        straight = csr_array((np.concatenate(direct).astype(np.float32), where), shape=shape)
        return whole, straight.data

    def blocks(self, size: int = 65_536) -> Iterator[tuple[int, csr_array, NDArray[np.float32]]]:
        """All of T in blocks: first row, rows, direct part."""
        total = self.camera_shape[0] * self.camera_shape[1]
        for start in range(0, total, size):
            yield start, *self.rows(start, min(start + size, total))

    def truth(self) -> Truth:
        """The whole matrix; an InputError says that it does not fit into memory."""
        entries = 4 + self.bounces * bool(self.indirect) + _GLOW_ENTRIES * bool(self.background)
        # Column, value and direct part, 4 bytes each, exist twice while blocks are joined.
        needed = 24 * math.prod(self.camera_shape) * entries
        hint = "make the camera smaller, or take its rows in parts: `rows` and `blocks`"
        check_memory("T of this scene", needed, hint)
        parts = list(self.blocks())
        matrix = stack_rows([part for _, part, _ in parts])
        direct = np.concatenate([straight for _, _, straight in parts])
        metadata = {"scene": PROCEDURAL, "seed": self.seed}
        return Truth(matrix, direct, self.camera_shape, self.projector_shape, metadata)

    def _geometry(
        self, index: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Projector row and column (fractional) that each camera pixel sees, and its albedo."""
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
    """Uniform numbers (rows, count) that depend on seed, row and position but not on the block."""
    with np.errstate(over="ignore"):
        state: NDArray[Any] = index.astype(np.uint64)[:, None] * np.uint64(count)
        state = state + np.arange(count, dtype=np.uint64)
        state += np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x632BE59BD9B4E019)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            state = (state ^ (state >> np.uint64(shift))) * np.uint64(factor)
        state ^= state >> np.uint64(31)
    return np.asarray(state >> np.uint64(11), np.float64) / 2.0**53
