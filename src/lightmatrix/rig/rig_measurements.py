"""All that is measured of a rig, as rig.json keeps it: measuring it, and what is outdated.

The settle time says how long after a picture is shown a photograph of it may begin: black and white
alternate while frames are taken, and the brightness of each frame shows whether its exposure began
before the change was over. Flicker of the lamp or of the room is found in series of short frames.
Exposures and the projector's response follow from levels of averaged frames.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError, InputError
from lightmatrix.files.kinds import RIG, RIG_FORMAT
from lightmatrix.files.reading import read_json
from lightmatrix.files.writing import atomic_file
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.planning.exposure_advice import (
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
)
from lightmatrix.ranges import check_number
from lightmatrix.rig.devices.base import exposure_limits, same_exposure, set_exposure
from lightmatrix.rig.photograph import (
    FIRST_SETTLE,
    Photographer,
    UntrustedFrameError,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
    robust_deviation,
    take_average,
    take_white_and_black,
)
from lightmatrix.rig.rig import Rig, UnfitRigError

# Called with (done, total) while something is measured.
_Report = Callable[[int, int], None]
# Seconds of the frames and their mean levels.
_Series = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class SettleTime:
    """How long to wait between showing and exposing."""

    # From the moment at which the image is shown to the earliest start of an exposure.
    seconds: float
    # The latest start of an exposure, after the same moment, that still saw the change.
    unsettled: float
    # Number of changes between black and white.
    changes: int
    # Number of changes that came much later than the others.
    late: int


def measure_settle(rig: Rig, whites: WhiteAndBlack, report: _Report) -> SettleTime:
    """Find the shortest safe delay between showing a picture and exposing."""
    asked = set_exposure(rig.camera, whites.exposure)
    observer = _Observer(rig, whites)
    looks: list[tuple[float, float]] = []
    # The first four changes are watched for half a second, and give a rough settle time. The
    # further ones are watched only as long as that takes.
    duration, total = 0.5, 21
    for change in range(total):
        if change == 4 and looks:
            duration = 2 * max(first for _, first in looks) + 4 * observer.frame_time
            duration = min(max(duration, 0.15), 0.5)
        look = observer.look(bool(change % 2), duration)
        if not same_exposure(rig.camera.exposure, asked):
            # Another program has changed the exposure.
            set_exposure(rig.camera, asked)
        elif look is not None:
            looks.append(look)
        report(change + 1, total)
    # A quarter of the changes may end without a settled frame, and a seventh may be late or seen by
    # a bad frame without being part of the settle time. Both are well above the 2 % of late images
    # and 4 % of bad frames of a usual rig.
    if len(looks) < 0.75 * total:
        raise UnfitRigError(
            f"after {total - len(looks)} of {total} changes between black and white the picture "
            f"had not settled within {duration:.2f} s",
            hint="is the exposure fixed (no automatic exposure or gain), and the room's light "
            "steady? `lightmatrix rig flicker` measures that. If the picture comes late, state how "
            "long to wait in seconds, settle=1",
        )
    times = np.array(looks)
    last, starts = np.sort(times[:, 0]), times[:, 1]
    ignored = total // 7 - (total - len(looks))
    unsettled = float(last[-1 - max(0, ignored)])
    seconds = float(starts[starts > unsettled].min())
    late = total - len(looks) + int((last > seconds).sum())
    if unsettled > 0.8 * 0.5:
        raise UnfitRigError(
            f"the picture still changes {unsettled:.2f} s after it is shown",
            hint="switch off what delays the picture (compositor, variable refresh, picture "
            "improvement of the projector), or state how long to wait in seconds, settle=1",
        )
    # A frame that saw a little of the change may have counted as settled, and clocks are inaccurate
    # by 2 ms.
    seconds += 0.002 + observer.tolerance * asked
    return SettleTime(round(seconds, 6), unsettled, total, late)


class _Observer:
    """Watches changes between black and white by frames at the exposure of `whites`."""

    def __init__(self, rig: Rig, whites: WhiteAndBlack) -> None:
        self._rig, self._whites = rig, whites
        self._generator = np.random.default_rng(0)
        refresh = float(rig.projector.info().get("refresh") or 60.0)
        self.frame_time = whites.exposure + 1 / refresh
        shown = rig.projector.show(plain_images(rig)[1])
        rig.clock.sleep(shown + FIRST_SETTLE - rig.clock.now())
        rig.camera.flush()
        levels, waits = [], []
        for _ in range(12):
            asked = rig.clock.now()
            rig.camera.trigger()
            with suppress(FrameTimeoutError):
                frame = rig.camera.get_image(rig.patience + 2 * rig.camera.exposure)
                waits.append(rig.clock.now() - asked)
                levels.append(self._whites.level(frame.data))
        # A frame has settled if it is nearer to its end than 3 % of the way from black to white. If
        # the light flickers, four standard deviations are allowed, but never more than 30 %.
        spread = robust_deviation(np.array(levels)) if levels else 0.0
        self.tolerance = min(max(0.03, 4 * spread), 0.3)
        # Seconds after which a frame is lost.
        self._patience = 0.2 + 3 * (float(np.median(waits)) if waits else rig.patience)

    def look(self, dark: bool, duration: float) -> tuple[float, float] | None:
        """Seconds to the last exposure that saw a change and to the next; None if unsettled."""
        rig = self._rig
        black, white = plain_images(rig)
        old, new = (white, black) if dark else (black, white)
        shown = rig.projector.show(old)
        rig.clock.sleep(shown + min(FIRST_SETTLE, duration) - rig.clock.now())
        # The change comes at a random moment of the camera's and the projector's own rhythm.
        rig.clock.sleep(float(self._generator.random()) * 2 * self.frame_time)
        rig.camera.flush()
        shown = rig.projector.show(new)
        starts: list[float] = []
        levels: list[float] = []
        # Even the last frame may be lost, and may come a second late.
        latest = shown + duration + 1 + self._patience
        while rig.clock.now() < latest and (not starts or starts[-1] < duration):
            rig.camera.trigger()
            with suppress(FrameTimeoutError):
                frame = rig.camera.get_image(self._patience)
                starts.append(frame.timestamp - rig.camera.exposure - shown)
                levels.append(self._whites.level(frame.data))
        settled = np.abs(np.array(levels) - (0.0 if dark else 1.0)) < self.tolerance
        if not len(settled) or not settled[-1]:
            return None
        unsettled = np.flatnonzero(~settled)
        times = np.array(starts)
        last = float(times[unsettled[-1]]) if len(unsettled) else -np.inf
        return max(last, 0.0), float(times[times > last].min())


@dataclass(frozen=True)
class Flicker:
    """Light that varies although the picture stays."""

    # Amplitude of the projector's light, as a share of it; 0 if none was noticed.
    amplitude: float
    # Hz, one of those that were tried; 0 if none was noticed.
    frequency: float
    # Standard deviation of the brightness of short frames, as a share of it.
    spread: float
    # Standard deviation of the black frames' mean, as a share of white.
    room: float

    @property
    def noticed(self) -> bool:
        """Whether the projector's light flickers."""
        return self.amplitude > 0

    @property
    def period(self) -> float:
        """Seconds that exposures should be a multiple of; 0 if nothing flickers."""
        return 1 / self.frequency if self.frequency else 0.0


def measure_flicker(rig: Rig, whites: WhiteAndBlack, settle: float, report: _Report) -> Flicker:
    """Photograph a white and a black picture many times, at a short exposure.

    The frequencies that are tried are those of lamps on the mains (100 and 120 Hz), the projector's
    refresh, and twice that. One that the camera's own rhythm hides does no harm in its frames.
    """
    exposure, (times, bright), (_, dark) = _short_frames(rig, whites, settle, 48, report)
    level = float(np.median(bright) - np.median(dark))
    refresh = float(rig.projector.info().get("refresh") or 60.0)
    amplitude, frequency = 0.0, 0.0
    for candidate in dict.fromkeys((100.0, 120.0, refresh, 2 * refresh)):
        wave, error = _wave(times - exposure / 2, bright / level, candidate)
        # The exposure averages the wave.
        wave /= max(abs(float(np.sinc(candidate * exposure))), 0.05)
        # Five virtual rigs without flicker show none above 0.4 % and four standard errors. If two
        # frequencies fit, the one tried first wins.
        if wave > max(0.004, 4 * error, 1.1 * amplitude):
            amplitude, frequency = wave, candidate
    return Flicker(amplitude, frequency, float(bright.std()) / level, float(dark.std()) / level)


def _short_frames(
    rig: Rig, whites: WhiteAndBlack, settle: float, count: int, report: _Report
) -> tuple[float, _Series, _Series]:
    """An exposure that is short for light on the mains, and series of white and of black frames."""
    camera, total, lit = rig.camera, 2 * count, whites.lit
    exposure = set_exposure(camera, min(0.002, whites.exposure))
    series = []
    for number, image in enumerate(reversed(plain_images(rig))):
        shown = rig.projector.show(image)
        # After 0.3 s more even a late image is shown.
        rig.clock.sleep(shown + settle + 0.3 - rig.clock.now())
        camera.flush()
        # A second try is for another program that changes the exposure.
        for _ in range(2):
            generator = np.random.default_rng(0)
            times: list[float] = []
            levels: list[float] = []
            for _ in range(total):
                # At regular moments a triggered camera could keep step with the light, whose period
                # is about 12 ms.
                rig.clock.sleep(float(generator.random()) * 0.012)
                camera.trigger()
                try:
                    frame = camera.get_image(rig.patience)
                except FrameTimeoutError:
                    continue
                if not times or frame.timestamp > times[-1]:
                    times.append(frame.timestamp)
                    levels.append(float(np.asarray(frame.data, np.float64)[lit].mean()))
                    report(number * count + len(times), total)
                if len(times) == count:
                    break
            if same_exposure(camera.exposure, exposure):
                break
            set_exposure(camera, exposure)
        series.append((np.array(times), np.array(levels)))
    return exposure, series[0], series[1]


def _wave(
    times: NDArray[np.float64], light: NDArray[np.float64], frequency: float
) -> tuple[float, float]:
    """Amplitude of a frequency in a series, and its standard error."""
    phase = 2 * np.pi * frequency * (times - times[0])
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
    spread = basis[:, :2] - basis[:, :2].mean(axis=0)
    # The camera's own rhythm may hide a frequency.
    if np.linalg.svd(spread, compute_uv=False)[-1] < 0.15 * np.sqrt(len(times)):
        return 0.0, 0.0
    waves, *_ = np.linalg.lstsq(basis, light, rcond=None)
    rest = light - basis @ waves
    error = float(np.sqrt((rest**2).sum() / max(1, len(times) - 3) * 2 / len(times)))
    return float(np.hypot(*waves[:2])), error


@dataclass(frozen=True)
class ExposureAdvice:
    """How to expose a rig's frames."""

    # From the longest to the shortest, in equal shares of the frames.
    seconds: tuple[float, ...]
    # Share of projector pixels to light in random patterns.
    density: float
    # Share of the samples that will clip at each exposure.
    clipped: tuple[float, ...]
    # Standard deviation of a sample, as a share of the clip level.
    noise: float
    # Raw level without any light.
    pedestal: float
    # Seconds that each exposure is a multiple of, where something flickers; 0 for none.
    period: float = 0.0
    # What the camera cannot do.
    warnings: tuple[str, ...] = ()


def measure_exposure(
    rig: Rig, whites: WhiteAndBlack, settle: float, period: float
) -> ExposureAdvice:
    """Advise the exposures of a rig from a white picture, as `plan` does from a photograph."""
    limits = exposure_limits(rig.camera)
    top = whites.white.clip_level
    # The level without any light is that of black frames without the room's light. A black frame at
    # an eighth of the exposure separates both. A camera that cannot expose for so short a time
    # gives the level of black frames.
    black = whites.black.without_noise
    level: NDArray[np.floating] = black
    brief = max(limits[0], whites.exposure / 8)
    if brief <= 0.6 * whites.exposure:
        dark = take_average(Photographer(rig, settle), plain_images(rig)[0], brief, 3)
        share = dark.exposure / whites.exposure
        level = (dark.without_noise - share * black) / (1 - share)
    pedestal = max(0.0, float(np.median(level)))
    levels = whites.light.ravel().astype(np.float64) / (top - pedestal) / whites.exposure
    # Noise takes the mean of clipped frames slightly below the clip level.
    clipped = (whites.white.mean >= 0.995 * top).ravel()
    frame = WhiteFrame(levels, clipped)
    noise = max(whites.white.noise, whites.black.noise) / top
    advised = advise_exposures(frame, noise)
    possible, warnings = [], []
    for exposure, _ in advised:
        seconds, concerns = _possible(exposure, period, limits)
        possible.append(seconds)
        warnings += concerns
    seconds_used = tuple(sorted(set(possible), reverse=True))
    return ExposureAdvice(
        seconds_used,
        advise_density(frame, advised),
        tuple(clipped_share(frame, exposure) for exposure in seconds_used),
        noise,
        pedestal,
        period,
        tuple(warnings),
    )


def _possible(
    exposure: float, period: float, limits: tuple[float, float]
) -> tuple[float, list[str]]:
    """The exposure nearest to an advised one that does not flicker and that the camera has."""
    shortest, longest = limits
    # These say where it is off by a stop, or by a fifth to avoid flicker: less is within the
    # tolerance of the advice.
    warnings = []
    steady = exposure
    if period:
        steady = max(1, math.floor(exposure / period + 1e-6)) * period
        if steady > 1.2 * exposure:
            warnings.append(
                f"an exposure of {exposure:.3g} s would flicker; {steady:.3g} s clips more: "
                "close the aperture"
            )
    if steady > 2 * longest:
        warnings.append(f"the camera exposes for {longest:g} s at most, not {steady:.3g} s")
    if 2 * steady < shortest:
        warnings.append(
            f"the camera exposes for {shortest:g} s at least, not {steady:.3g} s: close the "
            "aperture"
        )
    return min(max(steady, shortest), longest), warnings


def measure_response(
    rig: Rig, whites: WhiteAndBlack, settle: float, report: _Report
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value."""
    photographer = Photographer(rig, settle)
    # A smooth curve is known between 17 grey values.
    levels = np.rint(np.linspace(0, 255, 17)).astype(int)
    light = np.empty(len(levels))
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        light[k] = whites.level(take_average(photographer, image, whites.exposure, 3).mean)
        report(k + 1, len(levels))
    return ProjectorResponse.of_light(levels, light)


VERSION = 1
# The parts stand in the order of measuring: each needs those before it.
_KINDS: dict[str, Callable[..., Any]] = {
    "settle": SettleTime,
    "flicker": Flicker,
    "exposure": ExposureAdvice,
    "response": ProjectorResponse,
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
    values: dict[str, Any] = {}
    for item in fields(kind):  # type: ignore[arg-type]
        value, wanted = part[item.name], str(item.type)
        one = str if "str" in wanted else int if "int" in wanted else float
        several = wanted.startswith("tuple")
        for each in value if several else (value,):
            if type(each) not in (int, one):
                raise TypeError(f"{each!r} is no {one.__name__}")
        values[item.name] = tuple(map(one, value)) if several else one(value)
    return kind(**values)


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
    parts : sequence of {"settle", "flicker", "exposure", "response"}
        What to measure. Other parts that these need come from `keep`, or are measured too.
    keep : str or Path, optional
        File, such as rig.json, of earlier measurements of this rig, which is written anew. One of
        another rig is replaced.
    settle : float, optional
        Seconds to wait after a picture is shown, instead of measuring them.
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
    if settle is not None:
        check_number("a settle time", settle, most=60, hint="give seconds, such as 0.1")
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
    def report(part: str) -> _Report:
        return lambda done, total: None if progress is None else progress(part, done, total)

    if settle is None:
        first = FIRST_SETTLE if known.settle is None else known.settle.seconds
    else:
        first = settle
    whites = find_white_and_black(Photographer(rig, max(FIRST_SETTLE, first)))
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
        known = replace(known, exposure=measure_exposure(rig, whites, wait, period))
    if "response" in parts:
        response = measure_response(rig, whites, wait, report("response"))
        known = replace(known, response=response)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    return replace(known, brightness=whites.brightness, measured=now)


def outdated_parts(rig: Rig, known: RigMeasurements) -> list[str]:
    """Names of the parts that no longer hold; `known` has a settle time and exposures."""
    assert known.settle is not None
    # Each look begins anew if the camera is lost: some cameras have memory for a few pictures only.
    whites, parts = rig.persistently(lambda: _changed_levels(rig, known))
    settle, flicker = known.settle.seconds, known.flicker
    if flicker is not None:
        _, (_, bright), (_, dark) = rig.persistently(
            lambda: _short_frames(rig, whites, settle, 7, lambda done, total: None)
        )
        level = float(np.median(bright) - np.median(dark))
        lamp, room = robust_deviation(bright) / level, robust_deviation(dark) / level
        if lamp > 2 * flicker.spread + 0.01 or room > 2 * flicker.room + 0.01:
            # Exposures are multiples of the period of a flicker.
            parts += [part for part in ("flicker", "exposure") if part not in parts]
    return parts


def _changed_levels(rig: Rig, known: RigMeasurements) -> tuple[WhiteAndBlack, list[str]]:
    """White and black, and the parts that the levels of frames show to be outdated."""
    assert known.settle is not None
    assert known.exposure is not None
    exposure = known.exposure.seconds[-1]
    waiting = Photographer(rig, max(FIRST_SETTLE, known.settle.seconds))
    whites = take_white_and_black(waiting, exposure)
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
            parts.append("response")
    if abs(whites.brightness / known.brightness - 1) > 0.05:
        # The aperture, the distance, the scene or the lamp has changed.
        parts.append("exposure")
    return whites, parts
