"""The record of a capture while it is taken: its frames, and what is known of each.

`<output>.partial` holds the frames as image files, and `session.json`, which describes them. A
session that was stopped, however that happened, goes on there. When all frames are taken, they
become a capture folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError
from lightmatrix.files.images import fill_image, is_grey, read_image
from lightmatrix.files.kinds import PARTIAL
from lightmatrix.files.running import RunningResults
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import jsonable

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


@dataclass(frozen=True, eq=False)
class CaptureFacts:
    """What the finished capture states besides its frames; see `write_capture`."""

    # (frames,): relative exposures of the frames that were taken, in their order.
    exposures: NDArray[np.float64]
    # (rows, cols[, channels]): the black frame, and its relative exposure.
    black: NDArray[np.float32]
    black_exposure: float
    # Raw levels at which the camera clips, and without any light.
    clip_level: float
    black_level: float
    response: str
    provenance: Mapping[str, Any]


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

    def write(
        self,
        folder: Path,
        patterns: PatternSet,
        facts: CaptureFacts,
        write_extras: Callable[[Path], None],
        *,
        overwrite: bool = False,
    ) -> None:
        """Make a capture folder of the frames so far, and let `write_extras` add files."""
        numbers = sorted(self.state.frames)
        if len(numbers) < patterns.count:
            patterns = patterns.subset(np.array(numbers))
        same = np.ptp(facts.exposures) == 0
        frame = self.read(numbers[0])
        assert frame is not None
        black = facts.black
        images = (self.read(k) for k in numbers)
        if frame.ndim == 3 and all(image is not None and is_grey(image) for image in images):
            # Readers take files with three equal channels for grey images.
            black = black.mean(axis=2)
        sensor = Sensor(
            float(facts.exposures[0]) if same else facts.exposures,
            black_level=facts.black_level,
            bits=8 if frame.dtype == np.uint8 else 16,
            clip=facts.clip_level,
        )
        write_capture(
            folder,
            patterns,
            (self._results.file(_name(k)) for k in numbers),
            sensor=sensor,
            camera_shape=black.shape,
            black=black,
            black_exposure=facts.black_exposure,
            response=facts.response,
            provenance=facts.provenance,
            write_extras=write_extras,
            overwrite=overwrite,
        )


def _name(frame: int) -> str:
    # PNG is not used: compressing the noise of a large frame takes longer than photographing it.
    return f"image_{frame:04d}.tif"
