"""The images that a projector is given for patterns: cells, centring, and its response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet, to_grey
from lightmatrix.patterns.projector_curve import ProjectorResponse


@dataclass(frozen=True, eq=False)
class ProjectedPatterns:
    """A pattern set on a projector's screen; an InputError if it does not fit."""

    # K patterns.
    patterns: PatternSet
    # (rows, cols): the projector's pixels.
    screen: tuple[int, int]
    # Projector pixels along a side of each pattern pixel.
    cell: int = 1
    # Chooses grey values that give the patterns' light; black-and-white patterns need none.
    response: ProjectorResponse | None = None

    def __post_init__(self) -> None:
        rows, cols = self.patterns.shape
        if rows * self.cell > self.screen[0] or cols * self.cell > self.screen[1]:
            cells = f", each pixel {self.cell} x {self.cell}" if self.cell > 1 else ""
            raise InputError(
                f"patterns of {rows} x {cols} pixels{cells}, for a projector of "
                f"{self.screen[0]} x {self.screen[1]}",
                hint=f"make patterns of {self.screen[0] // self.cell}x"
                f"{self.screen[1] // self.cell} at most",
            )

    @cached_property
    def _grey(self) -> bool:
        """Whether the patterns have other values than black and white."""
        return self.patterns.as_bits() is None

    def image(self, index: int) -> NDArray[np.uint8]:
        """The image of a pattern, (rows, cols) uint8, in the middle of a black screen."""
        light = self.patterns.images(index, index + 1)[0]
        if self._grey and self.response is not None:
            grey = self.response.grey_for(light)
        else:
            grey = to_grey(light)
        grey = grey.repeat(self.cell, axis=0).repeat(self.cell, axis=1)
        if grey.shape == self.screen:
            return grey
        whole = np.zeros(self.screen, np.uint8)
        top, left = ((a - b) // 2 for a, b in zip(self.screen, grey.shape, strict=True))
        whole[top : top + grey.shape[0], left : left + grey.shape[1]] = grey
        return whole
