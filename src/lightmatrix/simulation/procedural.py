"""A scene whose light transport matrix is computed at any size without a renderer.

Each camera pixel sees, through a depth map with edges, a footprint of 2 x 2 projector pixels
(direct light), a few dozen interreflections around it, and a faint low-rank background. Benchmarks
of scale and tests use it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence, parse_exposures
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.packing import write_packed
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import TRUTH
from lightmatrix.defaults import PROCEDURAL, USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CAPTURE, PACKED_CAPTURE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import as_float, check_seed, check_sides
from lightmatrix.resources.disk import scratch_array
from lightmatrix.resources.memory import check_memory
from lightmatrix.simulation.irradiance import irradiance
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

    @property
    def row_entries(self) -> int:
        """The most entries that a row of T has."""
        return 4 + self.bounces * bool(self.indirect) + _GLOW_ENTRIES * bool(self.background)

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
        """The whole matrix."""
        parts = list(self.blocks())
        matrix = stack_rows([part for _, part, _ in parts])
        direct = np.concatenate([straight for _, _, straight in parts])
        metadata = {"scene": "procedural", "seed": self.seed}
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


# `lm.simulate_procedural`: captures of a procedural scene of any size, written block by block.
#
# Neither the matrix nor the frames are ever in memory as a whole: for a megapixel camera T would
# take more than a gigabyte, and 1,024 frames as much again.


Progress = Callable[[int, int], None]
_SHAPES = ("camera_shape", "projector_shape")
# The block sizes below bound the memory of a simulation to some hundred MiB. They were chosen by
# hand and do not change the frames: rows of T that are made at once, samples (all frames together)
# that are exposed at once, and bytes of unpacked float32 patterns.
_ROWS = 1 << 13
_SAMPLES = 1 << 22
_PATTERN_BYTES = 256 << 20
# An entry of T takes this many bytes while its blocks are joined: column, value and direct part,
# 4 bytes each, exist twice.
_ENTRY_BYTES = 24


def simulate_procedural(
    output: str | Path,
    scene: ProceduralScene,
    patterns: PatternSet | str | Path,
    *,
    exposure: float | str = 0.8,
    bits: int | None = 8,
    noise: float = USUAL_NOISE,
    shot_noise: float = 0.0,
    black_level: float = 0.0,
    seed: int = 0,
    truth: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Capture:
    """Simulate photographs of a procedural scene of any size, in bounded memory.

    The frames are those of `simulate` for the same matrix and seed.

    Parameters
    ----------
    output : str or Path
        A packed capture, written strip by strip, if it ends in .zarr. Otherwise a capture folder,
        whose frames are collected in memory or, above 2 GiB, in a temporary file.
    scene : ProceduralScene
        The scene.
    patterns : PatternSet, str or Path
        K patterns of the scene's projector, or a folder of them.
    exposure, bits, noise, shot_noise, black_level, seed : optional
        See `simulate`.
    truth : bool
        Whether to write the whole of T beside the frames, as truth.npz. That takes about 1.2 kB
        of memory per camera pixel. Without the file, `truth` computes T again from the scene.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Capture
        As `Capture.open` reads it.

    Raises
    ------
    InputError
        On patterns of another projector, values out of range, or a truth larger than the memory.
    OutputError
        If the capture exists, the disk is too full, or it cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> scene = lm.ProceduralScene((24, 32), (16, 16))
    >>> patterns = lm.BernoulliPatterns((16, 16), 8)
    >>> capture = lm.simulate_procedural("made.zarr", scene, patterns)
    >>> capture.camera_shape, lm.truth("made.zarr").matrix.shape
    ((24, 32), (768, 256))
    """
    check_seed(seed)
    packed = Path(output).suffix.lower() == ".zarr"
    check_output(output, PACKED_CAPTURE if packed else CAPTURE, overwrite=overwrite)
    exposures = parse_exposures(exposure if isinstance(exposure, str) else repr(float(exposure)))
    if not isinstance(patterns, PatternSet):
        patterns = read_patterns(patterns)
    if patterns.shape != scene.projector_shape:
        raise InputError(
            f"patterns of {patterns.shape[0]} x {patterns.shape[1]} pixels for a projector of "
            f"{scene.projector_shape[0]} x {scene.projector_shape[1]}",
            hint="make the patterns for the projector of this scene",
        )
    sensor = Sensor(
        exposure_sequence(exposures, patterns), float(black_level), noise, shot_noise, bits
    )
    if truth:
        check_truth_fits(scene, output)
    shutter = _Shutter(scene, patterns, sensor, seed, progress)
    # `scene_of` reads the parameters of the scene.
    parameters = {**asdict(scene), **{name: list(getattr(scene, name)) for name in _SHAPES}}
    provenance = {"scene": PROCEDURAL, "seed": seed, PROCEDURAL: parameters}

    def save_truth(part: Path) -> None:
        if truth:
            scene.truth().save(part / TRUTH)

    if packed:
        digits = max(4, len(str(patterns.count - 1)))
        write_packed(
            output,
            patterns,
            shutter.strips,
            decoder=sensor.decoder(),
            shape=scene.camera_shape,
            dtype=sensor.dtype,
            names=[f"image_{k:0{digits}d}" for k in range(patterns.count)],
            provenance=provenance,
            write_extras=save_truth,
            overwrite=overwrite,
        )
    else:
        write_capture(
            output,
            patterns,
            shutter.frames(),
            sensor=sensor,
            camera_shape=scene.camera_shape,
            provenance=provenance,
            write_extras=save_truth,
            overwrite=overwrite,
        )
    return Capture.open(output)


def scene_of(provenance: Mapping[str, Any]) -> ProceduralScene | None:
    """The procedural scene that a capture's provenance describes; None if it is another."""
    description = provenance.get(PROCEDURAL)
    if not isinstance(description, Mapping):
        return None
    parameters = dict(description)
    try:
        shapes = [tuple(int(n) for n in parameters.pop(name)) for name in _SHAPES]
        (rows, cols), (high, wide) = shapes
        return ProceduralScene((rows, cols), (high, wide), **parameters)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the description of a {PROCEDURAL} scene cannot be read: {error}",
            hint="simulate it again",
        ) from error


def check_truth_fits(scene: ProceduralScene, name: str | Path) -> None:
    """Raise InputError if the whole T of a scene would not fit into memory."""
    check_memory(Path(name), math.prod(scene.camera_shape) * scene.row_entries * _ENTRY_BYTES)


@dataclass(frozen=True)
class _Shutter:
    """Exposes a scene under all patterns, some camera rows at a time."""

    scene: ProceduralScene
    patterns: PatternSet
    sensor: Sensor
    seed: int
    progress: Progress | None

    def strips(self, rows: int) -> Iterator[NDArray[Any]]:
        """Raw levels (K, r, cols) from top to bottom; r is a multiple of `rows` but at the end."""
        height, width = self.scene.camera_shape
        step = rows * max(1, _SAMPLES // (rows * width * max(64, self.patterns.count)))
        for top in range(0, height, step):
            end = min(top + step, height)
            levels = self._expose(top * width, end * width)
            yield np.ascontiguousarray(levels.T).reshape(-1, end - top, width)
            if self.progress is not None:
                self.progress(end * width, height * width)

    def frames(self) -> Iterator[NDArray[Any]]:
        """Whole frames, (rows, cols)."""
        shape = (self.patterns.count, *self.scene.camera_shape)
        stack, top = scratch_array(shape, self.sensor.dtype), 0
        for strip in self.strips(1):
            stack[:, top : top + strip.shape[1]] = strip
            top += strip.shape[1]
        yield from stack

    def _expose(self, start: int, stop: int) -> NDArray[Any]:
        """Raw levels (stop - start, K) of some camera samples."""
        cuts = [*range(start, stop, _ROWS), stop]
        matrix = stack_rows([self.scene.rows(*pair)[0] for pair in itertools.pairwise(cuts)])
        count = self.patterns.count
        light = np.empty((stop - start, count), np.float32)
        step = max(16, _PATTERN_BYTES // (4 * self.patterns.pixels))
        for k in range(0, count, step):
            block = np.arange(k, min(k + step, count))
            light[:, k : k + step] = irradiance(matrix, self.patterns.subset(block))
        return self.sensor.expose(light, seed=self.seed, first_row=start)
