"""Light paths from the camera, each vertex of which is connected to the projector.

The whole of T comes from one pass. At each surface point of a path, the light that arrives straight
from the projector came through one projector pixel, which the sampling of the emitter reports. What
the path carries of it to the camera belongs to that entry of T.

A path gives one to five such contributions, whatever the number of projector pixels. They are
collected and then summed by one sort, so a rendering costs the same for any projector.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


@dataclass(frozen=True)
class LoadedScene:
    """A scene in Mitsuba (`mi`), with all that tracing its paths needs to know."""

    mi: ModuleType
    scene: Any
    camera_shape: tuple[int, int]
    projector_shape: tuple[int, int]
    max_depth: int
    colour: bool
    # Whether Mitsuba runs its LLVM variant; the scalar one traces path after path.
    fast: bool

    @property
    def channels(self) -> int:
        """Camera samples per camera pixel."""
        return 3 if self.colour else 1

    @property
    def pixels(self) -> int:
        """Projector pixels N."""
        return self.projector_shape[0] * self.projector_shape[1]


@dataclass(frozen=True)
class Contributions:
    """Light of n path vertices: its place in T (row * N + column), value, whether it is direct."""

    place: NDArray[np.uint32]
    value: NDArray[np.float32]
    direct: NDArray[np.bool_]


def trace_block(loaded: LoadedScene, first: int, count: int, samples: int, seed: int) -> csr_array:
    """Trace `samples` paths from each of `count` camera pixels, starting at pixel `first`.

    The sums over the paths are (count * channels, N) complex64: all light is the real part, direct
    light among it the imaginary part. ``count * channels * N`` must be at most 2^32.
    """
    trace = _trace if loaded.fast else _trace_scalar
    contributions = trace(loaded, first, count, samples, seed)
    return sum_contributions(contributions, (count * loaded.channels, loaded.pixels))


def sum_contributions(contributions: Contributions, shape: tuple[int, int]) -> csr_array:
    """Add up contributions to a matrix in any order, as `trace_block` says; zeros are dropped."""
    lit = contributions.value > 0
    value, direct = contributions.value[lit], contributions.direct[lit]
    bits = value.view(np.uint32) | (direct.astype(np.uint32) << np.uint32(31))
    # The key holds the place, then the value, whose unused sign bit marks direct light. One sort
    # of integers is several times faster than sorting the places and gathering the values.
    key = (contributions.place[lit].astype(np.uint64) << np.uint64(32)) | bits
    key.sort()
    places = (key >> np.uint64(32)).astype(np.uint32)
    bits = key.astype(np.uint32)
    values = (bits & np.uint32(0x7FFFFFFF)).view(np.float32).astype(np.float64)
    new = np.ones(len(places), bool)
    np.not_equal(places[1:], places[:-1], out=new[1:])
    starts = np.flatnonzero(new)
    data = np.empty(len(starts), np.complex64)
    if len(starts):
        data.real = np.add.reduceat(values, starts)
        data.imag = np.add.reduceat(values * (bits >> np.uint32(31)), starts)
    row, column = np.divmod(places[starts], np.uint32(shape[1]))
    indptr = np.searchsorted(row, np.arange(shape[0] + 1))
    return csr_array((data, column.astype(np.int32), indptr.astype(np.int32)), shape=shape)


def _trace(loaded: LoadedScene, first: int, count: int, samples: int, seed: int) -> Contributions:
    """All contributions of a block, zeros among them, by Mitsuba's LLVM variant."""
    import drjit as dr

    mi = loaded.mi
    paths = count * samples
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    path = dr.arange(mi.UInt32, paths)
    block_pixel = path // samples
    recorder = _Recorder(
        mi,
        loaded.projector_shape,
        dr.zeros(mi.UInt32, paths * loaded.max_depth),
        [dr.zeros(mi.Float, paths * loaded.max_depth) for _ in range(loaded.channels)],
        path,
        block_pixel * (loaded.channels * loaded.pixels),
        paths,
    )
    # `first` is opaque to the compiler, so that one kernel serves all blocks.
    camera_pixel = block_pixel + dr.opaque(mi.UInt32, first)
    offset = sampler.next_2d()
    rows, cols = loaded.camera_shape
    film = mi.Point2f(
        (mi.Float(camera_pixel % cols) + offset.x) / cols,
        (mi.Float(camera_pixel // cols) + offset.y) / rows,
    )
    ray, weight = loaded.scene.sensors()[0].sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    _follow(loaded, sampler, mi.Ray3f(ray.o, ray.d), mi.Color3f(weight), recorder)
    dr.eval(recorder.places, recorder.values)
    # Contributions of one depth stand together; those of depth 0, the direct light, come first.
    place = np.asarray(recorder.places.numpy())
    direct = np.arange(len(place)) < paths
    return Contributions(
        np.concatenate([place + np.uint32(c * loaded.pixels) for c in range(loaded.channels)]),
        np.concatenate([np.asarray(channel.numpy()) for channel in recorder.values]),
        np.tile(direct, loaded.channels),
    )


@dataclass(frozen=True)
class _Recorder:
    """Arrays of the renderer that take one contribution per path and depth."""

    mi: ModuleType
    projector_shape: tuple[int, int]
    places: Any
    values: list[Any]
    path: Any
    row_start: Any
    paths: int

    def record(self, depth: Any, pattern_uv: Any, light: Any, lit: Any) -> None:
        """Store the light that came through the projector at `pattern_uv`, in [0, 1]^2."""
        import drjit as dr

        rows, cols = self.projector_shape
        row = self.mi.UInt32(dr.clip(pattern_uv.y * rows, 0, rows - 1))
        col = self.mi.UInt32(dr.clip(pattern_uv.x * cols, 0, cols - 1))
        slot = depth * self.paths + self.path
        dr.scatter(self.places, self.row_start + row * cols + col, slot, lit)
        channels = [light.x, light.y, light.z] if len(self.values) == 3 else [dr.mean(light)]
        for target, channel in zip(self.values, channels, strict=True):
            dr.scatter(target, channel, slot, lit)


def _follow(
    loaded: LoadedScene, sampler: Any, ray: Any, throughput: Any, recorder: _Recorder
) -> None:
    """Follow all paths at once, bounce by bounce, and record their contributions."""
    import drjit as dr

    mi, scene = loaded.mi, loaded.scene
    context = mi.BSDFContext()

    def alive(active: Any, *_: Any) -> Any:
        return active

    def bounce(active: Any, ray: Any, throughput: Any, depth: Any, sampler: Any) -> Any:
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        bsdf = hit.bsdf(ray)
        light, emitted = scene.sample_emitter_direction(hit, sampler.next_2d(active), True, active)
        lit = active & (light.pdf > 0)
        value = throughput * bsdf.eval(context, hit, hit.to_local(light.d), lit) * emitted
        recorder.record(depth, light.uv, value, lit)
        sample, factor = bsdf.sample(
            context, hit, sampler.next_1d(active), sampler.next_2d(active), active
        )
        throughput *= factor
        ray = hit.spawn_ray(hit.to_world(sample.wo))
        depth += 1
        active &= (depth < loaded.max_depth) & (dr.max(throughput) > 0)
        return active, ray, throughput, depth, sampler

    dr.while_loop(
        (mi.Bool(True), ray, throughput, mi.UInt32(0), sampler),
        alive,
        bounce,
        labels=("active", "ray", "throughput", "depth", "sampler"),
    )


def _trace_scalar(
    loaded: LoadedScene, first: int, count: int, samples: int, seed: int
) -> Contributions:
    """All contributions of a block, path after path, for machines without LLVM."""
    mi, scene, channels = loaded.mi, loaded.scene, loaded.channels
    camera_rows, camera_cols = loaded.camera_shape
    rows, cols = loaded.projector_shape
    places: list[int] = []
    values: list[float] = []
    direct: list[bool] = []
    random = np.random.default_rng(seed).random
    context = mi.BSDFContext()
    sensor = scene.sensors()[0]
    for pixel in range(count):
        camera_row, camera_col = divmod(first + pixel, camera_cols)
        for _ in range(samples):
            u = random(2)
            film = mi.Point2f((camera_col + u[0]) / camera_cols, (camera_row + u[1]) / camera_rows)
            ray, throughput = sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
            for depth in range(loaded.max_depth):
                hit = scene.ray_intersect(ray)
                if not hit.is_valid():
                    break
                u = random(5)
                bsdf = hit.bsdf(ray)
                light, emitted = scene.sample_emitter_direction(hit, mi.Point2f(u[0], u[1]), True)
                if light.pdf > 0:
                    value = np.asarray(
                        throughput * bsdf.eval(context, hit, hit.to_local(light.d)) * emitted
                    ).ravel()
                    row = min(int(light.uv.y * rows), rows - 1)
                    col = min(int(light.uv.x * cols), cols - 1)
                    for channel in range(channels):
                        places.append((pixel * channels + channel) * rows * cols + row * cols + col)
                        values.append(float(value[channel] if loaded.colour else value.mean()))
                        direct.append(depth == 0)
                sample, factor = bsdf.sample(context, hit, u[2], mi.Point2f(u[3], u[4]))
                throughput = throughput * factor
                if not np.asarray(throughput).max() > 0:
                    break
                ray = hit.spawn_ray(hit.to_world(sample.wo))
    return Contributions(
        np.array(places, np.uint32), np.array(values, np.float32), np.array(direct, bool)
    )
