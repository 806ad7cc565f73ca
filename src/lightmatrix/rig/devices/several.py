"""Several projectors as one, whose picture holds those of all, one above the other."""

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.rig.devices.base import Projector, check_image


def pattern_sizes(projector: Projector, cell: int = 1) -> tuple[tuple[int, int], ...]:
    """Rows and columns of the patterns of each of several projectors; empty if there is one."""
    several = projector.info().get("projectors", ())
    if any(side % cell for size in several for side in size):
        hint = "use a divisor of all their rows and columns"
        raise InputError(f"a cell of {cell} pixels for projectors of {several}", hint=hint)
    return tuple((rows // cell, cols // cell) for rows, cols in several)


def stacked(pictures: Sequence[NDArray[Any]], sizes: Sequence[tuple[int, int]]) -> NDArray[Any]:
    """One picture of those of several projectors, (rows, cols[, 3]) each: see `Capture`."""
    shapes = [picture.shape[:2] for picture in pictures]
    if shapes != [tuple(size) for size in sizes]:
        listed = " and ".join(f"{rows} x {cols}" for rows, cols in sizes)
        hint = "give one picture for each projector, in their order"
        raise InputError(
            f"{len(shapes)} pictures of {shapes}, for projectors of {listed}", hint=hint
        )
    rows, cols = (max(sides) for sides in zip(*sizes, strict=True))
    # Grey pictures beside others in colour are shown in all three primaries.
    colours = max((picture.shape[2:] for picture in pictures), key=len)
    whole = np.zeros((len(sizes), rows, cols, *colours), pictures[0].dtype)
    for slot, picture in zip(whole, pictures, strict=True):
        part = picture[..., None] if picture.ndim < slot.ndim else picture
        slot[: picture.shape[0], : picture.shape[1]] = part
    return whole.reshape(-1, *whole.shape[2:])


class SeveralProjectors(Projector):
    """Projectors that show their parts of one picture."""

    def __init__(self, projectors: Sequence[Projector]) -> None:
        self._projectors = tuple(projectors)
        sizes = [one.shape for one in projectors]
        self._shape = (len(sizes) * max(rows for rows, _ in sizes), max(cols for _, cols in sizes))

    def info(self) -> dict[str, Any]:
        each = [one.info() for one in self._projectors]
        return {
            "name": " + ".join(str(one["name"]) for one in each),
            "shape": list(self.shape),
            "projectors": [list(one.shape) for one in self._projectors],
            # The slowest decides how long frames must wait.
            "refresh": min(float(one.get("refresh") or 60.0) for one in each),
        }

    def show(self, image: NDArray[np.uint8]) -> float:
        check_image(image, self.shape)
        slots = np.split(image, len(self._projectors))
        return max(
            one.show(np.ascontiguousarray(slot[: one.shape[0], : one.shape[1]]))
            for one, slot in zip(self._projectors, slots, strict=True)
        )

    def asked_to_end(self) -> bool:
        return any(one.asked_to_end() for one in self._projectors)

    def close(self) -> None:
        with ExitStack() as stack:
            for one in self._projectors:
                stack.callback(one.close)
