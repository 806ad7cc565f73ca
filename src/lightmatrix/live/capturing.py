"""A whole capture by a rig: calibrated, photographed, checked, written, and gone on with."""

from __future__ import annotations

import shutil
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response, curve_file
from lightmatrix.camera.exposure_sequence import exposure_sequence
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.description import TRUTH
from lightmatrix.errors import DeviceError, InputError, LightMatrixWarning
from lightmatrix.live.devices.exposures import exposure_limits
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.frames.repeats import take_steady
from lightmatrix.live.frames.same_light import Drift, References, drift
from lightmatrix.live.measurements.rig_measurements import (
    PARTS,
    RigMeasurements,
    measure_rig,
    outdated,
)
from lightmatrix.live.measurements.white import FIRST_SETTLE, images
from lightmatrix.live.record import Record
from lightmatrix.live.rig import Rig, UnfitRigError
from lightmatrix.live.session import Session, Step
from lightmatrix.live.showing import Shown
from lightmatrix.outputs.kinds import LIVE_CAPTURE
from lightmatrix.outputs.writing import claimed
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import PatternSet

USUAL_COUNT = 64
USUAL_REFERENCE = 32
RIG_FILE = "rig.json"
# Frames of black that are averaged: its noise is in all frames alike.
_BLACK_FRAMES = 8
# Of the clip level: what white is above black at least.
_SEEN = 0.01
_BLACK, _WHITE = "black.npy", "white.npy"
# Of white: what the room's light may vary by.
_ROOM = 0.02


def take_capture(
    output: str | Path,
    rig: Rig,
    patterns: PatternSet | str | Path | None = None,
    *,
    count: int = USUAL_COUNT,
    density: float | None = None,
    seed: int = 0,
    cell: int = 1,
    exposure: float | None = None,
    settle: float | None = None,
    response: str = "linear",
    keep: str | Path | None = RIG_FILE,
    check: bool = True,
    reference_every: int = USUAL_REFERENCE,
    overwrite: bool = False,
    progress: Callable[[Step], None] | None = None,
    measuring: Callable[[str, int, int], None] | None = None,
) -> Capture:
    """Photograph a scene under patterns with a rig.

    Frames are written as they come, to ``<output>.partial``; a run that was ended, however that
    happened, goes on there when it is given again.

    Parameters
    ----------
    output : str or Path
        The capture folder to make.
    rig : Rig
        See `open_rig`.
    patterns : PatternSet, str or Path, optional
        The patterns or a folder of them. None: a random mix of fine and coarse ones.
    count : int
        Number of patterns, where none are given.
    density : float, optional
        Share of lit pixels of such patterns. None: as the exposures advise.
    seed : int
        Of such patterns.
    cell : int
        Projector pixels of a side of each pattern pixel.
    exposure : float, optional
        Seconds, one for all frames. None: as the planner advises, several perhaps.
    settle : float, optional
        Seconds to wait after a pattern was shown. None: measured.
    response : str
        Of the camera; see `Response.parse`.
    keep : str or Path, optional
        File of what is known of the rig: read, looked over, and written where anything had to be
        measured. None: everything is measured, and nothing kept.
    check : bool
        Whether every frame has to be shown to be that of its pattern.
    reference_every : int
        Frames between two looks at black and white, by which drift is seen; 0 for none.
    overwrite : bool
        Whether an existing capture may be replaced, and frames of another one thrown away.
    progress : callable, optional
        Called with a `Step` after each frame.
    measuring : callable, optional
        Called with (part, done, total) while the rig is measured.

    Returns
    -------
    Capture
        What was written, its provenance saying how; patterns without a frame are left out.

    Raises
    ------
    InputError
        On patterns that do not fit, and numbers out of range.
    DeviceError
        If a device is lost, the camera does not see the projector, or one frame after the other
        cannot be taken.
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
    for name, value in (("exposure", exposure), ("settle time", settle)):
        if value is not None and not 0 <= value <= 60:
            raise InputError(f"a {name} of {value} s", hint="give seconds, such as 0.02")
    shortest, longest = exposure_limits(rig.camera)
    if exposure is not None and not shortest <= exposure <= longest:
        raise InputError(
            f"an exposure of {exposure:g} s", hint=f"the camera has {shortest:g} to {longest:g} s"
        )
    if not 1 <= cell <= min(rig.projector.shape):
        raise InputError(
            f"a cell of {cell} pixels", hint=f"use 1 to {min(rig.projector.shape)} pixels"
        )
    # Before all work, lest it is refused after it.
    Response.parse(response)
    if reference_every < 0:
        raise InputError(f"a reference every {reference_every} frames", hint="use 0 or more")
    given = patterns if isinstance(patterns, PatternSet) or patterns is None else Path(patterns)
    known_patterns = read_patterns(given) if isinstance(given, Path) else given
    screen = rig.projector.shape
    if known_patterns is not None:
        Shown(known_patterns, screen, cell)
    with claimed(output, LIVE_CAPTURE, overwrite=overwrite) as target:
        known = _measured_rig(rig, keep, settle, exposure is None, measuring)
        assert known.settle is not None
        shown = known_patterns or _made(screen, cell, count, density, seed, known)
        showing = Shown(shown, screen, cell, known.response)
        wanted = {
            "patterns": shown.digest,
            "cell": cell,
            "exposure": exposure,
            "projector": {key: known.projector.get(key) for key in ("name", "shape")},
            "camera": {key: known.camera.get(key) for key in ("name", "shape", "bits")},
        }
        with Record.open(target, wanted, overwrite=overwrite) as record:
            seconds = _exposures(record, shown, exposure, known)
            taker = Taker(rig, known.settle.seconds)
            references = rig.persistently(lambda: _references(taker, seconds))
            taker.changing = references.black.changing
            _check_unchanged(record, references)
            session = Session(
                taker,
                record,
                shown,
                showing.image,
                seconds,
                references,
                check=check,
                reference_every=reference_every,
                progress=progress,
            )
            session.run()
            _finish(rig, record, shown, seconds, references, known, cell, response, overwrite)
    _warn(record, known, response)
    return Capture.open(output)


def _measured_rig(
    rig: Rig,
    keep: str | Path | None,
    settle: float | None,
    advised: bool,
    measuring: Callable[[str, int, int], None] | None,
) -> RigMeasurements:
    """What is known of the rig, and what has to be measured for that."""
    missing = [part for part in PARTS if advised or part != "exposure"]
    if keep is not None and Path(keep).exists():
        known = RigMeasurements.load(keep)
        if known.of_rig(rig):
            missing = [part for part in missing if getattr(known, part) is None]
            if settle is not None and known.settle is not None:
                known = replace(known, settle=replace(known.settle, seconds=settle))
            if not missing and known.exposure is not None:
                missing = outdated(rig, known)
            if not missing:
                return known
    return measure_rig(rig, missing, keep=keep, settle=settle, progress=measuring)


def _made(
    screen: tuple[int, int],
    cell: int,
    count: int,
    density: float | None,
    seed: int,
    known: RigMeasurements,
) -> PatternSet:
    advised = 0.5 if known.exposure is None else known.exposure.density
    lit = advised if density is None else density
    shape = (screen[0] // cell, screen[1] // cell)
    return make_patterns("mix", shape, count, density=lit, seed=seed)


def _exposures(
    record: Record, patterns: PatternSet, exposure: float | None, known: RigMeasurements
) -> NDArray[np.float64]:
    """Seconds of each frame: as the frames have it that there are, as asked for, or as advised."""
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


def _references(taker: Taker, seconds: NDArray[np.float64]) -> References:
    black, white = images(taker.rig)
    long, short = float(seconds.max()), float(seconds.min())
    # Whatever was shown before is gone.
    waiting = replace(taker, settle=FIRST_SETTLE)
    dark = take_steady(waiting, black, long, _BLACK_FRAMES)
    dark_short = dark if short == long else take_steady(taker, black, short, 3)
    bright = take_steady(replace(taker, settle=FIRST_SETTLE), white, short, 5)
    found = References(dark, bright, dark_short.mean)
    if np.quantile(found.light, 0.99) < _SEEN * bright.clip_level:
        raise UnfitRigError(
            f"at {short:g} s, a white picture looks like a black one",
            hint="leave --exposure to be measured, or choose one at which white neither clips nor "
            "is dark",
        )
    return found


def _check_unchanged(record: Record, now: References) -> None:
    """Refuse to go on with a capture whose rig or scene has changed meanwhile."""
    black, white = record.read_image(_BLACK), record.read_image(_WHITE)
    if black is None or white is None or not record.state.frames:
        record.keep_image(_BLACK, now.black.without_noise)
        record.keep_image(_WHITE, now.white.mean)
        return
    seen: Drift = drift(now, white, black)
    if seen.said() is not None:
        raise DeviceError(
            f"since the first {len(record.state.frames)} frames were taken: {seen.said()}",
            hint="put the rig back as it was, or add --overwrite to begin anew",
        )


def _finish(
    rig: Rig,
    record: Record,
    patterns: PatternSet,
    seconds: NDArray[np.float64],
    references: References,
    known: RigMeasurements,
    cell: int,
    response: str,
    overwrite: bool,
) -> None:
    longest = float(seconds.max())
    taken = record.state.frames
    if len(taken) < 2:
        raise DeviceError(
            f"only {len(taken)} of {patterns.count} patterns could be photographed",
            hint=f"the last trouble: {next(iter(record.state.unmended.values()), 'none')}",
        )
    black = record.read_image(_BLACK)
    assert black is not None
    pedestal = 0.0 if known.exposure is None else known.exposure.pedestal

    curve = curve_file(response)

    def beside(part: Path) -> None:
        if curve is not None:
            shutil.copyfile(curve, part / Path(curve).name)
        if rig.truth is not None and cell == 1:
            # T is what the longest exposure sees.
            scale = np.float32(longest / rig.unit)
            matrix = rig.truth.with_data(rig.truth.matrix.data * scale)
            direct = rig.truth.direct_data * scale
            replace(rig.truth, matrix=matrix, direct_data=direct).save(part / TRUTH)

    record.finish(
        patterns,
        exposures=_relative(np.array([taken[k].exposure for k in sorted(taken)]), longest),
        clip_level=references.white.clip_level,
        camera_shape=references.white.mean.shape,
        black=black.astype(np.float32),
        black_exposure=float(_relative(np.array(references.black.exposure), longest)),
        black_level=pedestal,
        response=response if curve is None else f"curve:{Path(curve).name}",
        provenance=_provenance(record, known, longest, patterns, cell),
        beside=beside,
        overwrite=overwrite,
    )


def _relative(seconds: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """Exposures by the longest one; cameras and units round their last digits differently."""
    return np.round(seconds / longest, 9)


def _provenance(
    record: Record, known: RigMeasurements, longest: float, patterns: PatternSet, cell: int
) -> dict[str, Any]:
    state = record.state
    checks = Counter(frame.check for frame in state.frames.values())
    return {
        "rig": {"projector": dict(known.projector), "camera": dict(known.camera)},
        "exposure_1_in_seconds": longest,
        "settle_seconds": None if known.settle is None else known.settle.seconds,
        "cell": cell,
        "frames": len(state.frames),
        "patterns": patterns.count,
        "checks": dict(checks),
        "photographed_again": dict(state.faults),
        "left_out": {str(k): reason for k, reason in state.unmended.items()},
        "drift": state.drift,
    }


def _warn(record: Record, known: RigMeasurements, response: str) -> None:
    """Say what the frames are not to be blamed for, but should be known."""
    state = record.state
    told = []
    if state.unmended:
        shown = ", ".join(f"pattern {k} ({why})" for k, why in sorted(state.unmended.items())[:5])
        told.append(f"{len(state.unmended)} patterns are left out of the capture: {shown}")
    for look in state.drift:
        said = Drift(look["gain"], look["change"], look["room"]).said()
        if said is not None:
            told.append(f"after {int(look['frames'])} frames, {said}")
            break
    if known.exposure is not None:
        told += known.exposure.warnings
    if known.flicker is not None and known.flicker.room > _ROOM:
        told.append(
            f"the room's light varies by {100 * known.flicker.room:.0f} % of white from frame to "
            "frame: darken the room, or expose for longer"
        )
    linearity = known.linearity
    if linearity is not None and not linearity.linear and response == "linear":
        told.append(
            f"the camera is off a straight line by {100 * linearity.deviation:.0f} %: switch off "
            "its gamma, or say its response"
        )
    for text in told:
        warnings.warn(text, LightMatrixWarning, stacklevel=3)
