"""Following light paths from the camera, connecting every vertex to the projector.

The whole of T comes from one pass: at each surface point a path visits, the light that reaches the
point straight from the projector came through one projector pixel, which the sampling of the
emitter reports. What the path would carry of it to the camera belongs to that entry of T.

A path gives one to five such contributions, whatever the number of projector pixels. They are kept
as they come and summed by one sort, so that a rendering costs the same for any projector.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.simulation.summing import summed


def trace_block(
    mi: ModuleType,
    scene: Any,
    first: int,
    count: int,
    samples: int,
    seed: int,
    *,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    max_depth: int,
    colour: bool,
    fast: bool,
) -> csr_array:
    """Trace `samples` paths from each of `count` camera pixels, starting at pixel `first`.

    Parameters
    ----------
    count : int
        ``count * channels * N`` must be at most 2^32.

    Returns
    -------
    (count * channels, N) csr_array complex64
        Sums over the paths of their contributions: all light as real part, the direct light among
        it as imaginary part. Columns are sorted, places without light are not stored.
    """
    trace = _contributions if fast else _contributions_scalar
    place, value, direct = trace(
        mi, scene, first, count, samples, seed, camera_shape, projector_shape, max_depth, colour
    )
    shape = (count * (3 if colour else 1), projector_shape[0] * projector_shape[1])
    return summed(place, value, direct, shape)


Contributions = tuple[NDArray[np.uint32], NDArray[np.float32], NDArray[np.bool_]]


def _contributions(
    mi: ModuleType,
    scene: Any,
    first: int,
    count: int,
    samples: int,
    seed: int,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    max_depth: int,
    colour: bool,
) -> Contributions:
    """Places, values and directness of all contributions, zeros among them."""
    import drjit as dr

    channels = 3 if colour else 1
    paths = count * samples
    places = dr.zeros(mi.UInt32, paths * max_depth)
    values = [dr.zeros(mi.Float, paths * max_depth) for _ in range(channels)]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    path = dr.arange(mi.UInt32, paths)
    block_pixel = path // samples
    # Opaque, so that the compiled kernel serves all blocks.
    camera_pixel = block_pixel + dr.opaque(mi.UInt32, first)
    offset = sampler.next_2d()
    rows, cols = camera_shape
    film = mi.Point2f(
        (mi.Float(camera_pixel % cols) + offset.x) / cols,
        (mi.Float(camera_pixel // cols) + offset.y) / rows,
    )
    ray, weight = scene.sensors()[0].sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    ray = mi.Ray3f(ray.o, ray.d)
    width = projector_shape[0] * projector_shape[1]
    _paths(
        mi, dr, scene, sampler, ray, mi.Color3f(weight), path, block_pixel * (channels * width),
        places, values, projector_shape, max_depth, paths,
    )  # fmt: skip
    dr.eval(places, values)
    # The contributions at one depth stand together, those of the first points of paths in front.
    place = np.asarray(places.numpy())
    direct = np.arange(len(place)) < paths
    return (
        np.concatenate([place + np.uint32(channel * width) for channel in range(channels)]),
        np.concatenate([np.asarray(part.numpy()) for part in values]),
        np.tile(direct, channels),
    )


def _paths(
    mi: ModuleType,
    dr: Any,
    scene: Any,
    sampler: Any,
    ray: Any,
    throughput: Any,
    path: Any,
    row_start: Any,
    places: Any,
    values: list[Any],
    projector_shape: tuple[int, int],
    max_depth: int,
    paths: int,
) -> None:
    context = mi.BSDFContext()
    rows, cols = projector_shape

    def alive(active: Any, *_: Any) -> Any:
        return active

    def bounce(active: Any, ray: Any, throughput: Any, depth: Any, sampler: Any) -> Any:
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        bsdf = hit.bsdf(ray)
        light, emitted = scene.sample_emitter_direction(hit, sampler.next_2d(active), True, active)
        lit = active & (light.pdf > 0)
        value = throughput * bsdf.eval(context, hit, hit.to_local(light.d), lit) * emitted
        row = mi.UInt32(dr.clip(light.uv.y * rows, 0, rows - 1))
        col = mi.UInt32(dr.clip(light.uv.x * cols, 0, cols - 1))
        slot = depth * paths + path
        dr.scatter(places, row_start + row * cols + col, slot, lit)
        parts = [value.x, value.y, value.z] if len(values) == 3 else [dr.mean(value)]
        for target, part in zip(values, parts, strict=True):
            dr.scatter(target, part, slot, lit)
        sample, factor = bsdf.sample(
            context, hit, sampler.next_1d(active), sampler.next_2d(active), active
        )
        throughput *= factor
        ray = hit.spawn_ray(hit.to_world(sample.wo))
        depth += 1
        active &= (depth < max_depth) & (dr.max(throughput) > 0)
        return active, ray, throughput, depth, sampler

    dr.while_loop(
        (mi.Bool(True), ray, throughput, mi.UInt32(0), sampler),
        alive,
        bounce,
        labels=("active", "ray", "throughput", "depth", "sampler"),
    )


def _contributions_scalar(
    mi: ModuleType,
    scene: Any,
    first: int,
    count: int,
    samples: int,
    seed: int,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    max_depth: int,
    colour: bool,
) -> Contributions:
    """`_contributions` one path after another, for machines without LLVM."""
    channels = 3 if colour else 1
    rows, cols = projector_shape
    places: list[int] = []
    values: list[float] = []
    direct: list[bool] = []
    random = np.random.default_rng(seed).random
    context = mi.BSDFContext()
    sensor = scene.sensors()[0]
    for pixel in range(count):
        place = first + pixel
        row, col = divmod(place, camera_shape[1])
        for _ in range(samples):
            u = random(2)
            film = mi.Point2f((col + u[0]) / camera_shape[1], (row + u[1]) / camera_shape[0])
            ray, throughput = sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
            for depth in range(max_depth):
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
                    pattern_row = min(int(light.uv.y * rows), rows - 1)
                    pattern_col = min(int(light.uv.x * cols), cols - 1)
                    column = pattern_row * cols + pattern_col
                    for channel in range(channels):
                        places.append((pixel * channels + channel) * rows * cols + column)
                        values.append(float(value[channel] if colour else value.mean()))
                        direct.append(depth == 0)
                sample, factor = bsdf.sample(context, hit, u[2], mi.Point2f(u[3], u[4]))
                throughput = throughput * factor
                if not np.asarray(throughput).max() > 0:
                    break
                ray = hit.spawn_ray(hit.to_world(sample.wo))
    return np.array(places, np.uint32), np.array(values, np.float32), np.array(direct, bool)
