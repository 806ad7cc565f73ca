"""`lm.render`: the whole light transport matrix of a scene by one pass of path tracing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_seed
from lightmatrix.resources.memory import available_bytes
from lightmatrix.simulation.llvm import load_mitsuba
from lightmatrix.simulation.mitsuba_scene import mitsuba_scene
from lightmatrix.simulation.render_memory import WAVEFRONT, check_memory, needed_bytes
from lightmatrix.simulation.scenes import scene as find_scene
from lightmatrix.simulation.surface import view_geometry
from lightmatrix.simulation.thinning import joined, thinned_in_steps
from lightmatrix.simulation.tracing import LoadedScene, trace_block
from lightmatrix.simulation.truth import Truth

Progress = Callable[[int, int], None]

# The places of one block, camera samples times projector pixels, are numbered in 32 bits.
_MOST_PLACES = 1 << 32
# Where the result might not fit into memory, its size is estimated from this many camera pixels
# that are rendered first, and from their mean number of entries times this margin. Chosen by hand:
# the pilot pixels cost little beside a rendering of that size.
_PILOT_PIXELS = 24
_PILOT_MARGIN = 1.3
# The scale of T makes a fifth of the rows clip under their strongest single pixel at exposure 1.
_SCALE_QUANTILE = 0.8


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

    Camera pixels are rendered in blocks that share a million paths. Each block is summed to sparse
    rows and thinned before the next begins, which takes about 1.2 GiB at any size. The result adds
    16 bytes per entry. Where that might not fit, a few camera pixels are rendered first to
    estimate it.

    Parameters
    ----------
    name : str
        A scene that `scenes` lists.
    size : (rows, cols)
        Camera size, and the projector's unless `projector_size` is given.
    projector_size : (rows, cols), optional
        Projector size.
    samples : int
        Paths per camera pixel. Too few make rows look sparser than they are.
    seed : int
        Seed of the paths.
    keep : float
        Share of each row's light that its largest entries must hold, in (0, 1]. The light of the
        smaller entries is gathered into fewer ones, so every row keeps its sum.
    colour : bool
        Whether a camera pixel has three samples (red, green, blue) instead of one.
    scalar : bool
        Whether to use the scalar renderer even where LLVM is installed.
    progress : callable, optional
        Called with (done, total) paths.

    Returns
    -------
    Truth
        Scaled so that at exposure 1 a fifth of the camera samples clip under their strongest
        single projector pixel. `metadata` holds the noise, estimated from two independent halves.

    Raises
    ------
    InputError
        On unknown scenes, sizes below 1, or more memory than there is.
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
    started = time.perf_counter()
    mi, fast = load_mitsuba(scalar=scalar)
    loaded = LoadedScene(
        mi,
        mitsuba_scene(mi, scene, size, projector),
        size,
        projector,
        scene.max_depth,
        colour,
        fast,
    )
    if needed_bytes(size, loaded.channels, _most_entries(loaded, samples)) > available_bytes():
        _check_by_pilot(loaded, samples, seed, keep)
    rendering = _Rendering(loaded, samples, seed, progress)
    matrix, direct = rendering.matrix(keep)
    scale = _exposure_scale(matrix)
    matrix.data *= scale
    direct *= np.float32(scale)
    metadata = {
        "scene": name,
        "scene_version": scene.version,
        "samples": samples,
        "seed": seed,
        "keep": keep,
        "max_depth": scene.max_depth,
        "scale": float(scale),
        "noise_entries": rendering.noise.entries,
        "noise_white": rendering.noise.white,
        "renderer": f"mitsuba {mi.__version__} {mi.variant()}",
        "seconds": round(time.perf_counter() - started, 1),
    }
    geometry = view_geometry(scene, size, projector)
    camera_shape = (*size, 3) if colour else size
    return Truth(matrix, direct, camera_shape, projector, metadata, geometry)


def _check(
    size: tuple[int, int],
    projector: tuple[int, int],
    samples: int,
    keep: float,
    colour: bool,
    seed: int,
) -> None:
    for device, shape in (("camera", size), ("projector", projector)):
        if min(shape) < 1:
            raise InputError(
                f"a {device} of {shape[0]} x {shape[1]} pixels", hint="use at least 1x1"
            )
    check_seed(seed)
    if samples < 2:
        raise InputError(f"{samples} samples a pixel", hint="use at least 2, better 1024 or more")
    if not 0 < keep <= 1:
        raise InputError(f"keep is {keep}", hint="use a share of the energy such as 0.999")
    check_memory(size, projector, 3 if colour else 1)


def _check_by_pilot(loaded: LoadedScene, samples: int, seed: int, keep: float) -> None:
    """Raise InputError if the matrix will not fit, judging by a few camera pixels."""
    rows, cols = loaded.camera_shape
    pixels = np.unique(np.linspace(0, rows * cols - 1, _PILOT_PIXELS).astype(int))
    pilot = _Rendering(loaded, samples, seed, None)
    rendered = [pilot.rows(int(pixel), 1) for pixel in pixels]

    def entries(share: float) -> int:
        """Entries of a row if it keeps this share of its light."""
        counts = [thinned_in_steps(*part, share)[0].nnz / loaded.channels for part in rendered]
        return int(min(_most_entries(loaded, samples), _PILOT_MARGIN * np.mean(counts)))

    check_memory(
        loaded.camera_shape, loaded.projector_shape, loaded.channels, entries(keep), entries, keep
    )


def _most_entries(loaded: LoadedScene, samples: int) -> int:
    """The most entries that a row can have."""
    return min(loaded.pixels, samples * loaded.max_depth)


@dataclass
class _Rendering:
    """One rendering: traces blocks of camera pixels, and keeps count of paths and noise."""

    loaded: LoadedScene
    samples: int
    seed: int
    progress: Progress | None
    noise: _Noise = field(default_factory=lambda: _Noise())
    paths_done: int = 0

    def matrix(self, keep: float) -> tuple[csr_array, NDArray[np.float32]]:
        """All rows, thinned, and the direct part of each entry."""
        rows, cols = self.loaded.camera_shape
        total, half = rows * cols, self.samples - self.samples // 2
        # Half the samples of a block of camera pixels make up one wavefront.
        most = _MOST_PLACES // (self.loaded.channels * self.loaded.pixels)
        block = min(total, max(1, min(WAVEFRONT // half, most)))
        return joined(
            [
                thinned_in_steps(*self.rows(first, min(block, total - first)), keep)
                for first in range(0, total, block)
            ]
        )

    def rows(self, first: int, count: int) -> tuple[csr_array, NDArray[np.float32]]:
        """The rows of some camera pixels, and the direct part of each entry."""
        halves = self._sums(first, count, 0), self._sums(first, count, 1)
        self.noise.add(*halves, self.samples)
        both = csr_array((halves[0] + halves[1]) / np.float32(self.samples))
        whole = csr_array((both.data.real.copy(), both.indices, both.indptr), shape=both.shape)
        return whole, both.data.imag.copy()

    def _sums(self, first: int, count: int, half: int) -> csr_array:
        """Sums over one half of the samples, (count * channels, N): all light + i direct light."""
        samples = self.samples // 2 if half else self.samples - self.samples // 2
        rows, cols = self.loaded.camera_shape
        step = max(1, WAVEFRONT // count)
        shape = (count * self.loaded.channels, self.loaded.pixels)
        sums = csr_array(shape, dtype=np.complex64)
        for number, start in enumerate(range(0, samples, step)):
            paths = min(step, samples - start)
            key = (self.seed, first, half, number)
            stream = int(np.random.SeedSequence(key).generate_state(1)[0])
            traced = trace_block(self.loaded, first, count, paths, stream)
            sums = traced if start == 0 else csr_array(sums + traced)
            self.paths_done += count * paths
            if self.progress is not None:
                self.progress(self.paths_done, rows * cols * self.samples)
        return sums


def _exposure_scale(matrix: csr_array) -> float:
    """The factor that puts the 0.8 quantile over rows of the row maximum at the clip level, 1."""
    level = float(np.quantile(matrix.max(axis=1).toarray(), _SCALE_QUANTILE))
    return 1 / level if level > 0 else 1.0


class _Noise:
    """Relative noise of the mean of two halves: of the entries, and of the white image."""

    def __init__(self) -> None:
        # Energies of half the difference and of half the sum.
        self._entries = np.zeros(2)
        self._white = np.zeros(2)

    def add(self, first: csr_array, second: csr_array, samples: int) -> None:
        """Add the sums (rows, N) over the two halves of the samples."""
        a = first.real / np.float32(samples - samples // 2)
        b = second.real / np.float32(samples // 2)
        white_a, white_b = a.sum(axis=1), b.sum(axis=1)
        for total, difference, energies in (
            ((a + b).data, (a - b).data, self._entries),
            (white_a + white_b, white_a - white_b, self._white),
        ):
            energies += [np.square(v, dtype=np.float64).sum() / 4 for v in (difference, total)]

    @property
    def entries(self) -> float:
        return float(np.sqrt(self._entries[0] / max(self._entries[1], 1e-30)))

    @property
    def white(self) -> float:
        return float(np.sqrt(self._white[0] / max(self._white[1], 1e-30)))
