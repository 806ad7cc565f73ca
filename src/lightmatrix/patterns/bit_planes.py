"""Black and white patterns as bit planes of colour images, for boards with micromirrors.

Such a board shows each of the 24 bits of a colour image by itself, thousands in a second. It is
told by number which one comes next.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.files.images import fill_image
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import PatternSet

# The first letters of the primaries, as they stand in a file.
_CHANNELS = "rgb"
_BITS = 8


def check_order(patterns: PatternSet, order: str) -> None:
    """Refuse an order of the primaries that names not each once, and patterns in grey or colour.

    Raises
    ------
    InputError
        On either of them.
    """
    if sorted(order) != sorted(_CHANNELS):
        hint = "use grb for TI's LightCrafter 4500, or rgb, bgr, ... for other boards"
        raise InputError(f"bit planes in the order {order!r}", hint=hint)
    grey = any(((image > 0) & (image < 1)).any() for _, image in patterns.chunks())
    if grey or isinstance(patterns, ColourPatterns):
        hint = "use black and white ones, such as bernoulli"
        raise InputError(f"bit planes of patterns in {'grey' if grey else 'colour'}", hint=hint)


def fill_bit_planes(folder: Path, patterns: PatternSet, order: str) -> None:
    """Write colour images planes_00.png, ... and sequence.csv, which says where each pattern is.

    The first eight patterns are the bits of the primary that `order` names first, the lowest bit
    first, the next eight those of the second.
    """
    folder.mkdir()
    step = len(order) * _BITS
    rows = []
    for start in range(0, patterns.count, step):
        planes = np.zeros((*patterns.shape, len(order)), np.uint8)
        name = f"planes_{start // step:02d}.png"
        for number, k in enumerate(range(start, min(start + step, patterns.count))):
            primary, bit = order[number // _BITS], number % _BITS
            lit = patterns.images(k, k + 1)[0] > 0
            planes[..., _CHANNELS.index(primary)] |= lit.astype(np.uint8) << bit
            rows.append((k, name, number, f"{primary.upper()}{bit}"))
        fill_image(folder / name, planes)
    with (folder / "sequence.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("pattern", "image", "plane", "bit"))
        writer.writerows(rows)
