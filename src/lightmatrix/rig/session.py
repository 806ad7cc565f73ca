"""The session loop: shows patterns, photographs them, judges the frames, and repeats bad ones.

A frame is kept only if it can be right (`photograph`). It is trusted only if one of two things
holds:

- It meets what the other frames predict for its pattern (`pattern_match`), and nothing of the image
  shown before is in it. The prediction excludes that, or a photograph straight after it agrees: an
  image that came within the exposure is complete by then.
- It agrees with a second photograph before which something else was shown, so that no late image
  can be in both (`References.agree`).

While a capture is taken, `<output>.partial` holds the frames as image files, and `session.json`,
which describes them. A session that was stopped, however that happened, goes on there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import fill_image, read_image
from lightmatrix.files.kinds import PARTIAL
from lightmatrix.files.running import RunningResults
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import jsonable
from lightmatrix.rig.pattern_match import PatternMatcher, choose_samples
from lightmatrix.rig.photograph import (
    TRIES,
    Drift,
    Photographer,
    References,
    Shot,
    UntrustedFrameError,
    measure_drift,
    plain_images,
    take_average,
)

_STATE = "session.json"


@dataclass
class FrameRecord:
    """What is known of a frame."""

    # Seconds, as the camera reported them.
    exposure: float
    # The camera's number of the frame.
    id: int
    # Seconds from the pattern being shown to the start of the exposure.
    delay: float
    # Number of the pattern shown before it; -1 for black, -2 for white.
    before: int
    # Photographs that were taken for it.
    tries: int
    # Whether it meets what the other frames predict, agrees with a second photograph, or has not
    # been checked yet. One of "matched", "confirmed", "unchecked".
    check: str
    # Whether a photograph straight after it agrees: no image came within its exposure.
    still: bool = False


@dataclass
class SessionState:
    """What is known of all frames, JSON-ready."""

    # Number of a pattern -> its frame's record.
    frames: dict[int, FrameRecord] = field(default_factory=dict)
    # Reason for repeating photographs -> how often.
    faults: dict[str, int] = field(default_factory=dict)
    # Number of a pattern that was given up -> why.
    unmended: dict[int, str] = field(default_factory=dict)
    # For each look at the references: frames taken before, gain, change, room.
    drift: list[dict[str, float]] = field(default_factory=list)
    # Seconds that each frame is asked for.
    exposures: list[float] = field(default_factory=list)


class CaptureRecord:
    """The running results of a capture, which an exception leaves for the next run."""

    def __init__(
        self, target: Path, results: RunningResults, wanted: Mapping[str, Any], state: SessionState
    ) -> None:
        self._target, self._results, self._wanted, self.state = target, results, wanted, state

    @classmethod
    def open(
        cls, target: Path, wanted: Mapping[str, Any], *, overwrite: bool = False
    ) -> CaptureRecord:
        """Begin, or go on with, the capture of an output that `claimed` yielded.

        `wanted` is everything that frames depend on, JSON-ready. Frames under other settings are an
        OutputError, or are discarded with `overwrite`.
        """
        settings = json.loads(json.dumps(dict(wanted), default=jsonable))
        results = RunningResults.resume(
            target,
            PARTIAL,
            settings,
            file=_STATE,
            key="wanted",
            contents="frames of another capture",
            overwrite=overwrite,
        )
        content = results.read_object(_STATE)
        if content is None:
            return cls(target, results, settings, SessionState())
        state = SessionState(
            {int(k): FrameRecord(**frame) for k, frame in content["frames"].items()},
            dict(content["faults"]),
            {},
            list(content["drift"]),
            [float(each) for each in content["exposures"]],
        )
        record = cls(target, results, settings, state)
        # Frames that were lost or damaged since are taken again.
        for k in [k for k in state.frames if record.read(k) is None]:
            del state.frames[k]
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and not self.state.frames:
            self._results.discard()

    def keep(self, frame: int, data: NDArray[Any], record: FrameRecord) -> None:
        """Write a frame whole or not at all, and its record."""
        self.state.frames.pop(frame, None)
        self.keep_image(_name(frame), data)
        self.state.frames[frame] = record
        self.state.unmended.pop(frame, None)
        self.save()

    def give_up(self, frame: int, reason: str) -> None:
        """Note why there is no frame of a pattern."""
        self.state.unmended[frame] = reason
        self.state.frames.pop(frame, None)
        self.save()

    def read(self, frame: int) -> NDArray[Any] | None:
        """A frame that was kept; None if there is none that can be read."""
        return self.read_image(_name(frame))

    def keep_image(self, name: str, data: NDArray[Any]) -> None:
        """Keep another image, such as a reference, under a name of its own."""
        with self._results.keep(name) as part:
            fill_image(part, data)

    def read_image(self, name: str) -> NDArray[Any] | None:
        """The image that was kept under a name; None if it is missing or damaged."""
        if not self._results.has(name):
            return None
        try:
            return read_image(self._results.file(name))
        except InputError:
            return None

    def save(self) -> None:
        """Write what is known of the frames."""
        content = {"format": "lightmatrix-session", "version": 1, "wanted": self._wanted}
        text = json.dumps({**content, **asdict(self.state)})
        with self._results.keep(_STATE) as part:
            part.write_text(text + "\n")

    def discard(self) -> None:
        """Remove the record, once the capture is complete."""
        self._results.discard()

    def file(self, frame: int) -> Path:
        """The file of a frame that was kept."""
        return self._results.file(_name(frame))


def _name(frame: int) -> str:
    # PNG is not used: compressing the noise of a large frame takes longer than photographing it.
    return f"image_{frame:04d}.tif"


# Numbers for black and white images, which are shown between patterns.
_BLACK, _WHITE = -1, -2
MATCHED, CONFIRMED, UNCHECKED = "matched", "confirmed", "unchecked"
# A frame that was doubted, and the number of the pattern that was shown before it.
Doubted = tuple[NDArray[np.generic], int]


@dataclass(frozen=True)
class Step:
    """Progress of a session after a frame."""

    # Numbers of frames.
    done: int
    total: int
    # Share of the last frame's samples that clip.
    clipped: float
    # How the last frame was checked.
    check: str


@dataclass(eq=False)
class CaptureSession:
    """Photographs all patterns."""

    photographer: Photographer
    # Holds the frames so far, and receives new ones.
    record: CaptureRecord
    # K patterns.
    patterns: PatternSet
    # The image (rows, cols) uint8 that the projector is given for a pattern.
    image: Callable[[int], NDArray[np.uint8]]
    # (K,): seconds of each frame.
    exposures: NDArray[np.float64]
    references: References
    # Whether frames have to be shown to be right.
    check: bool = True
    # Frames between two looks at the references; 0 for none.
    reference_every: int = 32
    # Called with a `Step` after each frame.
    progress: Callable[[Step], None] | None = None
    _matcher: PatternMatcher = field(init=False)
    _samples: NDArray[np.int64] = field(init=False)
    # The number of the image that is shown now; taking the references ends with white.
    _shown: int = _WHITE

    def __post_init__(self) -> None:
        light, rows = self.references.light, self.references.light.shape[0]
        self._samples, group = choose_samples(light, self.patterns)
        per_row = light.size // rows
        longest = self.exposures.max()
        ceiling = (self.references.white.clip_level - self._dark(float(longest))) / longest
        self._matcher = PatternMatcher(
            self.patterns,
            self._samples // per_row,
            ceiling[self._samples].astype(np.float32),
            group,
        )

    def run(self, count: int | None = None) -> None:
        """Take what is missing of all frames, or of the first `count`.

        An error of a device or the disk leaves those written.
        """
        wanted = range(self.patterns.count if count is None else count)
        for k in self._frames:
            frame = self.record.read(k)
            assert frame is not None
            self._note(k, frame, self._frames[k].exposure)
        # Patterns that were given up get a second chance, now that the trouble may be over.
        for _ in range(2):
            self._take_all([k for k in wanted if k not in self._frames])
            self._judge_all()
        if self.check:
            # What could not be judged is photographed again.
            self._repeat([k for k, frame in self._frames.items() if frame.check == UNCHECKED])

    # ---- taking frames

    @property
    def _frames(self) -> dict[int, FrameRecord]:
        return self.record.state.frames

    def _take_all(self, missing: list[int]) -> None:
        failures = 0
        for count, k in enumerate(missing):
            if self.reference_every and count % self.reference_every == self.reference_every - 1:
                self._look_at_references()
            failures = 0 if self._take(k) else failures + 1
            # After four failures in a row the rig does not work.
            if failures == 4:
                reason = self.record.state.unmended[k]
                raise DeviceError(
                    f"{failures} patterns in a row could not be photographed, {TRIES} tries each; "
                    f"the last: {reason}",
                    hint="mend it and run again: the frames so far are kept",
                )
            if self.check and self._matcher.due:
                self._matcher.learn()

    def _take(self, k: int, rival: Doubted | None = None) -> bool:
        """Photograph a pattern until a frame is right, or agrees with `rival`, a doubted one."""
        doubted: list[Doubted] = [] if rival is None else [rival]
        reason = ""
        for tries in range(1, TRIES + 1):
            try:
                # A small share of black or white would not be noticed in a frame.
                if tries > 1 or rival is not None or self._shown < 0:
                    self._show_other(k, {before for _, before in doubted})
                shot = self.photographer.take(self.image(k), float(self.exposures[k]))
                before, self._shown = self._shown, k
            except UntrustedFrameError as error:
                reason = error.message
                self._count_fault(reason)
                self._shown = k
                continue
            self._note(k, shot.data, shot.exposure)
            frame = FrameRecord(shot.exposure, shot.frame.id, shot.delay, before, tries, UNCHECKED)
            complaint = self._judge(k, frame, shot, doubted) if self.check else None
            if complaint is None:
                self.record.keep(k, shot.data, frame)
                if self.progress is not None:
                    clipped = float((shot.data >= shot.frame.clip_level).mean())
                    total = self.patterns.count
                    self.progress(Step(len(self._frames), total, clipped, frame.check))
                return True
            reason = complaint
            self._count_fault(reason)
            doubted.append((shot.data, before))
        self._matcher.forget(k)
        self.record.give_up(k, reason)
        return False

    def _judge(self, k: int, frame: FrameRecord, shot: Shot, doubted: list[Doubted]) -> str | None:
        """What is wrong with a frame; None if nothing is, and then its check is noted."""
        before, exposure = frame.before, frame.exposure
        for other, other_before in doubted:
            # After the same image, both frames may show that, late.
            if before != other_before and self.references.agree(
                shot.data, other, exposure, self._lights((before, other_before), exposure)
            ):
                frame.check = CONFIRMED
                return None
        if self._matcher.predictive:
            if (complaint := self._matcher.complaint(k, before)) is not None:
                return complaint
        elif doubted:
            return "two photographs of the pattern differ"
        if not self._excludes_previous(k, frame):
            try:
                after = self.photographer.take(self.image(k), float(self.exposures[k]), settle=0.0)
            except UntrustedFrameError as error:
                return error.message
            lights = self._lights((before,), exposure)
            if not self.references.agree(shot.data, after.data, exposure, lights):
                return "a photograph straight after it differs"
            frame.still = True
        if self._matcher.predictive:
            frame.check = MATCHED
        return None

    def _excludes_previous(self, k: int, frame: FrameRecord) -> bool:
        """Whether the prediction shows that nothing of the previous image is in a frame."""
        noise = self.references.noise / frame.exposure
        return self._matcher.predictive and self._matcher.excludes(k, frame.before, noise)

    def _show_other(self, k: int, befores: set[int]) -> None:
        """Show an image that is neither k nor one of `befores`."""
        rig = self.photographer.rig
        count = self.patterns.count
        others = ((k + step) % count for step in range(-1, -count, -1))
        other = next((j for j in others if j not in befores), None)
        if self._matcher.predictive and other is not None:
            self._shown, image = other, self.image(other)
        else:
            # Frames are compared with each other, and patterns may be too similar for that.
            self._shown = _WHITE if _BLACK in befores and _WHITE not in befores else _BLACK
            image = plain_images(rig)[self._shown == _WHITE]
        shown = rig.projector.show(image)
        rig.clock.sleep(shown + self.photographer.settle - rig.clock.now())

    # ---- what frames contain

    def _lights(self, images: Iterable[int], exposure: float) -> list[NDArray[np.float32]]:
        """Levels above black that frames of some images have, as far as these are known."""
        lights = []
        shape = self.references.light.shape
        for k in images:
            if k == _BLACK:
                lights.append(np.zeros(shape, np.float32))
            elif k == _WHITE:
                scale = np.float32(exposure / self.references.white.exposure)
                lights.append(scale * self.references.light)
            elif k in self._frames and (frame := self.record.read(k)) is not None:
                seconds = self._frames[k].exposure
                above = np.asarray(frame, np.float32) - self._dark(seconds).reshape(shape)
                lights.append(np.float32(exposure / seconds) * above)
        return lights

    def _note(self, k: int, data: NDArray[np.generic], exposure: float) -> None:
        levels = np.asarray(data, np.float32).ravel()[self._samples]
        dark = self._dark(exposure)[self._samples]
        self._matcher.put(k, ((levels - dark) / exposure).astype(np.float32))

    def _dark(self, exposure: float) -> NDArray[np.float32]:
        """The black frame at an exposure, (M,)."""
        long, short = self.references.black, self.references.white.exposure
        if long.exposure == short:
            return long.mean.ravel()
        share = (exposure - short) / (long.exposure - short)
        dark = self.references.dark + share * (long.mean - self.references.dark)
        return np.asarray(dark.ravel(), np.float32)

    # ---- judging again

    def _judge_all(self) -> None:
        """Judge each frame by all others, and repeat those that are not right."""
        if not self.check:
            return
        for _ in range(TRIES):
            self._matcher.learn()
            if not self._matcher.predictive:
                return
            bad = []
            for k, frame in sorted(self._frames.items()):
                if frame.check == CONFIRMED:
                    continue
                complaint = self._matcher.complaint(k, frame.before)
                right = complaint is None and (frame.still or self._excludes_previous(k, frame))
                frame.check = MATCHED if right else UNCHECKED
                if complaint:
                    bad.append(k)
                    self._count_fault(complaint)
            self.record.save()
            self._repeat(bad)
            # Few wrong frames change the predictions of the others little.
            if len(bad) <= 0.1 * len(self._frames):
                return

    def _repeat(self, frames: list[int]) -> None:
        for k in sorted(frames):
            frame = self.record.read(k)
            self._matcher.forget(k)
            self._take(k, None if frame is None else (frame, self._frames[k].before))

    def _look_at_references(self) -> None:
        """Note whether the light, the scene or the room has changed."""
        drift = self._drift_now(1)
        if drift is None or drift.warning() is not None:
            # A second look, since single frames may be lost, late or torn.
            drift = self._drift_now(3)
        if drift is not None:
            self.record.state.drift.append({"frames": len(self._frames), **asdict(drift)})

    def _drift_now(self, count: int) -> Drift | None:
        """Drift by white and black frames, `count` of each; None if they cannot be taken."""
        start, frames = self.references, []
        self._shown = _BLACK
        black, white = plain_images(self.photographer.rig)
        for image, reference in ((white, start.white), (black, start.black)):
            try:
                if count > 1:
                    average = take_average(self.photographer, image, reference.exposure, count)
                    frames.append(average.mean)
                else:
                    shot = self.photographer.take(image, reference.exposure)
                    frames.append(shot.data.astype(np.float32))
            except DeviceError as error:
                self._count_fault(error.message)
                return None
        return measure_drift(start, frames[0], frames[1])

    def _count_fault(self, reason: str) -> None:
        """Count a fault, with N for the numbers that make each one differ."""
        words = " ".join("N" if word.strip(".,:%").isdigit() else word for word in reason.split())
        faults = self.record.state.faults
        faults[words] = faults.get(words, 0) + 1
