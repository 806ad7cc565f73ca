"""A whole capture by a rig: measure it, photograph the patterns, and write the capture folder."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import curve_file
from lightmatrix.camera.exposure_sequence import exposure_sequence
from lightmatrix.capture.capture import Capture
from lightmatrix.errors import DeviceError, warn
from lightmatrix.estimators.estimate import estimate
from lightmatrix.live.capture_settings import CaptureSettings
from lightmatrix.live.frames.drift import Drift, measure_drift
from lightmatrix.live.frames.photograph import Photographer
from lightmatrix.live.frames.same_light import References
from lightmatrix.live.measurements.outdated import outdated_parts
from lightmatrix.live.measurements.references import take_references
from lightmatrix.live.measurements.rig_measurements import PARTS, RigMeasurements, measure_rig
from lightmatrix.live.projected_patterns import ProjectedPatterns
from lightmatrix.live.record import CaptureFacts, CaptureRecord
from lightmatrix.live.rig import Rig
from lightmatrix.live.session import Session, Step
from lightmatrix.live.until import Outcome, Until, parse_until
from lightmatrix.outputs.kinds import LIVE_CAPTURE
from lightmatrix.outputs.writing import claimed
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.transport.matrix import LightTransport

USUAL_COUNT = 64
RIG_FILE = "rig.json"
# A warning says that the room's light varies by more than this share of white.
_ROOM = 0.02
# Names of the reference frames in the record.
_BLACK, _WHITE = "black.npy", "white.npy"


def take_capture(
    output: str | Path,
    rig: Rig,
    patterns: PatternSet | str | Path | None = None,
    *,
    count: int = USUAL_COUNT,
    density: float | None = None,
    seed: int = 0,
    settings: CaptureSettings | None = None,
    keep: str | Path | None = RIG_FILE,
    overwrite: bool = False,
    progress: Callable[[Step], None] | None = None,
    measuring: Callable[[str, int, int], None] | None = None,
) -> Capture:
    """Photograph a scene under patterns with a rig.

    Frames are written to ``<output>.partial`` as they come. If a run is stopped, however that
    happens, the same call goes on there.

    Parameters
    ----------
    output : str or Path
        The capture folder to make.
    rig : Rig
        See `open_rig`.
    patterns : PatternSet, str or Path, optional
        The patterns or a folder of them. None: a random mix of fine and coarse ones.
    count : int
        Number of random patterns; with `CaptureSettings.until` the most that are photographed.
    density : float, optional
        Share of lit pixels of random patterns. None: as the exposures advise.
    seed : int
        Seed of random patterns.
    settings : CaptureSettings, optional
        How they are photographed. None: the defaults.
    keep : str or Path, optional
        File of the rig's measurements. They are checked by a short look, and what is outdated or
        missing is measured and written. None: everything is measured, and nothing kept.
    overwrite : bool
        Whether an existing capture may be replaced, and frames of another one discarded.
    progress : callable, optional
        Called with a `Step` after each frame.
    measuring : callable, optional
        Called with (part, done, total) while the rig is measured.

    Returns
    -------
    Capture
        Its provenance says how it was taken; patterns without a frame are left out.

    Raises
    ------
    InputError
        If patterns do not fit, or numbers are out of range.
    DeviceError
        If a device is lost, the camera does not see the projector, or several patterns in a row
        cannot be photographed.
    OutputError
        If the output exists, frames of another capture are in its place, or the disk fails.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
    ...     capture = lm.take_capture("capture", rig, count=24, keep=None)
    >>> capture.count, capture.camera_shape
    (24, (16, 16))
    """
    settings = settings or CaptureSettings()
    settings.check_rig(rig)
    screen, cell = rig.projector.shape, settings.cell
    if isinstance(patterns, str | Path):
        patterns = read_patterns(Path(patterns))
    if patterns is not None:
        # Patterns that do not fit are refused before anything is measured.
        ProjectedPatterns(patterns, screen, cell)
    with claimed(output, LIVE_CAPTURE, overwrite=overwrite) as target:
        known = _measurements(rig, keep, settings, measuring)
        if patterns is None:
            if density is None:
                density = 0.5 if known.exposure is None else known.exposure.density
            shape = (screen[0] // cell, screen[1] // cell)
            patterns = make_patterns("mix", shape, count, density=density, seed=seed)
        wanted = {
            "patterns": patterns.digest,
            "cell": cell,
            "exposure": settings.exposure,
            "projector": {key: known.projector.get(key) for key in ("name", "shape")},
            "camera": {key: known.camera.get(key) for key in ("name", "shape", "bits")},
        }
        with CaptureRecord.open(target, wanted, overwrite=overwrite) as record:
            session = _begin(rig, record, patterns, known, settings, progress)
            write_extras = _extras_writer(rig, float(session.exposures.max()), settings)
            if settings.until is None:
                outcome = None
                session.run()
            else:

                def estimated() -> LightTransport:
                    return _estimate_so_far(session, known, settings, write_extras)

                outcome = Until(parse_until(settings.until), estimated).run(session)
            facts = _facts(session, known, settings, outcome)
            record.finish(patterns, facts, write_extras=write_extras, overwrite=overwrite)
    _warn(record, known, settings.response)
    return Capture.open(output)


def _measurements(
    rig: Rig,
    keep: str | Path | None,
    settings: CaptureSettings,
    measuring: Callable[[str, int, int], None] | None,
) -> RigMeasurements:
    """The measurements of the rig, of which what is missing or outdated is measured now."""
    missing = [part for part in PARTS if settings.exposure is None or part != "exposure"]
    if keep is not None and Path(keep).exists():
        known = RigMeasurements.load(keep)
        if known.of_rig(rig):
            missing = [part for part in missing if getattr(known, part) is None]
            if settings.settle is not None and known.settle is not None:
                known = replace(known, settle=replace(known.settle, seconds=settings.settle))
            if not missing and known.exposure is not None:
                missing = outdated_parts(rig, known)
            if not missing:
                return known
    return measure_rig(rig, missing, keep=keep, settle=settings.settle, progress=measuring)


def _begin(
    rig: Rig,
    record: CaptureRecord,
    patterns: PatternSet,
    known: RigMeasurements,
    settings: CaptureSettings,
    progress: Callable[[Step], None] | None,
) -> Session:
    """A session with its references; refuses a rig that has changed since the frames so far."""
    assert known.settle is not None
    projected = ProjectedPatterns(patterns, rig.projector.shape, settings.cell, known.response)
    seconds = _exposures(record, patterns, settings.exposure, known)
    photographer = Photographer(rig, known.settle.seconds)
    references = rig.persistently(lambda: take_references(photographer, seconds))
    photographer.changing = references.black.changing
    _check_unchanged(record, references)
    return Session(
        photographer,
        record,
        patterns,
        projected.image,
        seconds,
        references,
        check=settings.check,
        reference_every=settings.reference_every,
        progress=progress,
    )


def _exposures(
    record: CaptureRecord, patterns: PatternSet, exposure: float | None, known: RigMeasurements
) -> NDArray[np.float64]:
    """Seconds of each frame: those of the record, the one asked for, or those advised."""
    if record.state.exposures:
        return np.array(record.state.exposures)
    if exposure is not None:
        seconds = np.full(patterns.count, exposure)
    else:
        assert known.exposure is not None
        advised = known.exposure.seconds
        shares = [(each, 1 / len(advised)) for each in advised]
        seconds = np.broadcast_to(exposure_sequence(shares, patterns), patterns.count).copy()
    record.state.exposures = [float(each) for each in seconds]
    record.save()
    return seconds


def _check_unchanged(record: CaptureRecord, now: References) -> None:
    """Refuse to go on with a capture if the rig or the scene has changed."""
    black, white = record.read_image(_BLACK), record.read_image(_WHITE)
    if black is None or white is None or not record.state.frames:
        record.keep_image(_BLACK, now.black.without_noise)
        record.keep_image(_WHITE, now.white.mean)
        return
    warning = measure_drift(now, white, black).warning()
    if warning is not None:
        raise DeviceError(
            f"since the first {len(record.state.frames)} frames were taken: {warning}",
            hint="put the rig back as it was, or add --overwrite to begin anew",
        )


def _estimate_so_far(
    session: Session,
    known: RigMeasurements,
    settings: CaptureSettings,
    write_extras: Callable[[Path], None],
) -> LightTransport:
    """The estimate from the frames of a session so far."""
    with TemporaryDirectory(prefix="lightmatrix-") as folder:
        capture = Path(folder) / "capture"
        facts = _facts(session, known, settings)
        session.record.write(capture, session.patterns, facts, write_extras)
        # The session has judged each frame.
        return estimate(Capture.open(capture), check=False)


def _facts(
    session: Session,
    known: RigMeasurements,
    settings: CaptureSettings,
    outcome: Outcome | None = None,
) -> CaptureFacts:
    record, references = session.record, session.references
    state, count = record.state, session.patterns.count
    if len(state.frames) < 2:
        raise DeviceError(
            f"only {len(state.frames)} of {count} patterns could be photographed",
            hint=f"the last trouble: {next(iter(state.unmended.values()), 'none')}",
        )
    longest = float(session.exposures.max())
    black = record.read_image(_BLACK)
    assert black is not None
    curve = curve_file(settings.response)
    provenance: dict[str, Any] = {
        "rig": {"projector": dict(known.projector), "camera": dict(known.camera)},
        "exposure_1_in_seconds": longest,
        "settle_seconds": None if known.settle is None else known.settle.seconds,
        "cell": settings.cell,
        "frames": len(state.frames),
        "patterns": count,
        "checks": dict(Counter(frame.check for frame in state.frames.values())),
        "photographed_again": dict(state.faults),
        "left_out": {str(k): reason for k, reason in state.unmended.items()},
        "drift": state.drift,
        "until": None if outcome is None else asdict(outcome),
    }
    exposures = np.array([state.frames[k].exposure for k in sorted(state.frames)])
    return CaptureFacts(
        _relative(exposures, longest),
        black.astype(np.float32),
        float(_relative(np.array(references.black.exposure), longest)),
        references.white.clip_level,
        0.0 if known.exposure is None else known.exposure.pedestal,
        settings.response if curve is None else f"curve:{Path(curve).name}",
        provenance,
    )


def _relative(seconds: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """Exposures relative to the longest, without digits that cameras round differently."""
    return np.round(seconds / longest, 9)


def _extras_writer(rig: Rig, longest: float, settings: CaptureSettings) -> Callable[[Path], None]:
    """A function that adds the response curve, and a virtual rig's true T, to a capture folder."""
    curve = curve_file(settings.response)

    def write(folder: Path) -> None:
        if curve is not None:
            shutil.copyfile(curve, folder / Path(curve).name)
        if rig.truth is not None and settings.cell == 1:
            # The capture's exposure 1 is its longest exposure.
            scale = np.float32(longest / rig.unit)
            matrix = rig.truth.with_data(rig.truth.matrix.data * scale)
            direct = rig.truth.direct_data * scale
            replace(rig.truth, matrix=matrix, direct_data=direct).save_beside(folder)

    return write


def _warn(record: CaptureRecord, known: RigMeasurements, response: str) -> None:
    """Warn of patterns that are left out, drift, and weaknesses of the rig."""
    state = record.state
    concerns = []
    if state.unmended:
        first = sorted(state.unmended.items())[:5]
        listed = ", ".join(f"pattern {k} ({why})" for k, why in first)
        concerns.append(f"{len(state.unmended)} patterns are left out of the capture: {listed}")
    for look in state.drift:
        warning = Drift(look["gain"], look["change"], look["room"]).warning()
        if warning is not None:
            concerns.append(f"after {int(look['frames'])} frames, {warning}")
            break
    if known.exposure is not None:
        concerns += known.exposure.warnings
    if known.flicker is not None and known.flicker.room > _ROOM:
        concerns.append(
            f"the room's light varies by {100 * known.flicker.room:.0f} % of white from frame to "
            "frame: darken the room, or expose for longer"
        )
    linearity = known.linearity
    if linearity is not None and not linearity.linear and response == "linear":
        concerns.append(
            f"the camera is off a straight line by {100 * linearity.deviation:.0f} %: switch off "
            "its gamma, or say its response"
        )
    for text in concerns:
        warn(text)
