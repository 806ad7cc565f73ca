"""All that is measured of a rig, as rig.json keeps it: measuring it, and what is outdated."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import RIG, RIG_FORMAT
from lightmatrix.files.reading import read_json
from lightmatrix.files.writing import atomic_file
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.rig.devices.base import set_exposure
from lightmatrix.rig.flicker import Flicker, flicker_has_grown, measure_flicker
from lightmatrix.rig.light_levels import (
    CameraLinearity,
    ExposureAdvice,
    measure_exposure,
    measure_linearity,
    measure_response,
)
from lightmatrix.rig.photograph import (
    FIRST_SETTLE,
    Photographer,
    UntrustedFrameError,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
    take_average,
    take_white_and_black,
)
from lightmatrix.rig.rig import Rig
from lightmatrix.rig.settle import SettleTime, measure_settle

VERSION = 1
# The parts stand in the order of measuring: each needs those before it.
_KINDS: dict[str, Callable[..., Any]] = {
    "settle": SettleTime,
    "flicker": Flicker,
    "exposure": ExposureAdvice,
    "response": ProjectorResponse,
    "linearity": CameraLinearity,
}
PARTS = tuple(_KINDS)
# Facts by which a projector and a camera are recognized, with their settings.
_IDENTITY = ("name", "shape", "refresh", "bits", "pixel_format")


@dataclass(frozen=True)
class RigMeasurements:
    """What is measured of a rig; made by `measure_rig`.

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
        When something was measured last.

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
        """Everything, JSON-ready, as rig.json holds it."""
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
        """Write rig.json; it may replace one of its kind.

        Raises
        ------
        OutputError
            If there is a file of another kind, or the disk fails.
        """
        with atomic_file(path, RIG, overwrite=True) as part:
            part.write_text(json.dumps(self.as_dict(), indent=2) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> RigMeasurements:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, damaged, or of another kind.
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
        """Whether it was measured of this projector and this camera with these settings."""
        return all(
            # Some cameras know their shape only once they have taken a frame.
            None in (known.get(key), info.get(key)) or known[key] == info[key]
            for known, info in (
                (self.projector, _jsonable(rig.projector.info())),
                (self.camera, _jsonable(rig.camera.info())),
            )
            for key in _IDENTITY
        )


def _part(kind: Callable[..., Any], part: Mapping[str, Any]) -> Any:
    """A part from JSON; a TypeError or ValueError if a value is of the wrong type."""
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
    """A device's facts as they are after writing and reading JSON."""
    read: dict[str, Any] = json.loads(json.dumps(info, default=str))
    return read


def measure_rig(
    rig: Rig,
    parts: Sequence[str] = PARTS,
    *,
    keep: str | Path | None = None,
    settle: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> RigMeasurements:
    """Measure a rig, or some of it, and what that needs.

    Parameters
    ----------
    rig : Rig
    parts : sequence of {"settle", "flicker", "exposure", "response", "linearity"}
        What to measure. Other parts that these need come from `keep`, or are measured too.
    keep : str or Path, optional
        File, such as rig.json, of earlier measurements of this rig, which is written anew. One of
        another rig is replaced.
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
        kept = RigMeasurements.load(keep)
        before = kept if kept.of_rig(rig) else before
    known = rig.persistently(lambda: _measured(rig, before, parts, settle, progress))
    if keep is not None:
        known.save(keep)
    return known


def _measured(
    rig: Rig,
    known: RigMeasurements,
    parts: Sequence[str],
    settle: float | None,
    progress: Callable[[str, int, int], None] | None,
) -> RigMeasurements:
    def report(part: str) -> Callable[[int, int], None] | None:
        if progress is None:
            return None
        return lambda done, total: progress(part, done, total)

    whites = find_white_and_black(Photographer(rig, FIRST_SETTLE))
    if settle is not None:
        known = replace(known, settle=SettleTime(settle, 0.0, 0, 0))
    elif "settle" in parts or known.settle is None:
        known = replace(known, settle=measure_settle(rig, whites, report("settle")))
    assert known.settle is not None
    wait = known.settle.seconds
    if "flicker" in parts or ("exposure" in parts and known.flicker is None):
        flicker = measure_flicker(rig, whites, wait, report("flicker"))
        known = replace(known, flicker=flicker)
    period = 0.0 if known.flicker is None else known.flicker.period
    if period:
        # The further parts need white and black at an exposure that does not flicker.
        exposure = set_exposure(rig.camera, max(1, round(whites.exposure / period)) * period)
        whites = take_white_and_black(Photographer(rig, wait), exposure)
    if "exposure" in parts:
        advice = measure_exposure(rig, whites, wait, period)
        known = replace(known, exposure=advice)
    if "response" in parts:
        response = measure_response(rig, whites, wait, report("response"))
        known = replace(known, response=response)
    if "linearity" in parts:
        linearity = measure_linearity(rig, whites, wait, period, report("linearity"))
        known = replace(known, linearity=linearity)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return replace(known, brightness=whites.brightness, measured=now)


def outdated_parts(rig: Rig, known: RigMeasurements) -> list[str]:
    """Names of the parts that no longer hold; `known` has a settle time and exposures."""
    assert known.settle is not None
    # Each look begins anew if the camera is lost: some cameras have memory for a few pictures only.
    whites, parts = rig.persistently(lambda: _changed_levels(rig, known))
    settle, flicker = known.settle.seconds, known.flicker
    if flicker is not None and rig.persistently(
        lambda: flicker_has_grown(rig, whites, settle, flicker)
    ):
        # Exposures are multiples of the period of a flicker.
        parts += [part for part in ("flicker", "exposure") if part not in parts]
    return parts


def _changed_levels(rig: Rig, known: RigMeasurements) -> tuple[WhiteAndBlack, list[str]]:
    """White and black, and the parts that the levels of frames show to be outdated."""
    assert known.settle is not None
    assert known.exposure is not None
    exposure = known.exposure.seconds[-1]
    whites = take_white_and_black(Photographer(rig, FIRST_SETTLE), exposure)
    parts = []
    photographer = Photographer(rig, known.settle.seconds)
    late = 0
    for change in range(6):
        image = plain_images(rig)[change % 2]
        try:
            level = whites.level(photographer.take(image, exposure).data)
        except UntrustedFrameError:
            continue
        late += not abs(level - change % 2) < 0.05
    # Single late images are normal.
    if late > 2:
        parts.append("settle")
    if known.response is not None:
        grey = known.response.grey_for(np.array([0.5]))[0]
        light = float(np.interp(grey, known.response.levels, known.response.light))
        image = np.full_like(plain_images(rig)[0], grey)
        shown = take_average(photographer, image, exposure, 3)
        if abs(whites.level(shown.mean) - light) > 0.03:
            # The projector's curve has changed, or the camera's.
            parts += ["response", "linearity"]
    if abs(whites.brightness / known.brightness - 1) > 0.05:
        # The aperture, the distance, the scene or the lamp has changed.
        parts.append("exposure")
    return whites, parts
