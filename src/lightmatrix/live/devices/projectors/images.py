"""What every projector asks of the images that it is to show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.live.devices.addresses import in_words


def check_image(image: NDArray[np.uint8], shape: tuple[int, int]) -> None:
    """Refuse an image that a projector cannot show pixel by pixel.

    Raises
    ------
    InputError
        If it is not (rows, cols) or (rows, cols, 3) uint8 with the projector's rows and columns.
    """
    if image.dtype != np.uint8:
        raise InputError(
            f"an image of {image.dtype} for the projector",
            hint="projectors show uint8, 0 to 255",
        )
    if image.shape not in (shape, (*shape, 3)):
        raise InputError(
            f"an image of shape {image.shape} for a projector of {in_words(shape)} pixels",
            hint=f"show images of shape {shape} or {(*shape, 3)}",
        )
