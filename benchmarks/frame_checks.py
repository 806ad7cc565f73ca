"""How often each fault of a capture is found and named, and how often intact ones are accused.

    python -m benchmarks.frame_checks [--draws 20] [--intact 200] [--seed 0] [-o checks.json]

Captures are drawn at random: one of the bundled 64 x 64 scenes under 32 to 128 Bernoulli patterns,
at an exposure between the planned one, at which white just does not clip, and the one at which a
fifth of the rows clip under a single projector pixel; read noise 0.001 to 0.01, shot noise up to
0.02, black level up to 10, and room light up to a fifth of a white image, with its black frame, in
one half of them. Each gets every fault once, at a random place; all is done to the light that has
to change there, before the camera, or else to the levels of its frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.harness import markdown, write_json
from experiments.harness import options as options_of
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.check.all_checks import missing_places
from lightmatrix.check.finding import Finding
from lightmatrix.check.survey import Survey
from lightmatrix.estimators.rig_findings import check
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import irradiance

COUNTS = (32, 48, 64, 96, 128)
SHIFT = 2
FLICKER = 0.05

Images = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Draw:
    """One capture: light that arrives, and the camera that takes it."""

    scene: str
    patterns: PatternSet
    room: NDArray[np.float32]
    sensor: Sensor
    shape: tuple[int, ...]
    seed: int

    @cached_property
    def light(self) -> NDArray[np.float32]:
        """What arrives of the projector at exposure 1, (M, K)."""
        return irradiance(library.truth(self.scene).matrix, self.patterns)

    def frames(self, gain: NDArray[np.float64] | float = 1.0) -> Images:
        """Photographs, (K, rows, cols); the projector's light times a gain for each."""
        raw = self.sensor.expose(self.light * gain + self.room[:, None], seed=self.seed)
        return np.ascontiguousarray(raw.T).reshape(-1, *self.shape)

    def capture(self, frames: Images) -> Capture:
        """Frames, decoded as this camera's."""
        decoder = self.sensor.decoder()
        if self.room.any():
            black = self.sensor.expose(self.room[:, None], seed=self.seed, first_frame=len(frames))
            decoder = replace(decoder, black_frame=black.ravel())
        return Capture.from_arrays(self.patterns, frames, decoder)

    def check(self, frames: Images) -> list[Finding]:
        """What is wrong with them."""
        return check(self.capture(frames))


def draws(number: int, seed: int) -> Iterator[Draw]:
    """Captures drawn at random, the scenes in turn."""
    generator = np.random.default_rng(seed)
    for index in range(number):
        name = library.BUNDLED[index % len(library.BUNDLED)]
        truth = library.truth(name)
        white = np.asarray(truth.matrix.sum(axis=1), np.float32).ravel()
        strongest = truth.matrix.max(axis=1).toarray().ravel()
        ends = np.log([1 / np.quantile(white, 0.999), 1 / np.quantile(strongest, 0.8)])
        patterns = BernoulliPatterns(
            library.BUNDLED_SIZE,
            int(generator.choice(COUNTS)),
            float(generator.choice([0.5, 0.5, 0.25])),
            int(generator.integers(1 << 30)),
        )
        room = generator.uniform(0, 0.2) * generator.integers(2) * white.mean()
        sensor = Sensor(
            exposure=float(np.exp(generator.uniform(*ends))),
            black_level=float(generator.integers(0, 11)),
            read_noise=float(np.exp(generator.uniform(*np.log([0.001, 0.01])))),
            shot_noise=float(generator.uniform(0, 0.02)),
        )
        yield Draw(
            name,
            patterns,
            (room * white / white.mean()).astype(np.float32),
            sensor,
            truth.camera_shape,
            int(generator.integers(1 << 30)),
        )


def swapped(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    frames = draw.frames()
    a, b = sorted(int(k) for k in generator.choice(len(frames), 2, replace=False))
    frames[[a, b]] = frames[[b, a]]
    findings = draw.check(frames)
    return findings, any(f.kind == "order" and {a, b} == set(f.frames) for f in findings)


def dropped(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    """One frame fewer than patterns."""
    frames = draw.frames()
    place = int(generator.integers(len(frames)))
    rest = np.delete(frames, place, axis=0)
    kept = draw.patterns.subset(np.arange(len(rest)))
    decoder = draw.sensor.decoder()
    capture = Capture.from_arrays(kept, rest, decoder)
    survey = Survey.take(capture.patterns, capture.frames, decoder)
    named = missing_places(replace(survey, patterns=draw.patterns))
    return [Finding("counts", named, "", "")], named == (place,)


def dropped_and_filled(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    """One frame missing, and the last there twice."""
    frames = draw.frames()
    place = int(generator.integers(1, len(frames) - 3))
    findings = draw.check(np.concatenate([np.delete(frames, place, axis=0), frames[-1:]]))
    near = [f for f in findings if f.kind == "order" and abs(min(f.frames) - place) <= 1]
    return findings, bool(near)


def blackened(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    place = int(generator.integers(draw.patterns.count))
    gain = np.ones(draw.patterns.count)
    gain[place] = 0
    findings = draw.check(draw.frames(gain))
    return findings, any(f.kind == "frame" and f.frames == (place,) for f in findings)


def coded(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    levels = np.rint(255 * (draw.frames() / 255.0) ** (1 / 2.2)).astype(np.uint8)
    black = float(np.rint(255 * (draw.sensor.black_level / 255) ** (1 / 2.2)))
    # Whoever measures the black level of such a camera measures it coded.
    camera = replace(draw, sensor=replace(draw.sensor, black_level=black))
    findings = (replace(camera, room=0 * draw.room) if draw.room.any() else camera).check(levels)
    return findings, any(f.kind == "camera-curve" for f in findings)


def compressed(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    """Saved as JPEG at quality 60; the files' names do not say so."""
    coded = [encode_image(f, "jpeg", quality=60) for f in draw.frames()]
    findings = draw.check(np.stack([decode_image(each) for each in coded]))
    return findings, any(f.kind == "jpeg" for f in findings)


def shifted(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    """Shifted by 2 pixels to one side from the middle on; the border repeats."""
    frames = draw.frames()
    middle = len(frames) // 2
    axis, way = int(generator.integers(1, 3)), int(generator.choice([-SHIFT, SHIFT]))
    late = np.roll(frames[middle:], way, axis=axis)
    edge = [slice(None)] * 3
    edge[axis] = slice(0, SHIFT) if way > 0 else slice(-SHIFT, None)
    late[tuple(edge)] = frames[middle:][tuple(edge)]
    findings = draw.check(np.concatenate([frames[:middle], late]))
    return findings, any(f.kind == "motion" and abs(f.frames[0] - middle) <= 2 for f in findings)


def flickering(draw: Draw, generator: np.random.Generator) -> tuple[list[Finding], bool]:
    """The light goes up and down by 5 % in the beat of camera and lamp."""
    beat = generator.uniform(0.3, 3) * np.arange(draw.patterns.count) + generator.uniform(0, 6)
    findings = draw.check(draw.frames(1 + FLICKER * np.sin(beat)))
    return findings, any(f.kind in ("gain", "exposure") for f in findings)


FAULTS: dict[str, Callable[[Draw, np.random.Generator], tuple[list[Finding], bool]]] = {
    "two frames swapped": swapped,
    "one frame dropped": dropped,
    "one dropped, the last twice": dropped_and_filled,
    "one frame black": blackened,
    "gamma 2.2": coded,
    "JPEG at quality 60": compressed,
    "shifted 2 px from the middle on": shifted,
    "flicker of 5 %": flickering,
}


def main() -> None:
    parser = options_of("benchmarks.frame_checks", __doc__)
    parser.add_argument("--draws", type=int, default=20, help="captures that get every fault")
    parser.add_argument("--intact", type=int, default=200, help="captures without fault")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="say what was missed or wrong")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows = faulty(options.draws, options.seed, options.verbose)
    print(table(rows))
    accused = intact(options.intact, options.seed + 1000, options.verbose)
    print(f"{accused} of {options.intact} intact captures were accused")
    if options.output:
        write_json(options.output, {"rows": rows, "accused": accused})


def faulty(number: int, seed: int, verbose: bool = False) -> list[dict[str, object]]:
    """The findings of captures with a fault."""
    generator = np.random.default_rng(seed)
    rows = []
    for draw in draws(number, seed):
        for fault, make in FAULTS.items():
            findings, named = make(draw, generator)
            row = {
                "fault": fault,
                "scene": draw.scene,
                "frames": draw.patterns.count,
                "exposure": draw.sensor.exposure,
                "found": bool(findings),
                "named": named,
                "kinds": [each.kind for each in findings],
            }
            rows.append(row)
            if verbose and (not named or len(findings) > 1):
                print(row, [each.message for each in findings], flush=True)
    return rows


def intact(number: int, seed: int, verbose: bool = False) -> int:
    """How many intact captures are accused of something."""
    accused = 0
    for draw in draws(number, seed):
        findings = draw.check(draw.frames())
        accused += bool(findings)
        if verbose and findings:
            print(draw.scene, draw.patterns.count, draw.sensor, findings, flush=True)
    return accused


def table(rows: list[dict[str, object]]) -> str:
    """Named of tried, by fault and scene."""
    lines = []
    for fault in FAULTS:
        cells = [fault]
        for scene in (*library.BUNDLED, None):
            some = [r for r in rows if r["fault"] == fault and scene in (r["scene"], None)]
            cells.append(f"{sum(bool(r['named']) for r in some)} of {len(some)}")
        lines.append(cells)
    return markdown(["fault", *library.BUNDLED, "all"], lines)


if __name__ == "__main__":
    main()
