"""Direct and global light on rendered scenes that the experiment `uses` does not hold.

The thresholds of `lightmatrix.uses.separation` were chosen on them. Needs the
extra `render`, and half a minute a scene:

    python -m benchmarks.separation_scenes
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import lightmatrix as lm
from experiments.uses import separation_rows
from lightmatrix.simulation.scenes import BUILDERS, Part, Scene, View, matt, metal, plastic
from lightmatrix.simulation.scenes import scene as bundled
from lightmatrix.simulation.shapes import (
    Mesh,
    ball,
    bolt,
    box,
    bracket,
    nut,
    ring,
    sheet,
    turn,
)

SIZE, SAMPLES, PATTERNS, NOISE = (64, 64), 3000, 32, 0.003


def strewn_parts(seed: int, camera: View) -> Scene:
    """Metal parts at random places and angles on paper."""
    random = np.random.default_rng(seed)
    shapes = [
        bolt(radius=0.06, length=0.45, head_radius=0.11, head_height=0.09),
        nut(radius=0.14, hole=0.066, height=0.11),
        ring(radius=0.18, hole=0.08, height=0.05),
        bracket(leg=0.36, thickness=0.045, width=0.3),
    ]
    parts = [Part(sheet(), matt(0.8))]
    for number in range(18):
        x, y = random.uniform(-0.9, 0.9, 2)
        place = (float(x), float(y), 0.12 + 0.1 * random.random())
        turned = turn("xyz"[number % 3], float(random.uniform(0, 360)))
        surface = metal(("Cr", "Al")[number % 2], (0.2, 0.15, 0.3)[number % 3])
        parts.append(Part(shapes[number % 4].placed(place, turned), surface))
    return Scene("parts", "", tuple(parts), camera=camera)


def clutter() -> Scene:
    """Boxes and balls of paper, plastic and metal."""
    random = np.random.default_rng(7)
    parts = [Part(sheet(), matt(0.7))]
    surfaces = (matt(0.9), matt(0.3), plastic((0.5, 0.5, 0.5), 0.2), metal("Al", 0.25))
    for number in range(14):
        x, y = random.uniform(-0.9, 0.9, 2)
        height = float(random.uniform(0.1, 0.6))
        if number % 2:
            sides = random.uniform(0.15, 0.4, 2)
            mesh = box(float(sides[0]), float(sides[1]), height, 0.01)
        else:
            mesh = ball(float(random.uniform(0.1, 0.25)))
        turned = turn("z", float(random.uniform(0, 90)))
        parts.append(Part(mesh.placed((float(x), float(y), 0.0), turned), surfaces[number % 4]))
    return Scene("clutter", "", tuple(parts), camera=View((0.9, 0.3, 4.0)))


def turned_corner() -> Scene:
    """The bundled corner turned by 90 degrees, from another side."""
    known, quarter = bundled("corner"), np.asarray(turn("z", 90))
    parts = tuple(
        Part(Mesh(part.mesh.vertices @ quarter.T, part.mesh.faces), part.material)
        for part in known.parts
    )
    return replace(known, parts=parts, camera=View((-0.5, 0.1, 4.0)))


def near_camera() -> Scene:
    """Boxes and balls from nearby, so that the perspectives of both devices differ."""
    things = (
        (box(0.4, 0.35, 0.5, 0.01), -0.45, -0.5),
        (ball(0.25), 0.4, -0.4),
        (box(0.3, 0.5, 0.3, 0.01), -0.4, 0.4),
        (box(0.25, 0.25, 0.7, 0.01), 0.55, 0.5),
        (ball(0.15), 0.0, 0.05),
    )
    parts = [Part(sheet(), matt(0.8))]
    parts += [Part(mesh.placed((x, y, 0.0), turn("z", 20.0)), matt(0.6)) for mesh, x, y in things]
    camera, projector = View((-1.1, -0.6, 2.4)), View((0.0, 0.0, 3.2))
    return Scene("near", "", tuple(parts), camera=camera, projector=projector)


SCENES: dict[str, Callable[[], Scene]] = {
    "parts": lambda: strewn_parts(5, View((0.7, -0.6, 4.0))),
    "other parts": lambda: strewn_parts(11, View((-0.6, 0.8, 4.0))),
    "parts, seed 2": lambda: strewn_parts(2, View((0.7, 0.7, 4.0))),
    "parts, seed 3": lambda: strewn_parts(3, View((-0.7, -0.5, 4.0))),
    "parts, seed 8": lambda: strewn_parts(8, View((0.9, 0.1, 4.0))),
    "parts, seed 13": lambda: strewn_parts(13, View((-0.1, 0.9, 4.0))),
    "clutter": clutter,
    "turned corner": turned_corner,
    "near camera": near_camera,
}


def main() -> None:
    """Render each scene, estimate it sharp and out of focus, and print the errors."""
    BUILDERS.update(SCENES)
    for name in SCENES:
        truth = lm.render(name, SIZE, samples=SAMPLES)
        exposure = lm.plan(truth, frames=PATTERNS, noise=NOISE).exposure
        patterns = lm.BernoulliPatterns(SIZE, PATTERNS)
        capture = lm.simulate(truth, patterns, exposure=exposure, noise=NOISE)
        for row in separation_rows(lm.estimate(capture), truth, name, seed=0):
            print(", ".join(str(value) for value in row.values()), flush=True)


if __name__ == "__main__":
    main()
