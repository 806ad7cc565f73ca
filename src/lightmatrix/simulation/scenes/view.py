"""`View`: where a camera or a projector of a scene stands, and what it sees or lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Every device covers this width of the plane through its target: the square |x|, |y| <= 1.
WIDTH = 2.0


@dataclass(frozen=True)
class View:
    """A device at a position that looks at a target.

    Parameters
    ----------
    position : (x, y, z)
        Its centre.
    target : (x, y, z), optional
        The point in the middle of its image. None: it looks straight down, and its film is shifted
        such that it covers the square |x|, |y| <= 1 of the plane z = 0.
    roll : float
        How far it is turned about its axis, in degrees, clockwise as seen from behind.
    width : float
        Width of its image in the plane through the target at right angles to the axis.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float] | None = None
    roll: float = 0.0
    width: float = WIDTH

    @property
    def distance(self) -> float:
        """From the centre to the target, or straight down to the plane z = 0."""
        if self.target is None:
            return self.position[2]
        return float(np.linalg.norm(np.subtract(self.target, self.position)))

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors (3, 3): to the right, down and forwards in its image."""
        x, y, _ = self.position
        forward = np.subtract((x, y, 0) if self.target is None else self.target, self.position)
        forward = forward / np.linalg.norm(forward)
        # The scene's y points up in an image that is not turned.
        right = np.cross(forward, (0, 1, 0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        c, s = np.cos(np.radians(self.roll)), np.sin(np.radians(self.roll))
        return np.stack([c * right + s * down, c * down - s * right, forward])

    def intrinsics(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """K (3, 3) for an image of (rows, cols) with pixel centres at whole numbers."""
        rows, cols = shape
        focal = cols * self.distance / self.width
        # A shifted film keeps the middle of the square in the middle of the image.
        x, y = (self.position[0], self.position[1]) if self.target is None else (0.0, 0.0)
        across, down = x * cols / self.width, -y * cols / self.width
        return np.array(
            [
                [focal, 0, (cols - 1) / 2 + across],
                [0, focal, (rows - 1) / 2 + down],
                [0, 0, 1],
            ]
        )

    def matrix(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """The projection (3, 4) of (x, y, z, 1) to (col, row, 1) for an image of (rows, cols)."""
        turn = self.axes
        return self.intrinsics(shape) @ np.column_stack([turn, -turn @ self.position])
