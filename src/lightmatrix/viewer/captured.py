"""The patterns of a capture, which the page offers to project again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.operator import TransportOperator
from lightmatrix.viewer.packed import packed


class CapturedPatterns:
    """K patterns of the size of the matrix's projector.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture.
    matrix : LightTransport or StoredTransport
        What was estimated from it, perhaps with the projector binned.

    Raises
    ------
    InputError
        If there is no capture, or its projector is another one.
    """

    def __init__(self, capture: Capture | str | Path, matrix: TransportOperator) -> None:
        opened = capture if isinstance(capture, Capture) else Capture.open(capture)
        self._patterns = _binned(opened.patterns, matrix.image_shapes[1])

    @property
    def count(self) -> int:
        """K."""
        return self._patterns.count

    def levels(self, number: int) -> bytes:
        """A pattern as levels of one byte, see `packed`.

        Raises
        ------
        InputError
            If there is no such pattern.
        """
        if not 0 <= number < self.count:
            raise InputError(f"pattern {number} of {self.count}", hint="count them from 0")
        image = self._patterns.images(number, number + 1)[0]
        return packed({}, {"levels": np.rint(255 * image).clip(0, 255).astype(np.uint8)})


def _binned(patterns: PatternSet, shape: tuple[int, ...]) -> PatternSet:
    """Patterns of a shape that theirs is a multiple of."""
    if patterns.shape == shape:
        return patterns
    block = tuple(-(-whole // part) for whole, part in zip(patterns.shape, shape, strict=True))
    if tuple(-(-whole // size) for whole, size in zip(patterns.shape, block, strict=True)) != shape:
        raise InputError(
            f"a capture with a projector of {patterns.shape[0]} x {patterns.shape[1]}, and a "
            f"matrix with one of {shape[0]} x {shape[1]}",
            hint="give the capture that the matrix was estimated from",
        )
    return patterns.coarse((block[0], block[1]))
