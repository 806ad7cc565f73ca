"""A scene before a camera that cannot see: photographs made from what a folder projector shows."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.files.images import read_image
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.rig.devices.folders import SHOWN
from lightmatrix.rig.rig import Rig
from lightmatrix.rig.rig_measurements import (
    CameraLinearity,
    ExposureAdvice,
    Flicker,
    RigMeasurements,
    SettleTime,
)

_BLACK, _NOISE = 8.0, 1.2
# Size of a JPEG file: virtual cameras look at it once.
_JPEG_BYTES = 40_000


@dataclass
class ShownScene:
    """A screen that is photographed straight on, each of its pixels in a block of the camera's.

    Parameters
    ----------
    folder : Path
        Of the projector.
    projector, camera : (rows, cols)
        Shapes; those of the camera are multiples of the projector's.
    exposure : float
        Seconds at which white is 0.8 of full scale.
    """

    folder: Path
    projector: tuple[int, int]
    camera: tuple[int, int]
    exposure: float
    photographs: int = 0
    _surface: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self._surface = np.random.default_rng(5).uniform(0.4, 0.8, self.camera)

    def light(self, image: NDArray[np.uint8], exposure: float) -> NDArray[np.float64]:
        """Levels (rows, cols) without noise."""
        down, across = (c // p for c, p in zip(self.camera, self.projector, strict=True))
        shown = np.kron(image / 255, np.ones((down, across)))
        return np.minimum(_BLACK + 247 * self._surface * shown * exposure / self.exposure, 255)

    def photograph(self, exposure: float) -> NDArray[np.uint8]:
        """What is shown now, with noise."""
        self.photographs += 1
        levels = self.light(read_image(self.folder / SHOWN), exposure)
        levels = levels + _NOISE * np.random.default_rng(self.photographs).standard_normal(
            self.camera
        )
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def write_jpeg(self, path: Path, exposure: float) -> None:
        """The same as a file, in place of one that is there."""
        content = io.BytesIO()
        grey = self.photograph(exposure)
        Image.fromarray(np.repeat(grey[..., None], 3, 2)).save(content, "JPEG", quality=98)
        data = content.getvalue()
        assert len(data) <= _JPEG_BYTES
        path.write_bytes(data.ljust(_JPEG_BYTES, b"\0"))

    def known(self, rig: Rig) -> RigMeasurements:
        """What measuring the rig at length would find."""
        steps = tuple(range(0, 256, 15))
        white = self.light(np.full(self.projector, 255, np.uint8), self.exposure)
        return RigMeasurements(
            rig.projector.info(),
            rig.camera.info(),
            SettleTime(0.02, 0.0, 21, 0),
            Flicker(0.0, 0.0, 0.001, 0.0),
            ExposureAdvice((self.exposure,), 0.5, (0.0,), _NOISE / 255, _BLACK),
            ProjectorResponse(steps, tuple(step / 255 for step in steps), 1.0),
            CameraLinearity((self.exposure,), (0.7,), 0.0, 1.0),
            float((white - _BLACK).mean()) / 255 / self.exposure,
        )
