"""Colour projectors and cameras as rigs: scenes whose surfaces, and global light, have colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lightmatrix.patterns.colour import colour_bernoulli
from lightmatrix.simulation.colour import in_all_primaries
from lightmatrix.simulation.simulate import SimulatedCapture, simulate
from lightmatrix.simulation.truth import Truth

# "Tinted" surfaces have a random colour in each square of this many camera pixels.
SQUARE = 8
# How much of red, green and blue light the surface passes on that tints global light.
OTHER_SURFACE = (0.3, 1.0, 0.6)


def tinted(truth: Truth, other: bool = False) -> Truth:
    """T of a colour projector, with surfaces of random colours.

    With `other`, all global light is tinted once more, by a colour that direct light never has.
    """
    wide = in_all_primaries(truth)
    rows, cols, channels = wide.camera_shape
    squares = np.random.default_rng(5).uniform(
        0.25, 1, (-(-rows // SQUARE), -(-cols // SQUARE), channels)
    )
    surface = np.kron(squares, np.ones((SQUARE, SQUARE, 1)))[:rows, :cols].reshape(-1)
    of_global = np.tile(OTHER_SURFACE if other else np.ones(channels), rows * cols)
    entries = np.diff(wide.matrix.indptr)
    direct = wide.direct_data * np.repeat(surface, entries)
    rest = (wide.matrix.data - wide.direct_data) * np.repeat(surface * of_global, entries)
    data = (direct + rest).astype(np.float32)
    return replace(wide, matrix=wide.with_data(data), direct_data=direct.astype(np.float32))


# From T of a grey scene to that of a colour projector and camera, and whether some photographs are
# grey: half of them, at most 16.
COLOUR_RIGS: dict[str, tuple[Callable[[Truth], Truth], bool]] = {
    "colour": (in_all_primaries, True),
    "colour, none grey": (in_all_primaries, False),
    "colour, tinted surfaces": (tinted, True),
    "colour, tinted global light": (lambda truth: tinted(truth, other=True), True),
}


def colour_capture(
    truth: Truth, count: int, exposure: float | str, *, grey: bool = True, seed: int = 0
) -> SimulatedCapture:
    """`count` photographs of a colour projector, some of them under grey patterns."""
    rows, wide = truth.projector_shape
    patterns = colour_bernoulli((rows, wide // 3), count, grey=None if grey else 0, seed=seed)
    return simulate(truth, patterns, exposure=exposure, seed=seed)
