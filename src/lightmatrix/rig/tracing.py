"""Following light paths from the camera, connecting every vertex to the projector.

The whole of T comes from one pass: at each surface point a path visits, the light that reaches the
point straight from the projector came through one projector pixel, which the sampling of the
emitter reports. What the path would carry of it to the camera is added to that entry of T.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
) -> NDArray[np.float32]:
    """Trace `samples` paths from each of `count` camera pixels, starting at pixel `first`.

    Returns
    -------
    (2, count, channels, N) float32
        Sums over the paths of their contributions, direct light first, then global.
    """
    if not fast:
        return trace_block_scalar(
            mi, scene, first, count, samples, seed, camera_shape, projector_shape, max_depth, colour
        )
    import drjit as dr

    channels = 3 if colour else 1
    pixels = projector_shape[0] * projector_shape[1]
    sums = dr.zeros(mi.Float, 2 * count * channels * pixels)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count * samples)
    block_pixel = dr.arange(mi.UInt32, count * samples) // samples
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
    _paths(
        mi, dr, scene, sampler, ray, mi.Color3f(weight), block_pixel, sums,
        projector_shape, max_depth, channels, count * channels * pixels,
    )  # fmt: skip
    dr.eval(sums)
    return np.asarray(sums.numpy()).reshape(2, count, channels, pixels)


def _paths(
    mi: ModuleType,
    dr: Any,
    scene: Any,
    sampler: Any,
    ray: Any,
    throughput: Any,
    block_pixel: Any,
    sums: Any,
    projector_shape: tuple[int, int],
    max_depth: int,
    channels: int,
    direct_size: int,
) -> None:
    context = mi.BSDFContext()
    rows, cols = projector_shape
    pixels = rows * cols

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
        place = block_pixel * (channels * pixels) + row * cols + col
        place += dr.select(depth == 0, 0, direct_size)
        parts = [value.x, value.y, value.z] if channels == 3 else [dr.mean(value)]
        for channel, part in enumerate(parts):
            dr.scatter_reduce(dr.ReduceOp.Add, sums, part, place + channel * pixels, lit)
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


def trace_block_scalar(
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
) -> NDArray[np.float32]:
    """`trace_block` one path after another, for machines without LLVM."""
    channels = 3 if colour else 1
    rows, cols = projector_shape
    sums = np.zeros((2, count, channels, rows * cols), np.float32)
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
                    sums[int(depth > 0), pixel, :, pattern_row * cols + pattern_col] += (
                        value if colour else value.mean()
                    )
                sample, factor = bsdf.sample(context, hit, u[2], mi.Point2f(u[3], u[4]))
                throughput = throughput * factor
                if not np.asarray(throughput).max() > 0:
                    break
                ray = hit.spawn_ray(hit.to_world(sample.wo))
    return sums
