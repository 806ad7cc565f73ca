"""The loop: shows, waits, grabs, checks, keeps, and takes again what is not right.

A frame is kept only if it can be right (`taking.py`), and trusted only if it is shown to be. Either
it meets what the other frames predict for its pattern, and nothing of what was shown before is in
it: the prediction tells (`watching.py`), or a photograph straight after it, since a picture that
came within the exposure is whole by then. Or it agrees with a second photograph before which
something else was shown, so that nothing late can be in both (`agreement.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError
from lightmatrix.live.frames.pattern_match import Watch, watched_samples
from lightmatrix.live.frames.photograph import Shot, Taker, UntrustedFrameError
from lightmatrix.live.frames.repeats import take_steady
from lightmatrix.live.frames.same_light import Drift, References, drift
from lightmatrix.live.record import Record, Taken
from lightmatrix.patterns.pattern_set import PatternSet

# A frame, and what was shown before it.
Rival = tuple[NDArray[np.generic], int]
# Photographs of a pattern before it is given up: one, and three more.
TRIES = 4
# Share of bad frames up to which the others, judged by them too, need not be judged anew.
_FEW_BAD = 0.1
# Patterns given up one after the other before the session is.
_MOST_UNMENDED = 4
# What was shown before a pattern, where it was no pattern.
_BLACK, _WHITE = -1, -2
MATCHED, CONFIRMED, UNCHECKED = "matched", "confirmed", "unchecked"


@dataclass(frozen=True)
class Step:
    """Where a session stands; what progress is told.

    Parameters
    ----------
    done, total : int
        Frames.
    clipped : float
        Share of the last frame's samples that clip.
    check : str
        What became of the last frame.
    """

    done: int
    total: int
    clipped: float
    check: str


@dataclass(eq=False)
class Session:
    """Photographs all patterns.

    Parameters
    ----------
    taker : Taker
    record : Record
        What was taken already, and where frames go.
    patterns : PatternSet
        K patterns.
    image : callable
        The image (rows, cols) uint8 that the projector is given for a pattern.
    exposures : (K,) float64
        Seconds of each frame.
    references : References
    check : bool
        Whether frames have to be shown to be right.
    reference_every : int
        Frames between two looks at the reference; 0 for none.
    progress : callable, optional
        Called with a `Step` after each frame.
    """

    taker: Taker
    record: Record
    patterns: PatternSet
    image: Callable[[int], NDArray[np.uint8]]
    exposures: NDArray[np.float64]
    references: References
    check: bool = True
    reference_every: int = 32
    progress: Callable[[Step], None] | None = None
    _watch: Watch = field(init=False)
    _samples: NDArray[np.int64] = field(init=False)
    # The pattern shown last, or black or white; the references end with white.
    _before: int = _WHITE

    def __post_init__(self) -> None:
        light, rows = self.references.light, self.references.light.shape[0]
        self._samples, beside = watched_samples(light, self.patterns)
        per_row = light.size // rows
        dark = self._dark(float(self.exposures.max()))
        ceiling = (self.references.white.clip_level - dark) / self.exposures.max()
        self._watch = Watch(
            self.patterns,
            self._samples // per_row,
            ceiling[self._samples].astype(np.float32),
            beside,
        )

    def run(self) -> None:
        """Take all frames that are not there yet.

        Raises
        ------
        DeviceError
            If one frame after the other cannot be taken.
        OutputError
            If the disk fails; frames that were written remain.
        """
        for k in self.record.state.frames:
            frame = self.record.read(k)
            assert frame is not None
            self._note(k, frame, self.record.state.frames[k].exposure)
        for _ in range(2):
            # Once more for those that could not be mended, now that the trouble may be over.
            self._take_all([k for k in range(self.patterns.count) if k not in self._taken])
            self._look_back()
        self._confirm_rest()

    # ---- frames

    @property
    def _taken(self) -> dict[int, Taken]:
        return self.record.state.frames

    def _take_all(self, missing: list[int]) -> None:
        unmended = 0
        for count, k in enumerate(missing):
            if self.reference_every and count % self.reference_every == self.reference_every - 1:
                self._look_at_reference()
            unmended = 0 if self._take(k) else unmended + 1
            if unmended == _MOST_UNMENDED:
                reason = self.record.state.unmended[k]
                raise DeviceError(
                    f"{unmended} patterns in a row could not be photographed, {TRIES} tries each; "
                    f"the last: {reason}",
                    hint="mend it and run again: the frames so far are kept",
                )
            self._learn_now_and_then()

    def _take(self, k: int, rival: Rival | None = None) -> bool:
        """Photograph a pattern until a frame is right; whether one is.

        Parameters
        ----------
        k : int
            Number of the pattern.
        rival : (array, int), optional
            A frame of it that was complained of, or could not be judged, and what was shown
            before it: one that agrees with it confirms both.
        """
        doubted: list[Rival] = [] if rival is None else [rival]
        reason = ""
        for tried in range(1, TRIES + 1):
            try:
                # After black or white no small share of them would be seen in a frame.
                if tried > 1 or rival is not None or self._before < 0:
                    self._show_other(k, {before for _, before in doubted})
                shot = self.taker.take(self.image(k), float(self.exposures[k]))
                before, self._before = self._before, k
            except UntrustedFrameError as error:
                reason = error.message
                self._count(reason)
                self._before = k
                continue
            self._note(k, shot.data, shot.exposure)
            taken = Taken(shot.exposure, shot.frame.id, shot.delay, before, tried, UNCHECKED)
            complaint = self._judge(k, taken, shot, doubted) if self.check else None
            if complaint is None:
                self.record.keep(k, shot.data, taken)
                self._tell(shot, taken.check)
                return True
            reason = complaint
            self._count(reason)
            doubted.append((shot.data, before))
        self._watch.forget(k)
        self.record.state.unmended[k] = reason
        self.record.state.frames.pop(k, None)
        self.record.save()
        return False

    def _judge(self, k: int, taken: Taken, shot: Shot, doubted: list[Rival]) -> str | None:
        """What is wrong with a frame; None, and its check noted, if nothing is."""
        before, exposure = taken.before, taken.exposure
        for other, other_before in doubted:
            # After the same picture, both may show that, late.
            if before != other_before and self.references.agree(
                shot.data, other, exposure, self._lights((before, other_before), exposure)
            ):
                taken.check = CONFIRMED
                return None
        if self._watch.predictive:
            if (complaint := self._watch.complaint(k, before)) is not None:
                return complaint
        elif doubted:
            # With another photograph to compare with, it has to agree.
            return "two photographs of the pattern differ"
        if not self._excludes(k, taken):
            try:
                after = self.taker.take(self.image(k), float(self.exposures[k]), settle=0.0)
            except UntrustedFrameError as error:
                return error.message
            lights = self._lights((before,), exposure)
            if not self.references.agree(shot.data, after.data, exposure, lights):
                return "a photograph straight after it differs"
            taken.still = True
        if self._watch.predictive:
            taken.check = MATCHED
        return None

    def _excludes(self, k: int, taken: Taken) -> bool:
        """Whether the prediction tells that nothing of what was shown before is in a frame."""
        noise = self.references.noise / taken.exposure
        return self._watch.predictive and self._watch.excludes(k, taken.before, noise)

    def _show_other(self, k: int, befores: set[int]) -> None:
        """Show another pattern than k and those before, so that none of these is in the next frame.

        Where nothing is predicted, patterns may be too much alike, as single pixels are, and frames
        are compared with each other: then it is black or white.
        """
        rig = self.taker.rig
        count = self.patterns.count
        others = ((k + step) % count for step in range(-1, -count, -1))
        other = next((j for j in others if j not in befores), None)
        if self._watch.predictive and other is not None:
            self._before, image = other, self.image(other)
        else:
            self._before = _WHITE if _BLACK in befores and _WHITE not in befores else _BLACK
            image = np.full(rig.projector.shape, 0 if self._before == _BLACK else 255, np.uint8)
        shown = rig.projector.show(image)
        rig.clock.sleep(shown + self.taker.settle - rig.clock.now())

    def _lights(self, shown: Iterable[int], exposure: float) -> list[NDArray[np.float32]]:
        """What a frame shows of each of some patterns, above black; of those that are known."""
        found = []
        shape = self.references.light.shape
        for k in shown:
            if k == _BLACK:
                found.append(np.zeros(shape, np.float32))
            elif k == _WHITE:
                scale = np.float32(exposure / self.references.white.exposure)
                found.append(scale * self.references.light)
            elif k in self._taken and (frame := self.record.read(k)) is not None:
                seconds = self._taken[k].exposure
                above = np.asarray(frame, np.float32) - self._dark(seconds).reshape(shape)
                found.append(np.float32(exposure / seconds) * above)
        return found

    # ---- what is known of them

    def _note(self, k: int, data: NDArray[np.generic], exposure: float) -> None:
        levels = np.asarray(data, np.float32).ravel()[self._samples]
        dark = self._dark(exposure)[self._samples]
        self._watch.put(k, ((levels - dark) / exposure).astype(np.float32))

    def _dark(self, exposure: float) -> NDArray[np.float32]:
        """The black frame at an exposure, (M,)."""
        long, short = self.references.black, self.references.white.exposure
        if long.exposure == short:
            return long.mean.ravel()
        share = (exposure - short) / (long.exposure - short)
        dark = self.references.dark + share * (long.mean - self.references.dark)
        return np.asarray(dark.ravel(), np.float32)

    def _learn_now_and_then(self) -> None:
        if self.check and self._watch.due:
            self._watch.learn()

    def _look_back(self) -> None:
        """Judge all frames by all others, and take again those that are not right."""
        if not self.check:
            return
        for _ in range(TRIES):
            self._watch.learn()
            if not self._watch.predictive:
                return
            bad = []
            for k, taken in sorted(self._taken.items()):
                if taken.check == CONFIRMED:
                    continue
                complaint = self._watch.complaint(k, taken.before)
                right = complaint is None and (taken.still or self._excludes(k, taken))
                taken.check = MATCHED if right else UNCHECKED
                if complaint:
                    bad.append(k)
                    self._count(complaint)
            self.record.save()
            self._again(bad)
            # What few frames explained wrongly changes no prediction much.
            if len(bad) <= _FEW_BAD * len(self._taken):
                return

    def _confirm_rest(self) -> None:
        """Photograph a second time what could not be judged."""
        if self.check:
            self._again([k for k, taken in self._taken.items() if taken.check == UNCHECKED])

    def _again(self, frames: list[int]) -> None:
        for k in sorted(frames):
            frame = self.record.read(k)
            self._watch.forget(k)
            self._take(k, None if frame is None else (frame, self._taken[k].before))

    def _look_at_reference(self) -> None:
        """See whether light, scene or room changed."""
        seen = self._reference_now(1)
        if seen is None or seen.said() is not None:
            # One that was lost is no look, and a late or torn one no drift.
            seen = self._reference_now(3)
        if seen is not None:
            self.record.state.drift.append({"frames": len(self._taken), **asdict(seen)})

    def _reference_now(self, count: int) -> Drift | None:
        shape = self.taker.rig.projector.shape
        start, frames = self.references, []
        self._before = _BLACK
        for level, reference in ((255, start.white), (0, start.black)):
            image = np.full(shape, level, np.uint8)
            try:
                if count > 1:
                    frames.append(take_steady(self.taker, image, reference.exposure, count).mean)
                else:
                    shot = self.taker.take(image, reference.exposure)
                    frames.append(shot.data.astype(np.float32))
            except DeviceError as error:
                self._count(error.message)
                return None
        return drift(start, frames[0], frames[1])

    def _count(self, reason: str) -> None:
        """Note a fault, without the numbers that make each one differ."""
        words = " ".join("N" if word.strip(".,:%").isdigit() else word for word in reason.split())
        faults = self.record.state.faults
        faults[words] = faults.get(words, 0) + 1

    def _tell(self, shot: Shot, check: str) -> None:
        if self.progress is not None:
            clipped = float((shot.data >= shot.frame.clip_level).mean())
            self.progress(Step(len(self._taken), self.patterns.count, clipped, check))
