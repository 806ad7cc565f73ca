"""Pixel formats of GenICam cameras that can be read without unpacking bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError


@dataclass(frozen=True)
class PixelFormat:
    """How a camera's bytes become an image."""

    # By the naming convention of GenICam (PFNC).
    name: str
    # Bits of a value that carry light.
    bits: int
    # 1 or 3; a colour filter's mosaic is one channel, each pixel a sample of its own.
    channels: int = 1
    # Whether blue comes first.
    reverse: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a value; the convention prescribes little endian."""
        return np.dtype("u1" if self.bits == 8 else "<u2")

    @property
    def clip_level(self) -> float:
        """The largest value."""
        return float(2**self.bits - 1)

    def image(self, data: bytes, rows: int, cols: int) -> NDArray[Any]:
        """The image in a buffer, which may be longer; a DeviceError if it is shorter."""
        count = rows * cols * self.channels
        if len(data) < count * self.dtype.itemsize:
            raise DeviceError(
                f"the camera delivered {len(data)} bytes for {cols} x {rows} pixels of {self.name}",
                hint="open the camera again",
            )
        flat = np.frombuffer(data, self.dtype, count)
        if self.channels == 1:
            return flat.reshape(rows, cols)
        image = flat.reshape(rows, cols, self.channels)
        return np.ascontiguousarray(image[..., ::-1]) if self.reverse else image


# The formats from best to worst. More bits are better; grey is better than a mosaic, and a mosaic
# better than colours that the camera interpolates.
FORMATS = (
    *(PixelFormat(f"Mono{bits}", bits) for bits in (16, 14, 12, 10)),
    *(
        PixelFormat(f"Bayer{order}{bits}", bits)
        for bits in (16, 14, 12, 10)
        for order in ("RG", "GR", "GB", "BG")
    ),
    PixelFormat("Mono8", 8),
    *(PixelFormat(f"Bayer{order}8", 8) for order in ("RG", "GR", "GB", "BG")),
    PixelFormat("RGB8", 8, 3),
    PixelFormat("RGB8Packed", 8, 3),
    PixelFormat("BGR8", 8, 3, reverse=True),
    PixelFormat("BGR8Packed", 8, 3, reverse=True),
)


def choose_format(camera: str, offered: Sequence[str], wanted: str | None = None) -> PixelFormat:
    """The wanted format, or the best one that a camera offers; a DeviceError if there is none."""
    usable = [known for known in FORMATS if known.name in offered]
    names = ", ".join(known.name for known in usable)
    if wanted is not None:
        chosen = next((known for known in usable if known.name == wanted), None)
        if chosen is None:
            reason = (
                "lightmatrix does not unpack it" if wanted in offered else "it does not offer that"
            )
            raise DeviceError(
                f"{camera}: pixel format {wanted} cannot be used, {reason}",
                hint=f"choose one of {names}" if usable else f"it offers {', '.join(offered)}",
            )
        return chosen
    if not usable:
        listed = ", ".join(offered) or "it has none"
        raise DeviceError(
            f"{camera}: none of its pixel formats can be read: {listed}",
            hint="switch it to Mono8, Mono16 or RGB8 by its maker's program",
        )
    return usable[0]
