"""`Region`: the rectangle of photographs that `--crop` cuts out, kept in stores."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError


@dataclass(frozen=True)
class Region:
    """A rectangle of photographs of `whole` rows and columns, from a corner of (row, col)."""

    corner: tuple[int, int]
    shape: tuple[int, int]
    whole: tuple[int, int]

    def __post_init__(self) -> None:
        ends = (self.corner[0] + self.shape[0], self.corner[1] + self.shape[1])
        inside = ends[0] <= self.whole[0] and ends[1] <= self.whole[1]
        if min(self.corner) < 0 or min(self.shape) < 1 or not inside:
            size = f"{self.whole[0]} x {self.whole[1]}"
            raise InputError(
                f"a crop of {self.shape[0]} x {self.shape[1]} pixels from row {self.corner[0]}, "
                f"column {self.corner[1]}, of photographs of {size}",
                hint=f"keep rows within 0 to {self.whole[0]}, columns within 0 to {self.whole[1]}",
            )

    def __str__(self) -> str:
        size, of = (f"{shape[0]} x {shape[1]}" for shape in (self.shape, self.whole))
        return f"{size} from {self.corner[0]}, {self.corner[1]}, of {of}"

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns, as an index into an array of the whole."""
        (row, col), (rows, cols) = self.corner, self.shape
        return slice(row, row + rows), slice(col, col + cols)

    def samples(self, camera_shape: tuple[int, ...]) -> NDArray[np.int64]:
        """Indices of its samples, for a camera of (rows, cols[, channels]), in ascending order."""
        every = np.arange(np.prod(camera_shape)).reshape(camera_shape)
        return every[self.slices].ravel()

    def within(self, outer: "Region") -> "Region":
        """The same rectangle of the photographs from which `outer` was cut."""
        row, col = outer.corner[0] + self.corner[0], outer.corner[1] + self.corner[1]
        return Region((row, col), self.shape, outer.whole)

    def as_dict(self) -> dict[str, list[int]]:
        """Corner, shape and whole, JSON-ready."""
        return {name: list(pair) for name, pair in vars(self).items()}
