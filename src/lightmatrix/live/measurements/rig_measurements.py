"""What was measured of a rig, kept as rig.json, measured again where it no longer holds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.files.headers import read_json
from lightmatrix.live.devices.exposures import set_exposure
from lightmatrix.live.frames.photograph import Taker, UntrustedFrameError
from lightmatrix.live.frames.repeats import take_steady
from lightmatrix.live.measurements.exposure import ExposureAdvice, measure_exposure
from lightmatrix.live.measurements.flicker import Flicker, flickers_anew, measure_flicker
from lightmatrix.live.measurements.linearity import CameraLinearity, measure_linearity
from lightmatrix.live.measurements.response import measure_response
from lightmatrix.live.measurements.settle import SettleTime, measure_settle
from lightmatrix.live.measurements.white import FIRST_SETTLE, Whites, find_white, images
from lightmatrix.live.rig import Rig
from lightmatrix.outputs.kinds import RIG, RIG_FORMAT
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.patterns.projector_curve import ProjectorResponse

VERSION = 1
# In the order in which each can use those before it.
PARTS = ("settle", "flicker", "exposure", "response", "linearity")
# Of the brightness: exposures are measured again beyond.
_SAME_LIGHT = 0.05
# Of white, from black: a grey value off by more has another light than it had.
_SAME_GREY = 0.03
# Black and white in turn, that a settle time is checked by; how many may be late; how near.
_TURNS, _MAY_FAIL, _NEAR = 6, 2, 0.05

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RigMeasurements:
    """What is known of a rig; made by `measure_rig`.

    Parameters
    ----------
    projector, camera : mapping
        Their `info()`.
    settle : SettleTime, optional
    flicker : Flicker, optional
    exposure : ExposureAdvice, optional
    response : ProjectorResponse, optional
    linearity : CameraLinearity, optional
    brightness : float
        Mean light of white over black a second, as a share of the clip level.
    measured : str
        When anything was measured last.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,delay=2,real=0") as rig:
    ...     known = lm.measure_rig(rig, ["settle"])
    >>> 0.03 < known.settle.seconds < 0.05, known.response is None
    (True, True)
    """

    projector: Mapping[str, Any]
    camera: Mapping[str, Any]
    settle: SettleTime | None = None
    flicker: Flicker | None = None
    exposure: ExposureAdvice | None = None
    response: ProjectorResponse | None = None
    linearity: CameraLinearity | None = None
    brightness: float = 0.0
    measured: str = ""

    def as_dict(self) -> dict[str, Any]:
        """All of it, JSON-ready: what rig.json holds."""
        parts = {name: getattr(self, name) for name in PARTS}
        return {
            "format": RIG_FORMAT,
            "version": VERSION,
            "projector": dict(self.projector),
            "camera": dict(self.camera),
            **{name: None if part is None else asdict(part) for name, part in parts.items()},
            "brightness": self.brightness,
            "measured": self.measured,
        }

    def save(self, path: str | Path) -> None:
        """Write it as a file, in place of one of its kind.

        Raises
        ------
        OutputError
            If there is another file, or the disk fails.
        """
        with atomic_file(path, RIG, overwrite=True) as part:
            part.write_text(json.dumps(self.as_dict(), indent=2) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> RigMeasurements:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            On a file that is missing, damaged, or something else.
        """
        file = Path(path)
        content = read_json(file, RIG_FORMAT, VERSION)
        try:
            parts = {
                name: None if content[name] is None else _part(kind, content[name])
                for name, kind in _KINDS.items()
            }
            return cls(
                dict(content["projector"]),
                dict(content["camera"]),
                **parts,
                brightness=float(content["brightness"]),
                measured=str(content["measured"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{file}: is damaged ({error})", hint="remove it; the rig is measured again"
            ) from error

    def of_rig(self, rig: Rig) -> bool:
        """Whether it is of this projector and this camera, as they are set."""
        return all(
            # Some know their shape only once they have seen a frame.
            None in (known.get(key), info.get(key)) or known[key] == info[key]
            for known, info in (
                (self.projector, _jsonable(rig.projector.info())),
                (self.camera, _jsonable(rig.camera.info())),
            )
            for key in ("name", "shape", "refresh", "bits", "pixel_format")
        )


_KINDS: dict[str, Callable[..., Any]] = {
    "settle": SettleTime,
    "flicker": Flicker,
    "exposure": ExposureAdvice,
    "response": ProjectorResponse,
    "linearity": CameraLinearity,
}


def _part(kind: Callable[..., Any], part: Mapping[str, Any]) -> Any:
    """A part read back, each value of its own kind; a TypeError or ValueError if it is none."""
    values = {}
    for item in fields(kind):  # type: ignore[arg-type]
        value, wanted = part[item.name], str(item.type)
        if wanted.startswith("tuple"):
            values[item.name] = tuple(_value(one, wanted) for one in value)
        else:
            values[item.name] = _value(value, wanted)
    return kind(**values)


def _value(value: Any, wanted: str) -> Any:
    kind = str if "str" in wanted else int if "int" in wanted else float
    if type(value) not in (int, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return kind(value)


def _jsonable(info: Mapping[str, Any]) -> dict[str, Any]:
    """What a device says of itself, as a file keeps it."""
    read: dict[str, Any] = json.loads(json.dumps(info, default=str))
    return read


def measure_rig(
    rig: Rig,
    parts: Sequence[str] = PARTS,
    *,
    keep: str | Path | None = None,
    settle: float | None = None,
    progress: Progress | None = None,
) -> RigMeasurements:
    """Measure a rig, or some of it, and what that needs.

    Parameters
    ----------
    rig : Rig
    parts : sequence of {"settle", "flicker", "exposure", "response", "linearity"}
        What to measure. What these need is taken from `keep` if it is there, or measured too.
    keep : str or Path, optional
        File, such as rig.json, that holds what is known already of this rig and is written anew;
        one of another rig is replaced.
    settle : float, optional
        Seconds to wait, instead of measuring them.
    progress : callable, optional
        Called with (part, done, total).

    Returns
    -------
    RigMeasurements

    Raises
    ------
    InputError
        On unknown parts, or a damaged file.
    DeviceError
        If the camera does not see the projector, or is lost.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
    ...     known = lm.measure_rig(rig, ["response"], keep="rig.json")
    >>> round(known.response.gamma, 1), lm.RigMeasurements.load("rig.json") == known
    (2.2, True)
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise InputError(
            f"nothing is known of measuring {unknown[0]!r}", hint=f"use {', '.join(PARTS)}"
        )
    before = RigMeasurements(_jsonable(rig.projector.info()), _jsonable(rig.camera.info()))
    if keep is not None and Path(keep).exists():
        found = RigMeasurements.load(keep)
        before = found if found.of_rig(rig) else before
    known = rig.persistently(lambda: _measured(rig, before, parts, settle, progress))
    if keep is not None:
        known.save(keep)
    return known


def _measured(
    rig: Rig,
    known: RigMeasurements,
    parts: Sequence[str],
    settle: float | None,
    progress: Progress | None,
) -> RigMeasurements:
    def tell(part: str) -> Callable[[int, int], None] | None:
        if progress is None:
            return None
        return lambda done, total: progress(part, done, total)

    whites = find_white(Taker(rig, FIRST_SETTLE))
    if settle is not None:
        known = replace(known, settle=SettleTime(settle, 0.0, 0, 0))
    elif "settle" in parts or known.settle is None:
        measured = measure_settle(rig, whites=whites, progress=tell("settle"))
        known = replace(known, settle=measured)
    assert known.settle is not None
    wait = known.settle.seconds
    if "flicker" in parts or ("exposure" in parts and known.flicker is None):
        flicker = measure_flicker(rig, settle=wait, whites=whites, progress=tell("flicker"))
        known = replace(known, flicker=flicker)
    period = 0.0 if known.flicker is None else known.flicker.period
    if period:
        # White and black as frames will be that do not flicker.
        exposure = max(1, round(whites.exposure / period)) * period
        whites = _whites(Taker(rig, wait), set_exposure(rig.camera, exposure))
    if "exposure" in parts:
        advice = measure_exposure(rig, settle=wait, period=period, whites=whites)
        known = replace(known, exposure=advice)
    if "response" in parts:
        response = measure_response(rig, settle=wait, whites=whites, progress=tell("response"))
        known = replace(known, response=response)
    if "linearity" in parts:
        linearity = measure_linearity(
            rig, settle=wait, period=period, whites=whites, progress=tell("linearity")
        )
        known = replace(known, linearity=linearity)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return replace(known, brightness=_brightness(whites), measured=now)


def _whites(taker: Taker, exposure: float) -> Whites:
    black, white = images(taker.rig)
    return Whites(take_steady(taker, white, exposure, 3), take_steady(taker, black, exposure, 3))


def _brightness(whites: Whites) -> float:
    return float(whites.light.mean()) / whites.white.clip_level / whites.exposure


def outdated(rig: Rig, known: RigMeasurements) -> list[str]:
    """The parts of a calibration that no longer hold, by a short look at the rig.

    Parameters
    ----------
    rig : Rig
    known : RigMeasurements
        With settle time and exposures.

    Returns
    -------
    list of str
        Of `PARTS`.

    Raises
    ------
    DeviceError
        If the camera does not see the projector, or is lost.
    """
    # Two looks, each begun again if the camera is lost: some have room for a few pictures only.
    whites, found = rig.persistently(lambda: _changed_levels(rig, known))
    assert known.settle is not None
    settle, flicker = known.settle.seconds, known.flicker
    if flicker is not None and rig.persistently(
        lambda: flickers_anew(rig, flicker, settle=settle, whites=whites)
    ):
        # Exposures are multiples of its period.
        found += [part for part in ("flicker", "exposure") if part not in found]
    return found


def _changed_levels(rig: Rig, known: RigMeasurements) -> tuple[Whites, list[str]]:
    """White and black, and the parts that levels of frames say are outdated."""
    assert known.settle is not None
    assert known.exposure is not None
    exposure = known.exposure.seconds[-1]
    whites = _whites(Taker(rig, FIRST_SETTLE), exposure)
    found = []
    taker = Taker(rig, known.settle.seconds)
    failed = 0
    for turn in range(_TURNS):
        image = images(rig)[turn % 2]
        try:
            level = whites.level(taker.take(image, exposure).data)
        except UntrustedFrameError:
            continue
        failed += not abs(level - turn % 2) < _NEAR
    if failed > _MAY_FAIL:
        found.append("settle")
    if known.response is not None:
        grey = known.response.grey_for(np.array([0.5]))[0]
        light = float(np.interp(grey, known.response.levels, known.response.light))
        shown = take_steady(taker, np.full_like(images(rig)[0], grey), exposure, 3)
        if abs(whites.level(shown.mean) - light) > _SAME_GREY:
            # The projector's curve is another, or the camera's.
            found += ["response", "linearity"]
    if abs(_brightness(whites) / known.brightness - 1) > _SAME_LIGHT:
        # Another lens opening, distance, scene, or lamp.
        found.append("exposure")
    return whites, found
