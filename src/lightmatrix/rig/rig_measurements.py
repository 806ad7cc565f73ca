"""All that is measured of a rig, as rig.json keeps it.

The settle time says how long after a picture is shown a photograph of it may begin: black and white
alternate while frames are taken, and the brightness of each frame shows whether its exposure began
before the change was over. Flicker of the lamp or of the room is found in series of short frames.
Exposures and the projector's response follow from levels of averaged frames.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.exposures import share_of_white
from lightmatrix.check.survey import robust_deviation
from lightmatrix.errors import FrameTimeoutError, InputError
from lightmatrix.files.kinds import RIG, RIG_FORMAT
from lightmatrix.files.reading import read_json
from lightmatrix.files.writing import atomic_file
from lightmatrix.paths import as_path
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.planning.exposure_advice import (
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
)
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_number
from lightmatrix.rig.devices.base import exposure_limits, same_exposure, set_exposure
from lightmatrix.rig.photograph import (
    FIRST_SETTLE,
    Photographer,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
    take_average,
    take_white_and_black,
)
from lightmatrix.rig.rig import Rig, UnfitRigError


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


def measure_settle(rig: Rig, whites: WhiteAndBlack, report: Progress) -> SettleTime:
    """Find the shortest safe delay between showing a picture and exposing."""
    asked = set_exposure(rig.camera, whites.exposure)
    frame_time = whites.exposure + 1 / float(rig.projector.info().get("refresh") or 60.0)
    pictures = plain_images(rig)
    shown = rig.projector.show(pictures[1])
    levels = [level for _, level in _watch(rig, whites, shown + FIRST_SETTLE, 12 * frame_time)]
    # A frame has settled if it is nearer to its end than 3 % of the way from black to white. If the
    # light flickers, four standard deviations are allowed, but never more than 30 %.
    spread = robust_deviation(np.array(levels)) if levels else 0.0
    tolerance = min(max(0.03, 4 * spread), 0.3)
    generator = np.random.default_rng(0)
    # Each entry holds the seconds from a change to the start of the last frame that saw it, and to
    # that of the next frame.
    looks: list[tuple[float, float]] = []
    total = 21
    for change in range(total):
        # The change comes at a random moment of the camera's and the projector's own rhythm.
        rig.clock.sleep(float(generator.random()) * 2 * frame_time)
        shown = rig.projector.show(pictures[change % 2])
        seen = np.array(_watch(rig, whites, shown, _WATCHED))
        if not same_exposure(rig.camera.exposure, asked):
            # Another program has changed the exposure.
            set_exposure(rig.camera, asked)
        elif len(seen):
            starts, settled = seen[:, 0] - shown, abs(seen[:, 1] - change % 2) < tolerance
            latest = float(max(starts[~settled], default=-np.inf))
            if settled[-1]:
                looks.append((latest, float(starts[starts > latest].min())))
        report(change + 1, total)
    # A quarter of the changes may end without a settled frame, and a seventh may be late or seen by
    # a bad frame without being part of the settle time. Both are well above the 2 % of late images
    # and 4 % of bad frames of a usual rig.
    if len(looks) < 0.75 * total:
        raise UnfitRigError(
            f"after {total - len(looks)} of {total} changes between black and white the picture "
            f"had not settled within {_WATCHED:g} s",
            hint="is the exposure fixed (no automatic exposure or gain), and the room's light "
            "steady? `lightmatrix rig flicker` measures that. If the picture comes late, state how "
            "long to wait in seconds, settle=1",
        )
    last, starts = np.sort(np.array(looks)[:, 0]), np.array(looks)[:, 1]
    ignored = total // 7 - (total - len(looks))
    unsettled = float(last[-1 - max(0, ignored)])
    seconds = max(0.0, float(starts[starts > unsettled].min()))
    late = total - len(looks) + int((last > seconds).sum())
    if unsettled > 0.8 * _WATCHED:
        raise UnfitRigError(
            f"the picture still changes {unsettled:.2f} s after it is shown",
            hint="switch off what delays the picture (compositor, variable refresh, picture "
            "improvement of the projector), or state how long to wait in seconds, settle=1",
        )
    # A frame that saw a little of the change may have counted as settled, and clocks are inaccurate
    # by 2 ms.
    seconds = round(seconds + 0.002 + tolerance * asked, 6)
    return SettleTime(seconds, max(0.0, unsettled), total, late)


# Seconds for which frames are taken after a change between black and white.
_WATCHED = 0.5


def _watch(
    rig: Rig, whites: WhiteAndBlack, since: float, seconds: float
) -> list[tuple[float, float]]:
    """Starts of the exposures from a time on, for some seconds, and levels from black to white."""
    rig.clock.sleep(since - rig.clock.now())
    rig.camera.flush()
    seen: list[tuple[float, float]] = []
    # Even the last frame may be lost, and may come late.
    latest = since + seconds + 1 + rig.camera.patience
    while rig.clock.now() < latest and (not seen or seen[-1][0] < since + seconds):
        rig.camera.trigger()
        with suppress(FrameTimeoutError):
            frame = rig.camera.get_image(rig.camera.patience)
            seen.append((frame.timestamp - rig.camera.exposure, whites.level(frame.data)))
    return seen


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
    def period(self) -> float:
        """Seconds that exposures should be a multiple of; 0 if nothing flickers."""
        return 1 / self.frequency if self.frequency else 0.0


def measure_flicker(rig: Rig, whites: WhiteAndBlack, settle: float, report: Progress) -> Flicker:
    """Photograph a white and a black picture many times, at a short exposure.

    The frequencies that are tried are those of lamps on the mains (100 and 120 Hz), the projector's
    refresh, and twice that. One that the camera's own rhythm hides does no harm in its frames.
    """
    camera, count, lit = rig.camera, 48, whites.lit
    exposure = set_exposure(camera, min(0.002, whites.exposure))
    series = []
    for number, image in enumerate(reversed(plain_images(rig))):
        shown = rig.projector.show(image)
        # After 0.3 s more even a late image is shown.
        rig.clock.sleep(shown + settle + 0.3 - rig.clock.now())
        camera.flush()
        generator, seen = np.random.default_rng(0), dict[float, float]()
        for _ in range(3 * count):
            # At regular moments a triggered camera could keep step with the light, whose period is
            # about 12 ms.
            rig.clock.sleep(float(generator.random()) * 0.012)
            camera.trigger()
            with suppress(FrameTimeoutError):
                frame = camera.get_image(camera.patience)
                seen[frame.timestamp] = float(frame.data[lit].mean(dtype=np.float64))
            if not same_exposure(camera.exposure, exposure):
                # Another program has changed it.
                set_exposure(camera, exposure)
                seen.clear()
            report(number * count + len(seen), 2 * count)
            if len(seen) == count:
                break
        series.append((np.array([*seen]), np.array([*seen.values()])))
    (times, bright), (_, dark) = series
    level = float(np.median(bright) - np.median(dark))
    refresh = float(rig.projector.info().get("refresh") or 60.0)
    amplitude, frequency, light = 0.0, 0.0, bright / level
    for candidate in dict.fromkeys((100.0, 120.0, refresh, 2 * refresh)):
        phase = 2 * np.pi * candidate * (times - times[0])
        basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
        apart = basis[:, :2] - basis[:, :2].mean(axis=0)
        # The camera's own rhythm may hide a frequency.
        if np.linalg.svd(apart, compute_uv=False)[-1] < 0.15 * np.sqrt(len(times)):
            continue
        waves, *_ = np.linalg.lstsq(basis, light, rcond=None)
        # Amplitude and its standard error. The exposure averages the wave.
        rest = ((light - basis @ waves) ** 2).sum()
        error = float(np.sqrt(rest / max(1, len(times) - 3) * 2 / len(times)))
        wave = float(np.hypot(*waves[:2])) / max(abs(float(np.sinc(candidate * exposure))), 0.05)
        # Five virtual rigs without flicker show none above 0.4 % and four standard errors. If two
        # frequencies fit, the one tried first wins.
        if wave > max(0.004, 4 * error, 1.1 * amplitude):
            amplitude, frequency = wave, candidate
    return Flicker(amplitude, frequency, float(bright.std()) / level, float(dark.std()) / level)


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
    shortest, longest = limits
    possible, warnings = set[float](), []
    for exposure, _ in advised:
        # One that does not flicker, and that the camera has.
        steady = max(1, math.floor(exposure / period + 1e-6)) * period if period else exposure
        seconds = min(max(steady, shortest), longest)
        possible.add(seconds)
        # A stop, or a fifth to avoid flicker, is within the tolerance of the advice.
        if not 0.5 < seconds / exposure < (1.2 if steady > exposure else 2):
            warnings.append(
                f"an exposure of {exposure:.3g} s is advised, and the nearest that the camera has "
                f"and that does not flicker is {seconds:.3g} s: change the aperture"
            )
    seconds_used = tuple(sorted(possible, reverse=True))
    return ExposureAdvice(
        seconds_used, advise_density(frame, advised),
        tuple(clipped_share(frame, exposure) for exposure in seconds_used), noise, pedestal, period,
        tuple(warnings),
    )  # fmt: skip


def measure_response(
    rig: Rig, whites: WhiteAndBlack, settle: float, report: Progress, camera: Response
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value, by a camera's response."""
    photographer = Photographer(rig, settle)
    # A smooth curve is known between 17 grey values.
    levels = np.rint(np.linspace(0, 255, 17)).astype(int)
    light, ends = np.empty(len(levels)), (whites.white, whites.black)
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        frames = take_average(photographer, image, whites.exposure, 3), *ends
        seen, white, black = (camera.linearise(each.mean / each.clip_level) for each in frames)
        light[k] = share_of_white(seen, white, black, whites.lit)
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

    def as_dict(self) -> dict[str, Any]:
        """Everything, JSON-ready, as rig.json holds it."""
        return {"format": RIG_FORMAT, "version": VERSION, **asdict(self)}

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
    def load(cls, path: str | Path) -> "RigMeasurements":
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
                name: kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in part.items()})
                for name, kind in _KINDS.items()
                if (part := content[name]) is not None
            }
            return cls(dict(content["projector"]), dict(content["camera"]), **parts)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            hint = "remove it; the rig is measured again"
            raise InputError(f"{file}: is damaged ({error})", hint=hint) from error

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
    response: str = "linear",
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
    response : str
        The camera's response, by which the projector's is measured; see `Response.parse`.
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
        hint = f"use {', '.join(PARTS)}"
        raise InputError(f"nothing is known of measuring {unknown[0]!r}", hint=hint)
    if settle is not None:
        check_number("a settle time", settle, most=60, hint="give seconds, such as 0.1")
    before, camera = kept_measurements(rig, keep), Response.parse(response)

    def report(part: str) -> Progress:
        return lambda done, total: None if progress is None else progress(part, done, total)

    def measured() -> RigMeasurements:
        known, first = before, settle
        if first is None:
            first = FIRST_SETTLE if known.settle is None else known.settle.seconds
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
            curve = measure_response(rig, whites, wait, report("response"), camera)
            known = replace(known, response=curve)
        return known

    known = rig.persistently(measured)
    if keep is not None:
        known.save(keep)
    return known


def kept_measurements(rig: Rig, keep: str | Path | None) -> RigMeasurements:
    """What a file holds of this rig; nothing but the names of its devices if it is of another."""
    if keep is not None and as_path(keep).exists():
        kept = RigMeasurements.load(keep)
        if kept.of_rig(rig):
            return kept
    return RigMeasurements(_jsonable(rig.projector.info()), _jsonable(rig.camera.info()))
