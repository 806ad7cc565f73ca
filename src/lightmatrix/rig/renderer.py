"""Rendering the whole light transport matrix of a scene in one path-tracing pass."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.rig.llvm import load_mitsuba
from lightmatrix.rig.mitsuba_scene import mitsuba_scene
from lightmatrix.rig.scenes import scene as find_scene
from lightmatrix.rig.thinning import sparse_rows, stacked
from lightmatrix.rig.tracing import trace_block
from lightmatrix.rig.truth import Truth

Progress = Callable[[int, int], None]

# Dense sums of one block of camera pixels: the accumulator, twice (halves) and copies on the way.
_BLOCK_BYTES = 192 << 20
_COPIES = 6
# Paths in flight; each holds its ray, throughput and random state.
_WAVEFRONT = 1 << 21
_PATH_BYTES = 200
# The renderer itself and the scene.
_BASE_BYTES = 256 << 20
# An entry of the result: value, column and direct part, and one of them again while blocks join.
_ENTRY_BYTES = 16
# Rows rendered ahead to foresee the size of the result, and what it may come out larger by.
_PILOT_ROWS = 24
_PILOT_MARGIN = 1.3


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

    Camera pixels are rendered in blocks of rows whose dense sums take about 1 GiB with all copies,
    whatever the size; each block is thinned to sparse rows before the next begins. The result adds
    16 bytes an entry, foreseen from a few rows rendered ahead where it might not fit.

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
    total = size[0] * size[1]
    started = time.perf_counter()
    noise = _Noise()
    done = 0

    def trace(first: int, count: int, half: int) -> NDArray[np.float32]:
        """Mean over one half of the samples: (2, count, channels, N), direct light and global."""
        nonlocal done
        part = samples // 2 if half else samples - samples // 2
        chunk = max(1, _WAVEFRONT // count)
        sums = np.zeros((2, count, channels, pixels), np.float32)
        for number, start in enumerate(range(0, part, chunk)):
            paths = min(chunk, part - start)
            stream = np.random.SeedSequence((seed, first, half, number)).generate_state(1)[0]
            sums += trace_block(
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
        sums /= part
        return sums

    def rows(first: int, count: int) -> tuple[csr_array, NDArray[np.float32]]:
        halves = np.stack([trace(first, count, 0), trace(first, count, 1)])
        noise.add(halves)
        direct, scattered = _mean_of_halves(halves, samples)
        return sparse_rows(direct + scattered, direct, keep)

    most = min(pixels, samples * scene.max_depth)
    if foreseen_bytes(size, projector, channels, most) > _available_bytes():
        ahead = np.unique(np.linspace(0, total - 1, _PILOT_ROWS).astype(int))
        seen = np.mean([rows(int(first), 1)[0].nnz / channels for first in ahead])
        _check_memory(size, projector, channels, int(min(most, _PILOT_MARGIN * seen)))
        noise, done = _Noise(), 0
    block = _block_rows(pixels, channels)
    matrix, direct = stacked(
        [rows(first, min(block, total - first)) for first in range(0, total, block)]
    )
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
    direct *= np.float32(scale)
    return Truth(matrix, direct, camera_shape, projector, metadata)


def foreseen_bytes(
    size: tuple[int, int], projector: tuple[int, int], channels: int = 1, entries: int = 1
) -> int:
    """Memory a rendering needs: one dense block, the paths in flight, `entries` a sparse row."""
    pixels = projector[0] * projector[1]
    block = min(_block_rows(pixels, channels), size[0] * size[1])
    dense = 2 * 4 * block * channels * pixels * _COPIES
    result = size[0] * size[1] * channels * entries * _ENTRY_BYTES
    return _BASE_BYTES + dense + max(_WAVEFRONT, block) * _PATH_BYTES + result


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
    _check_memory(size, projector, 3 if colour else 1)


def _check_memory(
    size: tuple[int, int], projector: tuple[int, int], channels: int, entries: int = 1
) -> None:
    needed = foreseen_bytes(size, projector, channels, entries)
    available = _available_bytes()
    if needed > available:
        raise InputError(
            f"rendering {size[0]}x{size[1]} camera by {projector[0]}x{projector[1]} projector "
            f"pixels needs about {needed / 2**30:.1f} GiB, {available / 2**30:.1f} GiB are free",
            hint="use a smaller --size, or keep less of each row with --keep 0.99",
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


def _exposure_scale(matrix: csr_array) -> float:
    """The scale at which the 0.8 quantile over rows of the row maximum is the clip level, 1."""
    level = float(np.quantile(matrix.max(axis=1).toarray(), 0.8))
    return 1 / level if level > 0 else 1.0


class _Noise:
    """Relative noise of the mean of two halves, of the entries and of the white image."""

    def __init__(self) -> None:
        self._entries = np.zeros(2)
        self._white = np.zeros(2)

    def add(self, halves: NDArray[np.float32]) -> None:
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
