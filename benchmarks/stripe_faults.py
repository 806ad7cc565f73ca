"""Which faults of single photographs of stripes pass: `python -m benchmarks.stripe_faults`.

Captures of Gray code (with and without inverses), of Gray code with four shifts, and of micro phase
shifts, 64 x 64, 8 bits, read noise 0.003. One photograph is

- foreign: a new one of another pattern, 1, 3 or 5 places after its own, or 2 before,
- of other light: 0.6, 0.7, 0.8, 1.25 or 1.4 times as bright,
- missing: the others have moved up.

Or all have a curve (greys): a gamma of 1.2, 1.5 or 2.2 of the camera or of the projector. For each
fault and code it counts cases, those in which `check` says nothing, those in which it names other
photographs only, and the most places that differ by more than a pixel from those of the intact
capture, in per cent of the camera pixels, where `check` says nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm
from experiments.harness import options as options_of
from lightmatrix.check.all_checks import missing_places
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError

SCENES = ("l_objects", "metal", "corner", "gripper", "translucent")
CODES: dict[str, tuple[str, dict[str, Any]]] = {
    "Gray": ("graycode", {}),
    "Gray, inverse": ("graycode", {"inverse": True}),
    "Gray, 4 shifts": ("phase", {}),
    "micro phase": ("microphase", {}),
}
FACTORS = (0.6, 0.7, 0.8, 1.25, 1.4)
GAMMAS = (1.2, 1.5, 2.2)
# What `check` says of captures that have no such fault, too.
OTHER = ("stripes", "light")


@dataclass
class Count:
    """What became of the cases of a fault."""

    cases: int = 0
    silent: int = 0
    other: int = 0
    most_harm: float = 0.0


def photographs(
    scene: str, patterns: lm.PatternSet, seed: int, exposure: float
) -> tuple[NDArray[np.integer], lm.Decoder]:
    """Photographs (K, rows, cols) of 8 bits, and how they are read."""
    taken = lm.simulate(scene, patterns, exposure=exposure, noise=0.003, seed=seed)
    return np.stack([taken.frames.read(k) for k in range(patterns.count)]), taken.decoder


def damaged(
    scene: str, patterns: lm.PatternSet, exposure: float
) -> Iterator[tuple[str, tuple[int, ...], NDArray[np.integer]]]:
    """The fault, the frame that has it (none: all), and all photographs."""
    (plain, _), (again, _) = (photographs(scene, patterns, seed, exposure) for seed in (1, 2))
    count = patterns.count
    yield "intact", (), plain
    for k in range(count):
        for step in (1, 3, 5, -2):
            if 0 <= k + step < count:
                frames = plain.copy()
                frames[k] = again[k + step]
                yield "foreign", (k,), frames
        for factor in FACTORS if plain[k].max() > 20 else ():
            frames = plain.copy()
            frames[k] = np.clip(np.rint(frames[k] * factor), 0, 255)
            yield "of other light", (k,), frames
    for gamma in GAMMAS:
        yield "greys", (), np.rint(255 * (plain / 255) ** (1 / gamma)).astype(np.uint8)
        shown = lm.ImagePatterns(np.asarray(patterns.images() ** gamma, np.float32))
        yield "greys", (), photographs(scene, shown, 1, exposure)[0]


def measure(name: str, scene: str, exposure: float, counts: dict[str, Count]) -> None:
    """Add the cases of one code and scene."""
    kind, settings = CODES[name]
    patterns = lm.make_patterns(kind, (64, 64), **settings)
    plain, decoder = photographs(scene, patterns, 1, exposure)
    right = lm.decode(lm.Capture.from_arrays(patterns, plain, decoder), check=False)
    for fault, frame, frames in damaged(scene, patterns, exposure):
        if fault == "greys" and kind == "graycode":
            continue
        capture = lm.Capture.from_arrays(patterns, frames, decoder)
        found = [each for each in lm.check(capture) if each.kind not in OTHER]
        count = counts.setdefault(fault, Count())
        count.cases += 1
        count.silent += not found
        count.other += bool(found and frame and not any(frame[0] in e.frames for e in found))
        if not found:
            try:
                place = lm.decode(capture, check=False)
            except InputError:
                continue
            both = place.valid & right.valid
            apart = np.abs(place.place - right.place).max(axis=-1)[both] > 1
            count.most_harm = max(count.most_harm, round(100 * float(apart.mean()), 1))
    missing = counts.setdefault("missing", Count())
    for k in range(patterns.count):
        rest = lm.Capture.from_arrays(
            patterns.subset(np.delete(np.arange(patterns.count), k)),
            np.delete(plain, k, axis=0),
            decoder,
        )
        named = missing_places(Survey.take(patterns, rest.frames, decoder))
        missing.cases += 1
        missing.silent += not named
        missing.other += bool(named) and k not in named


def main(arguments: list[str] | None = None) -> None:
    """Count, and print a line of JSON for each code."""
    parser = options_of("benchmarks.stripe_faults", __doc__)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--exposure", type=float, default=0.3)
    options = parser.parse_args(arguments)
    for name in CODES:
        counts: dict[str, Count] = {}
        for scene in options.scenes.split(","):
            measure(name, scene, options.exposure, counts)
        print(json.dumps({name: {fault: vars(count) for fault, count in counts.items()}}))


if __name__ == "__main__":
    main()
