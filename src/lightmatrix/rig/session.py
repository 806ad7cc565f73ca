"""The session loop: photographs every pattern twice, and keeps a frame if both agree.

A photograph is looked at only if it can be right (`photograph`). It is kept if it agrees with
another one of its pattern, before which something else was shown (`References.agree`): an image
that comes late, or within the exposure, is not in both. Patterns are photographed in groups,
forwards and then backwards, so that the two photographs of each come soon after one another.

While a capture is taken, `<output>.partial` holds the frames as image files, and `session.json`,
which describes them. A session that was stopped, however that happened, goes on there.
"""

import json
from collections.abc import Callable, Mapping
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
from lightmatrix.rig.photograph import (
    Photographer,
    References,
    Shot,
    UntrustedFrameError,
    plain_images,
)

_STATE = "session.json"


@dataclass
class SessionState:
    """What is known of all frames, JSON-ready."""

    # Number of a pattern -> seconds of its frame, as the camera reported them.
    frames: dict[int, float] = field(default_factory=dict)
    # Reason for repeating photographs -> how often.
    faults: dict[str, int] = field(default_factory=dict)
    # Number of a pattern that was given up -> why.
    unmended: dict[int, str] = field(default_factory=dict)
    # Seconds that each frame is asked for.
    exposures: list[float] = field(default_factory=list)


class CaptureRecord:
    """The running results of a capture, which an exception leaves for the next run."""

    def __init__(
        self, results: RunningResults, wanted: Mapping[str, Any], state: SessionState
    ) -> None:
        self._results, self._wanted, self.state = results, wanted, state

    @classmethod
    def open(
        cls, target: Path, wanted: Mapping[str, Any], *, overwrite: bool = False
    ) -> "CaptureRecord":
        """Begin, or go on with, the capture of an output that `claimed` yielded.

        `wanted` is everything that frames depend on, JSON-ready. Frames under other settings are an
        OutputError, or are discarded with `overwrite`.
        """
        settings = json.loads(json.dumps(dict(wanted), default=jsonable))
        results = RunningResults.resume(
            target, PARTIAL, settings, file=_STATE, key="wanted",
            contents="frames of another capture", overwrite=overwrite,
        )  # fmt: skip
        content = results.read_object(_STATE)
        if content is None:
            return cls(results, settings, SessionState())
        frames = {int(k): float(seconds) for k, seconds in content["frames"].items()}
        state = SessionState(frames, content["faults"], {}, content["exposures"])
        record = cls(results, settings, state)
        # Frames that were lost or damaged since are taken again.
        state.frames = {k: each for k, each in frames.items() if record.read(k) is not None}
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, *_: object) -> None:
        if error is not None and not self.state.frames:
            self.discard()
        elif error is not None:
            error.add_note("finished frames are kept, run again to continue")

    def keep(self, frame: int, data: NDArray[Any], seconds: float) -> None:
        """Write a frame whole or not at all, and its exposure."""
        self.keep_image(_name(frame), data)
        self.state.frames[frame] = seconds
        self.state.unmended.pop(frame, None)
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
# Patterns of a group, photographs that are tried of each, and failures without a frame that is kept
# after which the rig does not work.
_GROUP, _TRIES, _FAILURES = 8, 8, 32


@dataclass(frozen=True)
class Step:
    """Progress of a session after a frame."""

    # Numbers of frames.
    done: int
    total: int
    # Share of the last frame's samples that clip.
    clipped: float


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
    # Whether a second photograph has to agree.
    check: bool = True
    # Called with a `Step` after each frame.
    progress: Callable[[Step], None] | None = None
    # The number of the image that is shown now; taking the references ends with white.
    _shown: int = _WHITE
    # Levels above black a second of patterns that were photographed last.
    _lights: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    _failures: int = 0

    def run(self, count: int | None = None) -> None:
        """Take what is missing of all frames, or of the first `count`.

        An error of a device or the disk leaves those written.
        """
        wanted = range(self.patterns.count if count is None else count)
        # Patterns that were given up get a second chance, now that the trouble may be over.
        for _ in range(2):
            missing = [k for k in wanted if k not in self.record.state.frames]
            for start in range(0, len(missing), _GROUP):
                self._lights = {k: light for k, light in self._lights.items() if k == self._shown}
                # Photographs of what is left, each with the number of the image before it.
                left: dict[int, list[tuple[Shot, int]]] = {
                    k: [] for k in missing[start : start + _GROUP]
                }
                for turn in range(_TRIES):
                    # Backwards from the last but one, since the last is shown already.
                    order = [*left] if turn % 2 == 0 else [*left][-2::-1] + [*left][-1:]
                    for k in order:
                        if self._take(k, left[k]):
                            del left[k]
                self.record.save()

    def _take(self, k: int, others: list[tuple[Shot, int]]) -> bool:
        """Photograph a pattern; whether the frame is kept, as it agrees with one of the others."""
        befores = {before for _, before in others}
        try:
            if self._shown == k or self._shown in befores:
                self._show_other(k, befores)
            before, self._shown = self._shown, k
            shot = self.photographer.take(self.image(k), float(self.exposures[k]))
        except UntrustedFrameError as error:
            self._fail(k, error.message)
            return False
        levels = shot.frame.data
        above = levels.astype(np.float32) - self.references.dark_at(shot.exposure)
        self._lights[k] = above / np.float32(shot.exposure)
        if self.check and not any(self._agree(shot, before, *other) for other in others):
            if others:
                self._fail(k, "photographs of the pattern differ")
            others.append((shot, before))
            return False
        self._failures = 0
        self.record.keep(k, levels, shot.exposure)
        if self.progress is not None:
            clipped = float((levels >= shot.frame.clip_level).mean())
            done, total = len(self.record.state.frames), self.patterns.count
            self.progress(Step(done, total, clipped))
        return True

    def _agree(self, shot: Shot, before: int, other: Shot, other_before: int) -> bool:
        """Whether two photographs agree; after the same image, both may show that, late."""
        if before == other_before:
            return False
        shown = {_BLACK: np.zeros_like(self.references.light), **self._lights}
        shown[_WHITE] = self.references.light / np.float32(self.references.white.exposure)
        lights = [
            np.float32(shot.exposure) * shown[k] for k in (before, other_before) if k in shown
        ]
        return self.references.agree(shot.frame.data, other.frame.data, shot.exposure, lights)

    def _show_other(self, k: int, befores: set[int]) -> None:
        """Photograph an image that is neither pattern k nor one of `befores`.

        A driver that hands out an old buffer once more hands out this one.
        """
        count = self.patterns.count
        others = [_BLACK, _WHITE, *((k + step) % count for step in range(1, count))]
        self._shown = next((each for each in others if each not in befores), _BLACK)
        plain = dict(zip((_BLACK, _WHITE), plain_images(self.photographer.rig), strict=True))
        image = plain[self._shown] if self._shown in plain else self.image(self._shown)
        self.photographer.take(image, float(self.exposures[k]))

    def _fail(self, k: int, reason: str) -> None:
        """Count a fault, with N for the numbers that make each one differ."""
        words = " ".join("N" if word.strip(".,:%").isdigit() else word for word in reason.split())
        state = self.record.state
        state.faults[words] = state.faults.get(words, 0) + 1
        state.unmended[k] = reason
        self._failures += 1
        if self._failures == _FAILURES:
            raise DeviceError(
                f"{_FAILURES} photographs in a row could not be kept; the last: {reason}",
                hint="mend it and run again: the frames so far are kept; if pictures come later "
                "than before, measure that: `lightmatrix rig settle`",
            )
