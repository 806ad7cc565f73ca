"""How large an image may be: asked of its header, before anything is decoded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from lightmatrix.errors import InputError

# Twice the largest cameras there are; a stack of such frames fits no memory.
MOST_VALUES = 1 << 28


def check_size(file: Path, shape: Sequence[int]) -> None:
    """Refuse an image that is empty or larger than any camera's.

    Parameters
    ----------
    file : Path
        For the message.
    shape : sequence of int
        Rows, columns and, perhaps, channels, as the header announces them.

    Raises
    ------
    InputError
        Unless there are 1 to 2^28 values.
    """
    if not 1 <= math.prod(shape) <= MOST_VALUES:
        raise InputError(
            f"{file}: announces {' x '.join(map(str, shape))} values",
            hint=f"an image has at most {MOST_VALUES} values; is the file damaged?",
        )
