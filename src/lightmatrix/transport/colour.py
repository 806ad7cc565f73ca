"""`ColourTransport`, the light transport of a colour projector: a matrix for each primary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.transport.matrix import LightTransport


@dataclass(frozen=True, eq=False)
class ColourTransport:
    """T of a colour projector: the matrices of red, green and blue, whose light adds up.

    It can be given wherever three matrices can: to `relight`, `evaluate_colour` and `compensate`.

    Parameters
    ----------
    red, green, blue : LightTransport
        T of each primary, of one camera and one size of patterns.

    Raises
    ------
    InputError
        If their shapes differ.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> colour = lm.ColourTransport(known, known, known)
    >>> colour.relight(np.ones((64, 64, 3))).shape, colour.dual_image().shape
    ((64, 64), (64, 64, 3))
    """

    red: LightTransport
    green: LightTransport
    blue: LightTransport

    def __post_init__(self) -> None:
        for other in (self.green, self.blue):
            if other.image_shapes != self.red.image_shapes:
                raise InputError(
                    f"matrices of shapes {self.red.image_shapes} and {other.image_shapes}",
                    hint="give red, green and blue of one rig",
                )

    def __iter__(self) -> Iterator[LightTransport]:
        return iter((self.red, self.green, self.blue))

    def __len__(self) -> int:
        return 3

    def __getitem__(self, primary: int) -> LightTransport:
        return (self.red, self.green, self.blue)[primary]

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Rows, columns and channels of a photograph."""
        return self.red.camera_shape

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Rows and columns of a pattern."""
        return self.red.projector_shape

    def relight(self, patterns: NDArray[Any]) -> NDArray[np.float32]:
        """Camera images under patterns in colour, (rows, cols, 3) or (K, rows, cols, 3).

        Grey patterns, (rows, cols), are white light. The images are linear and not clipped.
        """
        shown = np.asarray(patterns)
        if shown.ndim < 3:
            shown = np.repeat(shown[..., None], 3, axis=-1)
        if shown.shape[-1] != 3:
            raise InputError(
                f"a pattern of shape {shown.shape} for a colour projector",
                hint="give (rows, cols, 3), or (rows, cols) for white light",
            )
        parts = [one.relight(shown[..., number]) for number, one in enumerate(self)]
        return np.asarray(parts[0] + parts[1] + parts[2])

    def dual_image(self) -> NDArray[np.float32]:
        """The scene seen from the projector in its primaries, lit evenly from the camera.

        (rows, cols, 3): how much of each primary's light at each pixel reaches all channels.
        """
        lights = np.ones(self.camera_shape, np.float32)
        return np.stack([one.dual(lights) for one in self], axis=-1)
