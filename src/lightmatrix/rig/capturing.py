"""A whole capture by a rig: measure it, photograph the patterns, and write the capture folder.

With `CaptureSettings.until` there is an estimate after each group of frames. It ends when the error
that the estimate states is small enough: that of T, or of photographs that were held out. If the
error hardly falls any more, further patterns are not what is missing, and the diagnostics of the
rows say what is.
"""

import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from lightmatrix import estimators
from lightmatrix.capture.camera_curve import Response, curve_file
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.defaults import RIG_FILE, USUAL_FRAMES
from lightmatrix.errors import DeviceError, InputError, warn
from lightmatrix.files.images import is_grey
from lightmatrix.files.kinds import LIVE_CAPTURE
from lightmatrix.files.writing import claimed
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.judgement.metrics import row_energies
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import check_number, whole
from lightmatrix.reprs import percent
from lightmatrix.rig.devices.base import exposure_limits
from lightmatrix.rig.devices.several import pattern_sizes
from lightmatrix.rig.photograph import Photographer, take_references
from lightmatrix.rig.rig import ProjectedPatterns, Rig
from lightmatrix.rig.rig_measurements import RigMeasurements, kept_measurements, measure_rig
from lightmatrix.rig.session import CaptureRecord, CaptureSession, Step
from lightmatrix.transport.matrix import LightTransport, prediction_error

# Patterns photographed between two estimates, and before the first one: fewer frames hold out too
# few for a stated error.
GROUP, FIRST = 8, 16
# Names of the reference frames in the record.
_BLACK, _WHITE = "black.npy", "white.npy"


@dataclass
class Goal:
    """The error at which to stop, and how photographing until then went."""

    target: float
    # Whether it is the error of images that T predicts, not that of T.
    relighting: bool
    # Frames and the stated relative error with them, group by group.
    errors: list[tuple[int, float]] = field(default_factory=list)
    reached: bool = False
    sentence: str = ""


def photograph_until(
    session: CaptureSession, goal: Goal, estimate: Callable[[], LightTransport]
) -> Goal:
    """Photograph group by group, until the goal is reached or more patterns do not help.

    `estimate` returns the estimate from all frames so far.
    """
    total = session.patterns.count
    # A session that goes on starts with the frames that it has.
    count = max(FIRST, -(-len(session.record.state.frames) // GROUP) * GROUP)
    while not goal.sentence:
        count = min(count, total)
        session.run(count)
        transport = estimate()
        error = prediction_error(transport) if goal.relighting else OwnError(transport).stated
        frames = len(session.record.state.frames)
        goal.errors.append((frames, float("nan") if error is None else error))
        before = [e for n, e in goal.errors if n <= frames - 24]
        if error is not None and error <= goal.target:
            goal.reached, goal.sentence = True, f"{percent(error)} after {frames} frames"
        # Errors of sparse estimates may stay high for 64 frames and then fall at once.
        elif error is None and frames >= 64:
            doubts = [] if goal.relighting else OwnError(transport).doubts
            goal.sentence = " ".join(["no error can be stated.", *doubts])
        elif frames >= 64 and before and goal.errors[-1][1] > 0.9 * min(before):
            goal.sentence = f"more patterns do not help; {_cause(transport)}"
        elif count == total:
            goal.sentence = f"all {total} patterns are photographed: allow more"
        count += GROUP
    return goal


def parse_until(text: str | float) -> Goal:
    """The goal of a text such as 0.03, an error of T, or relighting:0.03, of relit images."""
    kind, _, number = str(text).rpartition(":")
    try:
        error = float(number)
    except ValueError:
        error = float("nan")
    if kind not in ("", "relighting") or not 0 < error < 1:
        raise InputError(
            f"a target of {text}",
            hint="give a relative error of T, such as 0.03 for 3 %, or of relit images, such as "
            "relighting:0.03",
        )
    return Goal(error, kind == "relighting")


def _cause(transport: LightTransport) -> str:
    """What most of the estimated error belongs to, and what to do about it."""
    errors = np.asarray(transport.diagnostics["estimated_error"], float)
    # Dark rows have no error of their own, or an infinite one.
    wrong = row_energies(transport) * np.where(np.isfinite(errors), errors, 0) ** 2
    total = max(float(wrong.sum()), np.finfo(float).tiny)
    # The cause of 40 % of the error is named: rows of which half of the samples clip, or whose
    # strongest projector pixel holds less than a tenth.
    clipped = np.asarray(transport.diagnostics["clipped_share"]) > 0.5
    if wrong[clipped].sum() > 0.4 * total:
        return "rows that clip in most frames: lower the exposure"
    strongest = transport.sparse.max(axis=1).toarray().ravel()
    white = transport.relight(np.ones(transport.projector_shape, np.float32)).ravel()
    if wrong[strongest < 0.1 * white].sum() > 0.4 * total:
        return "light from everywhere: add patterns of coarse cells, or accept it"
    return "noise: expose for longer, open the aperture, or bin the camera"


@dataclass(frozen=True)
class CaptureSettings:
    """How a rig photographs patterns.

    Parameters
    ----------
    cell : int
        Projector pixels along a side of each pattern pixel.
    exposure : float, optional
        Seconds, one for all frames. None: as the planner advises, possibly several.
    settle : float, optional
        Seconds to wait after a pattern is shown. None: measured.
    response : str
        The camera's response; see `Response.parse`.
    check : bool
        Whether each pattern is photographed twice, and both frames have to agree.
    until : float or str, optional
        Relative error of T, such as 0.03, or of relit images, such as relighting:0.03: patterns are
        photographed in groups of eight until an estimate states that it errs by no more, or further
        patterns do not help. None: all patterns are photographed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.CaptureSettings(exposure=0.02, cell=2).check
    True
    """

    cell: int = 1
    exposure: float | None = None
    settle: float | None = None
    response: str = "linear"
    check: bool = True
    until: float | str | None = None

    def __post_init__(self) -> None:
        for name, value in (("exposure", self.exposure), ("settle time", self.settle)):
            # More than a minute is a mistake.
            if value is not None:
                check_number(f"a {name}", value, most=60, hint="give seconds, such as 0.02")
        if (whole(self.cell) or 0) < 1:
            raise InputError(f"a cell of {self.cell} pixels", hint="use a whole number, 1 or more")
        if self.until is not None:
            parse_until(self.until)
        Response.parse(self.response)

    def check_rig(self, rig: Rig) -> None:
        """Refuse settings that a rig does not have."""
        pattern_sizes(rig.projector, self.cell)
        shortest, longest = exposure_limits(rig.camera)
        if self.exposure is not None and not shortest <= self.exposure <= longest:
            hint = f"the camera has {shortest:g} to {longest:g} s"
            raise InputError(f"an exposure of {self.exposure:g} s", hint=hint)
        largest = min(rig.projector.shape)
        if self.cell > largest:
            raise InputError(f"a cell of {self.cell} pixels", hint=f"use 1 to {largest} pixels")


def take_capture(
    output: str | Path,
    rig: Rig,
    patterns: PatternSet | str | Path | None = None,
    *,
    count: int = USUAL_FRAMES,
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
        File that keeps the rig's settle time and flicker; exposures are measured each time, and
        before grey patterns the response. None: everything is measured, and nothing kept.
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
        if pattern_sizes(rig.projector, cell) and patterns.shape != (
            screen[0] // cell,
            screen[1] // cell,
        ):
            raise InputError(
                f"patterns of {patterns.shape}, for several projectors of {screen} in all",
                hint=f"make patterns of {screen[0] // cell}x{screen[1] // cell}, which hold those "
                "of all projectors, one above the other",
            )
    with claimed(output, LIVE_CAPTURE, overwrite=overwrite) as target:
        known = kept_measurements(rig, keep)
        # The exposures are those of the scene, and only grey patterns need the response.
        parts = [part for part in ("settle", "flicker") if getattr(known, part) is None]
        parts += ["exposure"] if settings.exposure is None else []
        parts += ["response"] if patterns is not None and patterns.as_bits() is None else []
        if parts or settings.settle is not None:
            known = measure_rig(
                rig, parts, keep=keep, settle=settings.settle, response=settings.response,
                progress=measuring,
            )  # fmt: skip
        if patterns is None:
            if density is None:
                density = 0.5 if known.exposure is None else known.exposure.density
            shape = (screen[0] // cell, screen[1] // cell)
            patterns = make_patterns("mix", shape, count, density=density, seed=seed)
        wanted = {
            "patterns": patterns.digest,
            "cell": cell,
            "exposure": settings.exposure,
            "check": settings.check,
            "projector": {key: known.projector.get(key) for key in ("name", "shape")},
            "camera": {key: known.camera.get(key) for key in ("name", "shape", "bits")},
        }
        with CaptureRecord.open(target, wanted, overwrite=overwrite) as record:
            assert known.settle is not None
            projected = ProjectedPatterns(patterns, screen, cell, known.response)
            if not record.state.exposures:
                asked: Any = settings.exposure
                if asked is None:
                    assert known.exposure is not None
                    advised = known.exposure.seconds
                    asked = exposure_sequence([(e, 1 / len(advised)) for e in advised], patterns)
                record.state.exposures = np.broadcast_to(asked, patterns.count).tolist()
                record.save()
            seconds = np.array(record.state.exposures, np.float64)
            photographer = Photographer(rig, known.settle.seconds)
            references = rig.persistently(lambda: take_references(photographer, seconds))
            black, white = record.read_image(_BLACK), record.read_image(_WHITE)
            if black is None or white is None or not record.state.frames:
                record.keep_image(_BLACK, references.black.without_noise)
                record.keep_image(_WHITE, references.white.mean)
            elif (warning := references.change(white, black)) is not None:
                raise DeviceError(
                    f"since the first {len(record.state.frames)} frames were taken: {warning}",
                    hint="put the rig back as it was, or begin anew: overwrite=True",
                )
            session = CaptureSession(
                photographer, record, patterns, projected.image, seconds, references,
                check=settings.check, progress=progress,
            )  # fmt: skip

            def estimate_so_far() -> LightTransport:
                with TemporaryDirectory(prefix="lightmatrix-") as folder:
                    so_far = Path(folder) / "capture"
                    _write(so_far, session, known, settings)
                    # The session has judged each frame.
                    return estimators.estimate.estimate(Capture.open(so_far), check=False)

            outcome = None
            if settings.until is None:
                session.run()
            else:
                outcome = photograph_until(session, parse_until(settings.until), estimate_so_far)
            _write(target, session, known, settings, outcome, overwrite=overwrite)
            record.discard()
    _warn(record, known)
    return Capture.open(output)


def _write(
    folder: Path,
    session: CaptureSession,
    known: RigMeasurements,
    settings: CaptureSettings,
    outcome: Goal | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Make a capture folder of the frames that a session has so far."""
    record, references, patterns = session.record, session.references, session.patterns
    state, longest = record.state, float(session.exposures.max())
    numbers = sorted(state.frames)
    if len(numbers) < 2:
        raise DeviceError(
            f"only {len(numbers)} of {patterns.count} patterns could be photographed",
            hint=f"the last trouble: {next(iter(state.unmended.values()), 'none')}",
        )
    # Exposures are relative to the longest, without the digits that cameras round differently.
    exposures = np.round([state.frames[k] / longest for k in numbers], 9)
    black, frame = record.read_image(_BLACK), record.read(numbers[0])
    assert black is not None
    assert frame is not None
    black = black.astype(np.float32)
    images = (record.read(k) for k in numbers)
    if frame.ndim == 3 and all(image is not None and is_grey(image) for image in images):
        # Readers take files with three equal channels for grey images.
        black = black.mean(axis=2)
    curve = curve_file(settings.response)
    provenance: dict[str, Any] = {
        "rig": {"projector": dict(known.projector), "camera": dict(known.camera)},
        "exposure_1_in_seconds": longest,
        "settle_seconds": None if known.settle is None else known.settle.seconds,
        "cell": settings.cell, "frames": len(numbers), "patterns": patterns.count,
        "checked": settings.check, "photographed_again": dict(state.faults),
        "left_out": {str(k): reason for k, reason in state.unmended.items()},
        "until": None if outcome is None else asdict(outcome),
    }  # fmt: skip

    def write_extras(folder: Path) -> None:
        """Add the response curve, and a virtual rig's true T."""
        if curve is not None:
            shutil.copyfile(curve, folder / Path(curve).name)
        rig = session.photographer.rig
        if rig.truth is not None and settings.cell == 1:
            rig.truth.scaled(np.float32(longest / rig.unit)).save_beside(folder)

    write_capture(
        folder,
        patterns if len(numbers) == patterns.count else patterns.subset(np.array(numbers)),
        (record.file(k) for k in numbers),
        sensor=Sensor(
            float(exposures[0]) if np.ptp(exposures) == 0 else exposures,
            black_level=0.0 if known.exposure is None else known.exposure.pedestal,
            bits=8 if frame.dtype == np.uint8 else 16,
            clip=references.white.clip_level,
        ),
        camera_shape=black.shape,
        black=black,
        black_exposure=float(np.round(references.black.exposure / longest, 9)),
        response=settings.response if curve is None else f"curve:{Path(curve).name}",
        provenance=provenance,
        projectors=pattern_sizes(session.photographer.rig.projector, settings.cell),
        write_extras=write_extras,
        overwrite=overwrite,
    )


def _warn(record: CaptureRecord, known: RigMeasurements) -> None:
    """Warn of patterns that are left out, and of weaknesses of the rig."""
    state = record.state
    concerns = []
    if state.unmended:
        first = sorted(state.unmended.items())[:5]
        listed = ", ".join(f"pattern {k} ({why})" for k, why in first)
        concerns.append(f"{len(state.unmended)} patterns are left out of the capture: {listed}")
    if known.exposure is not None:
        concerns += known.exposure.warnings
    if known.flicker is not None and known.flicker.room > 0.02:
        concerns.append(
            f"the room's light varies by {100 * known.flicker.room:.0f} % of white from frame to "
            "frame: darken the room, or expose for longer"
        )
    for text in concerns:
        warn(text)
