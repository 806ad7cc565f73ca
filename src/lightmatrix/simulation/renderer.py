"""Rendering the whole light transport matrix of a scene in one path-tracing pass."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_seed
from lightmatrix.resources.memory import available_bytes
from lightmatrix.simulation.llvm import load_mitsuba
from lightmatrix.simulation.mitsuba_scene import mitsuba_scene
from lightmatrix.simulation.render_memory import WAVEFRONT, check_memory, foreseen_bytes
from lightmatrix.simulation.scenes import scene as find_scene
from lightmatrix.simulation.thinning import stacked, thinned_in_steps
from lightmatrix.simulation.tracing import trace_block
from lightmatrix.simulation.truth import Truth

Progress = Callable[[int, int], None]

# Places of one block of camera pixels are numbered in 32 bits.
_MAX_PLACES = 1 << 32
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

    Camera pixels are rendered in blocks that share a million paths; each block is summed to sparse
    rows and thinned before the next begins, which takes about 1.2 GiB, whatever the size. The
    result adds 16 bytes an entry, foreseen from a few rows rendered ahead where it might not fit.

    Parameters
    ----------
    name : str
        A scene of `lightmatrix.simulation.scenes`.
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

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.render("wall", (32, 32), samples=64)  # doctest: +SKIP
    """
    scene = find_scene(name)
    projector = projector_size or size
    _check(size, projector, samples, keep, colour, seed)
    mi, fast = load_mitsuba(scalar=scalar)
    loaded = mitsuba_scene(mi, scene, size, projector)
    channels = 3 if colour else 1
    pixels = projector[0] * projector[1]
    total = size[0] * size[1]
    started = time.perf_counter()
    noise = _Noise()
    done = 0

    def trace(first: int, count: int, half: int) -> csr_array:
        """Sums over one half of the samples, (count * channels, N): all light + i direct light."""
        nonlocal done
        part = samples // 2 if half else samples - samples // 2
        chunk = max(1, WAVEFRONT // count)
        sums = csr_array((count * channels, pixels), dtype=np.complex64)
        for number, start in enumerate(range(0, part, chunk)):
            paths = min(chunk, part - start)
            stream = np.random.SeedSequence((seed, first, half, number)).generate_state(1)[0]
            traced = trace_block(
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
            sums = traced if start == 0 else csr_array(sums + traced)
            done += count * paths
            if progress is not None:
                progress(done, total * samples)
        return sums

    def rows(first: int, count: int) -> tuple[csr_array, NDArray[np.float32]]:
        halves = trace(first, count, 0), trace(first, count, 1)
        noise.add(*halves, samples)
        both = csr_array((halves[0] + halves[1]) / np.float32(samples))
        whole = csr_array((both.data.real.copy(), both.indices, both.indptr), shape=both.shape)
        return whole, both.data.imag.copy()

    block = min(total, _block_rows(samples, pixels, channels))
    most = min(pixels, samples * scene.max_depth)
    if foreseen_bytes(size, channels, most) > available_bytes():
        ahead = np.unique(np.linspace(0, total - 1, _PILOT_ROWS).astype(int))
        seen = [rows(int(first), 1) for first in ahead]

        def entries(share: float) -> int:
            mean = np.mean([thinned_in_steps(*part, share)[0].nnz / channels for part in seen])
            return int(min(most, _PILOT_MARGIN * mean))

        check_memory(size, projector, channels, entries(keep), entries, keep)
        noise, done = _Noise(), 0
    matrix, direct = stacked(
        [
            thinned_in_steps(*rows(first, min(block, total - first)), keep)
            for first in range(0, total, block)
        ]
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


def _check(
    size: tuple[int, int],
    projector: tuple[int, int],
    samples: int,
    keep: float,
    colour: bool,
    seed: int,
) -> None:
    for what, shape in (("camera", size), ("projector", projector)):
        if min(shape) < 1:
            raise InputError(f"a {what} of {shape[0]} x {shape[1]} pixels", hint="use at least 1x1")
    check_seed(seed)
    if samples < 2:
        raise InputError(f"{samples} samples a pixel", hint="use at least 2, better 1024 or more")
    if not 0 < keep <= 1:
        raise InputError(f"keep is {keep}", hint="use a share of the energy such as 0.999")
    check_memory(size, projector, 3 if colour else 1)


def _block_rows(samples: int, pixels: int, channels: int) -> int:
    """Camera pixels that are rendered together: half their samples are one wavefront."""
    half = samples - samples // 2
    return max(1, min(WAVEFRONT // half, _MAX_PLACES // (channels * pixels)))


def _exposure_scale(matrix: csr_array) -> float:
    """The scale at which the 0.8 quantile over rows of the row maximum is the clip level, 1."""
    level = float(np.quantile(matrix.max(axis=1).toarray(), 0.8))
    return 1 / level if level > 0 else 1.0


class _Noise:
    """Relative noise of the mean of two halves, of the entries and of the white image."""

    def __init__(self) -> None:
        self._entries = np.zeros(2)
        self._white = np.zeros(2)

    def add(self, first: csr_array, second: csr_array, samples: int) -> None:
        """Count the sums (rows, N) over the two halves of the samples."""
        a = first.real / np.float32(samples - samples // 2)
        b = second.real / np.float32(samples // 2)
        for half_sum, half_difference, energy in (
            ((a + b).data, (a - b).data, self._entries),
            (a.sum(axis=1) + b.sum(axis=1), a.sum(axis=1) - b.sum(axis=1), self._white),
        ):
            energy += [
                np.square(half_difference, dtype=np.float64).sum() / 4,
                np.square(half_sum, dtype=np.float64).sum() / 4,
            ]

    @property
    def entries(self) -> float:
        return float(np.sqrt(self._entries[0] / max(self._entries[1], 1e-30)))

    @property
    def white(self) -> float:
        return float(np.sqrt(self._white[0] / max(self._white[1], 1e-30)))
