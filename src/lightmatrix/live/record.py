"""A capture on its way to disk: each frame whole or absent, and what is known of it.

While a capture is taken, `<output>.partial` holds its frames as image files and `session.json`,
which says what each is. A session that was ended, however that happened, goes on there. When all
frames are there, they become a capture folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.folder import write_capture
from lightmatrix.errors import InputError
from lightmatrix.files.images import fill_image, is_grey, read_image
from lightmatrix.outputs.kinds import PARTIAL
from lightmatrix.outputs.running import RunningResults
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import jsonable

_STATE = "session.json"
FORMAT, VERSION = "lightmatrix-session", 1


@dataclass
class Taken:
    """What is known of a frame.

    Parameters
    ----------
    exposure : float
        Seconds, as the camera said.
    id : int
        The camera's number of it.
    delay : float
        Seconds from the pattern being shown to the start of the exposure.
    before : int
        Number of the pattern shown before it; -1 for black, -2 for white.
    tries : int
        Photographs that it took.
    check : {"matched", "confirmed", "unchecked"}
        Whether it meets what the other frames predict for its pattern, agrees with a second
        photograph, or neither has been asked yet.
    still : bool
        Whether a photograph straight after it shows the same: no picture came within its exposure.
    """

    exposure: float
    id: int
    delay: float
    before: int
    tries: int
    check: str
    still: bool = False


@dataclass
class State:
    """What is known of all frames, JSON-ready.

    Parameters
    ----------
    frames : dict
        Number of a pattern -> what is known of its frame.
    faults : dict
        What was wrong with photographs that were taken again -> how often.
    unmended : dict
        Number of a pattern -> why there is no frame of it.
    drift : list of dict
        Of each look at the reference: frames taken before, gain, change, room.
    exposures : list of float
        Seconds that each frame is asked for.
    """

    frames: dict[int, Taken] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)
    unmended: dict[int, str] = field(default_factory=dict)
    drift: list[dict[str, float]] = field(default_factory=list)
    exposures: list[float] = field(default_factory=list)


class Record:
    """The running results of a capture; made by `open`. The caller holds the output's lock.

    In a ``with`` statement, an exception leaves the frames for the next run, if there are any.
    """

    def __init__(
        self, target: Path, kept: RunningResults, wanted: Mapping[str, Any], state: State
    ) -> None:
        self._target, self._kept, self._wanted, self.state = target, kept, wanted, state

    @classmethod
    def open(cls, target: Path, wanted: Mapping[str, Any], *, overwrite: bool = False) -> Record:
        """Begin, or go on with, a capture.

        Parameters
        ----------
        target : Path
            The output, as `claimed` gives it.
        wanted : mapping
            Everything that frames depend on, JSON-ready.
        overwrite : bool
            Whether frames of other patterns or another rig may be thrown away.

        Raises
        ------
        OutputError
            If there are such frames, or the disk fails.
        """
        asked = json.loads(json.dumps(dict(wanted), default=jsonable))
        kept = RunningResults.resume(
            target,
            PARTIAL,
            asked,
            file=_STATE,
            key="wanted",
            contents="frames of another capture",
            overwrite=overwrite,
        )
        found = kept.read_object(_STATE)
        if found is None:
            return cls(target, kept, asked, State())
        state = State(
            {int(k): Taken(**frame) for k, frame in found["frames"].items()},
            dict(found["faults"]),
            {},
            list(found["drift"]),
            [float(each) for each in found["exposures"]],
        )
        record = cls(target, kept, asked, state)
        # Listed, but written only in part or lost since: taken again.
        for k in [k for k in state.frames if record.read(k) is None]:
            del state.frames[k]
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None and not self.state.frames:
            self._kept.discard()

    # ---- frames

    def keep(self, frame: int, data: NDArray[Any], taken: Taken) -> None:
        """Write a frame, whole or not at all, and what is known of it.

        Raises
        ------
        OutputError
            If the disk fails; frames that were written remain.
        """
        self.state.frames.pop(frame, None)
        self.keep_image(self._name(frame), data)
        self.state.frames[frame] = taken
        self.state.unmended.pop(frame, None)
        self.save()

    def read(self, frame: int) -> NDArray[Any] | None:
        """A frame that was kept; None if there is none that can be read."""
        return self.read_image(self._name(frame))

    def keep_image(self, name: str, data: NDArray[Any]) -> None:
        """Keep an image under a name of its own, such as the reference."""
        with self._kept.keep(name) as part:
            fill_image(part, data)

    def read_image(self, name: str) -> NDArray[Any] | None:
        """What was kept under a name; None if it is not there or damaged."""
        if not self._kept.has(name):
            return None
        try:
            return read_image(self._kept.file(name))
        except InputError:
            return None

    def save(self) -> None:
        """Write down what is known of the frames.

        Raises
        ------
        OutputError
            If the disk fails.
        """
        content = {"format": FORMAT, "version": VERSION, "wanted": self._wanted}
        text = json.dumps({**content, **asdict(self.state)})
        with self._kept.keep(_STATE) as part:
            part.write_text(text + "\n")

    # ---- the end

    def finish(
        self,
        patterns: PatternSet,
        *,
        exposures: NDArray[np.float64],
        clip_level: float,
        camera_shape: tuple[int, ...],
        black: NDArray[np.float32],
        black_exposure: float,
        black_level: float,
        response: str,
        provenance: Mapping[str, Any],
        beside: Callable[[Path], None],
        overwrite: bool,
    ) -> None:
        """Make a capture folder of the frames, and sweep what was kept.

        Parameters
        ----------
        patterns : PatternSet
            All K patterns; those without a frame are left out.
        exposures : (frames,) float64
            Of the frames that there are, in their order.
        clip_level, camera_shape, black, black_exposure, black_level, response, provenance, beside
            See `write_capture`.
        overwrite : bool
            Whether an existing capture may be replaced.

        Raises
        ------
        OutputError
            If the folder cannot be written; the frames are still kept then.
        """
        there = sorted(self.state.frames)
        shown = patterns if len(there) == patterns.count else patterns.subset(np.array(there))
        one = float(exposures[0]) if np.ptp(exposures) == 0 else exposures
        frame = self.read(there[0])
        assert frame is not None
        if frame.ndim == 3 and all(map(self._is_grey, there)):
            # As it is read: colour cameras that are set to grey give three channels alike.
            camera_shape, black = camera_shape[:2], black.mean(axis=2)
        sensor = Sensor(
            one,
            black_level=black_level,
            bits=8 if frame.dtype == np.uint8 else 16,
            clip=clip_level,
        )
        write_capture(
            self._target,
            shown,
            (self._kept.file(self._name(k)) for k in there),
            sensor=sensor,
            camera_shape=camera_shape,
            black=black,
            black_exposure=black_exposure,
            response=response,
            provenance=provenance,
            beside=beside,
            overwrite=overwrite,
        )
        self._kept.discard()

    def _is_grey(self, frame: int) -> bool:
        image = self.read(frame)
        return image is not None and is_grey(image)

    def _name(self, frame: int) -> str:
        # Packing the noise of a large frame as PNG takes longer than photographing it.
        return f"image_{frame:04d}.tif"
