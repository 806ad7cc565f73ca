"""Settings of a virtual rig, written as `virtual:l_objects,delay=3,late=0.05`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from lightmatrix.errors import InputError

PREFIX = "virtual:"
# The scene that needs neither a file nor a renderer, and has any size.
PROCEDURAL = "procedural"


@dataclass(frozen=True)
class VirtualSettings:
    """A virtual projector and camera, their room and faults: seconds, and rates from 0 to 1."""

    # A scene (see `scenes`), a truth file (T.npz), or "procedural".
    scene: str
    # Pixels along a side of projector and camera; the bundled scenes have 64.
    size: int = 64
    # Refresh rate of the projector in Hz.
    refresh: float = 60.0
    # Refreshes between `show` and the light.
    delay: float = 2.0
    # Exponent of the projector: light = (grey value / 255) ** gamma.
    gamma: float = 2.2
    # Light of a black projector pixel, as a share of a white one's.
    leak: float = 0.001
    # Projector defocus, standard deviation in projector pixels.
    blur: float = 0.0
    # Room light, as a share of the mean white image.
    room: float = 0.02
    # Amplitude of the flicker of the projector's lamp, as a share of its light; its frequency.
    flicker: float = 0.0
    flicker_hz: float = 100.0
    # Amplitude of the flicker of the room's light, as a share of it, at the same frequency.
    room_flicker: float = 0.0
    # Share of its light that the lamp loses in each minute.
    fading: float = 0.0
    # Frames a second of a free-running camera; 0: one frame for each trigger.
    fps: float = 30.0
    # Frames that a free-running camera keeps; further ones are lost until one is fetched.
    buffers: int = 4
    # Time from the end of the exposure until the frame is ready.
    latency: float = 0.004
    # Exposure time at which a sample is T p, that is exposure 1 of `simulate`.
    unit: float = 0.02
    # Bit depth: 8, 10, 12 or 16.
    bits: int = 12
    # Raw level of a sample without light.
    black: float = 64.0
    # Read noise and, at the clip level, shot noise, as shares of the clip level.
    noise: float = 0.003
    shot: float = 0.0
    # Exponent of the camera: 1 is linear.
    curve: float = 1.0
    # Rate of images that the projector shows three to eight refreshes late.
    late: float = 0.02
    # Rates of frames that are lost, replaced by the one before, or contain its lower rows.
    dropped: float = 0.02
    duplicate: float = 0.01
    torn: float = 0.01
    # How long the camera is gone, and how long after the start that begins.
    unplugged: float = 0.0
    unplugged_at: float = 5.0
    # Factor by which another program changes the exposure (0: none does), and when.
    meddled: float = 0.0
    meddled_at: float = 5.0
    # Seed of the noise and the faults.
    seed: int = 0
    # 1: real time; 0: the clock of the rig jumps instead of waiting.
    real: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str):
                continue
            most = 1.0 if field.name in _RATES else math.inf
            least = _LEAST.get(field.name, 0.0)
            if not (math.isfinite(value) and least <= value <= most):
                limit = f" to {most:g}" if most < math.inf else " on"
                raise InputError(
                    f"a virtual rig with {field.name}={value:g}",
                    hint=f"use a number from {least:g}{limit}",
                )

    @property
    def frame_interval(self) -> float:
        """Seconds from frame to frame of a free-running camera at short exposures."""
        return 1 / self.fps if self.fps else 0.0


# Settings that are at most 1, and settings with a least value other than 0.
_RATES = {
    "late", "dropped", "duplicate", "torn", "leak", "flicker", "room_flicker", "fading",
}  # fmt: skip
_LEAST = {"size": 2, "refresh": 1.0, "gamma": 0.1, "curve": 0.1, "unit": 1e-6, "buffers": 1}


def parse_settings(text: str) -> VirtualSettings:
    """Read ``virtual:SCENE`` or ``virtual:SCENE,name=value,...``; see `VirtualSettings`.

    >>> parse_settings("virtual:metal,delay=3,seed=7").delay
    3.0
    """
    scene, *words = text.removeprefix(PREFIX).split(",")
    if not text.startswith(PREFIX) or not scene:
        raise InputError(
            f"a rig of {text!r}",
            hint="write virtual:SCENE, such as virtual:l_objects, or give --projector and --camera",
        )
    kinds: dict[str, Any] = {f.name: f.type for f in fields(VirtualSettings) if f.name != "scene"}
    values: dict[str, float | int] = {}
    for word in words:
        name, _, value = word.partition("=")
        if name not in kinds:
            raise InputError(f"a virtual rig with {word!r}", hint=f"it has {', '.join(kinds)}")
        try:
            values[name] = int(value) if kinds[name] == "int" else float(value)
        except ValueError:
            what = "whole number" if kinds[name] == "int" else "number"
            raise InputError(
                f"a virtual rig with {word!r}", hint=f"give {name} a {what}, {name}=1"
            ) from None
    return replace(VirtualSettings(scene), **values)  # type: ignore[arg-type]
