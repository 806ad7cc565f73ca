"""Rendering the whole light transport matrix of a scene in one path-tracing pass."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError
from lightmatrix.rig.llvm import load_mitsuba
from lightmatrix.rig.mitsuba_scene import mitsuba_scene
from lightmatrix.rig.scenes import scene as find_scene
from lightmatrix.rig.tracing import trace_block
from lightmatrix.rig.truth import Truth

Progress = Callable[[int, int], None]

# Dense sums of one block of camera pixels: the accumulator, twice (halves) and copies on the way.
_BLOCK_BYTES = 192 << 20
_COPIES = 5
# Paths in flight; each holds its ray, throughput and random state.
_WAVEFRONT = 1 << 21
_PATH_BYTES = 200
# Entries that a row of a rendered scene keeps at 99.9 % of its energy, seen at most so far.
_ENTRIES_PER_ROW = 2500


def render(
    name: str,
    size: tuple[int, int],
    *,
    projector_size: tuple[int, int] | None = None,
    samples: int = 4096,
    seed: int = 0,
    keep: float = 0.999,
    colour: bool = False,
    scalar: bool = False,
    progress: Progress | None = None,
) -> Truth:
    """Render the light transport matrix of a scene, direct and global light kept apart.

    Parameters
    ----------
    name : str
        A scene of `lightmatrix.rig.scenes`.
    size : (rows, cols)
        Camera size, and the projector's unless `projector_size` is given.
    samples : int
        Paths per camera pixel. Too few make rows look sparser than they are.
    seed : int
        Seed of the paths.
    keep : float
        Share of each row's energy to keep, in (0, 1]; the smallest entries are dropped and the
        remaining global ones scaled so that every row keeps its sum.
    colour : bool
        Three camera samples a pixel (red, green, blue) instead of one.
    scalar : bool
        Use the scalar renderer even where LLVM is found.
    progress : callable, optional
        Called with (done, total) paths.

    Returns
    -------
    Truth
        Scaled so that at exposure 1 a fifth of the camera samples clip under their strongest
        single projector pixel. `metadata` holds the noise estimates from two independent halves.

    Raises
    ------
    InputError
        On unknown scenes, sizes below 1 or more memory than there is.
    MissingExtraError
        If Mitsuba is not installed.
    """
    scene = find_scene(name)
    projector = projector_size or size
    _check(size, projector, samples, keep, colour)
    mi, fast = load_mitsuba(scalar=scalar)
    loaded = mitsuba_scene(mi, scene, size, projector)
    channels = 3 if colour else 1
    pixels = projector[0] * projector[1]
    block = _block_rows(pixels, channels)
    total = size[0] * size[1]
    started = time.perf_counter()
    matrices, direct, noise = [], [], _Noise()
    done = 0
    for first in range(0, total, block):
        count = min(block, total - first)
        halves = np.zeros((2, 2, count, channels, pixels), np.float32)
        for half in range(2):
            part = samples // 2 if half else samples - samples // 2
            chunk = max(1, _WAVEFRONT // count)
            for number, start in enumerate(range(0, part, chunk)):
                paths = min(chunk, part - start)
                stream = np.random.SeedSequence((seed, first, half, number)).generate_state(1)[0]
                halves[half] += trace_block(
                    mi,
                    loaded,
                    first,
                    count,
                    paths,
                    int(stream),
                    camera_shape=size,
                    projector_shape=projector,
                    max_depth=scene.max_depth,
                    colour=colour,
                    fast=fast,
                )
                done += count * paths
                if progress is not None:
                    progress(done, total * samples)
            halves[half] /= max(part, 1)
        noise.add(halves, samples)
        whole, straight = _sparse_rows(_mean_of_halves(halves, samples), keep)
        matrices.append(whole)
        direct.append(straight)
    matrix = csr_array(vstack(matrices, format="csr"))
    scale = _exposure_scale(matrix)
    matrix.data *= scale
    camera_shape = (*size, 3) if colour else size
    metadata: dict[str, Any] = {
        "scene": name,
        "scene_version": scene.version,
        "samples": samples,
        "seed": seed,
        "keep": keep,
        "max_depth": scene.max_depth,
        "scale": float(scale),
        "noise_entries": noise.entries,
        "noise_white": noise.white,
        "renderer": f"mitsuba {mi.__version__} {mi.variant()}",
        "seconds": round(time.perf_counter() - started, 1),
    }
    direct_data = np.concatenate(direct) * scale
    return Truth(matrix, direct_data.astype(np.float32), camera_shape, projector, metadata)


def foreseen_bytes(size: tuple[int, int], projector: tuple[int, int], channels: int = 1) -> int:
    """Memory a rendering needs at most: one dense block, the paths in flight, the sparse result."""
    pixels = projector[0] * projector[1]
    block = min(_block_rows(pixels, channels), size[0] * size[1])
    dense = 2 * 4 * block * channels * pixels * _COPIES
    # Values, columns and direct parts; vstack holds the blocks and the whole at once.
    entries = size[0] * size[1] * channels * min(pixels, _ENTRIES_PER_ROW)
    return dense + max(_WAVEFRONT, block) * _PATH_BYTES + 2 * 12 * entries


def _check(
    size: tuple[int, int], projector: tuple[int, int], samples: int, keep: float, colour: bool
) -> None:
    for what, shape in (("camera", size), ("projector", projector)):
        if min(shape) < 1:
            raise InputError(f"a {what} of {shape[0]} x {shape[1]} pixels", hint="use at least 1x1")
    if samples < 2:
        raise InputError(f"{samples} samples a pixel", hint="use at least 2, better 1024 or more")
    if not 0 < keep <= 1:
        raise InputError(f"keep is {keep}", hint="use a share of the energy such as 0.999")
    needed = foreseen_bytes(size, projector, 3 if colour else 1)
    available = _available_bytes()
    if needed > available:
        raise InputError(
            f"rendering {size[0]}x{size[1]} camera by {projector[0]}x{projector[1]} projector "
            f"pixels needs about {needed / 2**30:.1f} GiB, {available / 2**30:.1f} GiB are free",
            hint="use a smaller --size",
        )


def _available_bytes() -> int:
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _block_rows(pixels: int, channels: int) -> int:
    return max(1, _BLOCK_BYTES // (2 * 4 * channels * pixels))


def _mean_of_halves(halves: NDArray[np.float32], samples: int) -> NDArray[np.float32]:
    share = np.float32((samples - samples // 2) / samples)
    mean = share * halves[0] + (1 - share) * halves[1]
    return mean.reshape(2, -1, halves.shape[-1])


def _sparse_rows(sums: NDArray[np.float32], keep: float) -> tuple[csr_array, NDArray[np.float32]]:
    """Rows (direct, global) as sparse rows of their sum, without the smallest entries."""
    whole = sums[0] + sums[1]
    if keep < 1:
        ordered = np.sort(whole, axis=1)
        dropped = np.cumsum(ordered, axis=1, dtype=np.float64)
        energy = dropped[:, -1:]
        first_kept = (dropped <= (1 - keep) * energy).sum(axis=1)
        threshold = ordered[np.arange(len(whole)), np.minimum(first_kept, whole.shape[1] - 1)]
        kept = (whole >= threshold[:, None]) & (whole > 0)
    else:
        kept = whole > 0
    row, col = np.nonzero(kept)
    straight, values = sums[0][row, col], whole[row, col]
    # What was dropped goes back to the global entries that stay, so that sums are exact.
    lost = whole.sum(axis=1, dtype=np.float64) - np.bincount(row, values, len(whole))
    scattered = np.bincount(row, values - straight, len(whole))
    gain = 1 + np.divide(lost, scattered, out=np.zeros_like(lost), where=scattered > 0)
    values = straight + (values - straight) * gain[row].astype(np.float32)
    indptr = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    matrix = csr_array((values, col.astype(np.int32), indptr.astype(np.int64)), shape=whole.shape)
    return matrix, straight


def _exposure_scale(matrix: csr_array) -> float:
    """The scale at which the 0.8 quantile over rows of the row maximum is the clip level, 1."""
    level = float(np.quantile(matrix.max(axis=1).toarray(), 0.8))
    return 1 / level if level > 0 else 1.0


class _Noise:
    """Relative noise of the mean of two halves, of the entries and of the white image."""

    def __init__(self) -> None:
        self._entries = np.zeros(2)
        self._white = np.zeros(2)

    def add(self, halves: NDArray[np.float32], samples: int) -> None:
        a, b = halves.sum(axis=1, dtype=np.float32)
        self._entries += [np.square(a - b).sum() / 4, np.square(a + b).sum() / 4]
        white = (a.sum(axis=-1), b.sum(axis=-1))
        self._white += [
            np.square(white[0] - white[1]).sum() / 4,
            np.square(white[0] + white[1]).sum() / 4,
        ]

    @property
    def entries(self) -> float:
        return float(np.sqrt(self._entries[0] / max(self._entries[1], 1e-30)))

    @property
    def white(self) -> float:
        return float(np.sqrt(self._white[0] / max(self._white[1], 1e-30)))
