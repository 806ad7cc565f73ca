"""Random patterns of several grey levels: with fewer than sixteen, black and white ones collide.

Eight black and white patterns tell at most 256 pixels apart, eight of four levels 65,536. The price
is that the light of the levels between black and white must be known: a projector's curve, and an
unsharp mask, change these, and leave black and white patterns as they are.
"""

import math

import numpy as np

from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE, FEWEST_FRAMES
from lightmatrix.patterns.pattern_set import ImagePatterns, check_geometry, seed_sequence
from lightmatrix.ranges import check_seed, check_whole


def usual_levels(count: int, pixels: int) -> int:
    """The number of grey levels, 2 to 4, that suits random patterns of some pixels."""
    if count >= FEWEST_BLACK_AND_WHITE:
        return 2
    # Three levels have more contrast than four, if they make eight codes a pixel. On 64 x 64 pixels
    # ten patterns of three err by 0.057 on `metal`, of four by 0.066; eight of three by 0.14, of
    # four by 0.08. Six levels are no better than four.
    return 3 if 3**count >= 8 * pixels else 4


def fewest_frames(pixels: int) -> int:
    """The fewest random patterns that tell so many projector pixels apart, 8 to 16.

    Eight serve 64 x 64 pixels, and two more are needed for each doubling: on 128 x 128 pixels nine
    err by 0.47 on `l_objects`, ten by 0.18 on `metal`, and twelve by 0.02 to 0.05.
    """
    more = math.ceil(2 * math.log2(pixels / 4096))
    return min(FEWEST_FRAMES + max(more, 0), FEWEST_BLACK_AND_WHITE)


def grey_patterns(
    shape: tuple[int, int], count: int, levels: int | None = None, seed: int = 0
) -> ImagePatterns:
    """Random patterns of evenly spaced grey levels, in which no pixel varies little.

    There are `levels` of them, 2 to 256, black and white included; by default `usual_levels`.
    """
    check_geometry(shape, count)
    check_seed(seed)
    number = usual_levels(count, shape[0] * shape[1]) if levels is None else levels
    check_whole("levels", number, least=2, most=256, hint="use 2 to 256, such as 3")
    random = np.random.default_rng(seed_sequence(seed, shape, 1 / number))
    # The projector shows whole levels of 8 bits.
    greys = (np.rint(np.linspace(0, 255, number)) / 255).astype(np.float32)
    values = greys[random.integers(0, number, (count, shape[0] * shape[1]))]
    # Pixels whose values hardly vary from pattern to pattern are drawn again: without this, metal
    # errs by 0.125 and 0.110 under 8 patterns, with it by 0.081 and 0.094. A few draws reach it, if
    # there are patterns enough.
    for _ in range(50):
        flat = np.flatnonzero(values.std(axis=0) < 1 / 3)
        values[:, flat] = greys[random.integers(0, number, (count, len(flat)))]
    return ImagePatterns(values.reshape(count, *shape))
