"""Pictures that come within the exposure, on many virtual rigs, and what of them is kept.

`python -m benchmarks.rig_mixtures --count 20` takes a capture with each of so many rigs. Every
fifth picture comes so late that the one before it has 0.1 to 30 % of the exposure.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.making import make_patterns
from lightmatrix.rig.capturing import CaptureSettings, take_capture
from lightmatrix.rig.devices.virtual import VirtualCamera, VirtualProjector
from lightmatrix.rig.rig import open_rig

SETTLE, EXPOSURE = 0.05, 0.02
NOISE = 0.003 * 4095
_RIG = "virtual:procedural,real=0,fps=0"
# Patterns of each capture.
_COUNT = 40


class Mixed(NamedTuple):
    """What a photograph has of a picture that was to be gone."""

    # Share of the exposure that shows the other picture.
    share: float
    # What it adds to a sample or takes away (root mean square), in deviations of the noise.
    light: float


@contextmanager
def come_within(seed: int) -> Iterator[dict[bytes, Mixed]]:
    """Let pictures come within the exposure; gives the photographs that were mixed by that."""
    draw = np.random.default_rng([seed, 16])
    show, expose = VirtualProjector.show, VirtualCamera._expose
    mixed: dict[bytes, Mixed] = {}

    shown = 0

    def late(self: VirtualProjector, image: NDArray[np.uint8]) -> float:
        nonlocal shown
        when = show(self, image)
        shown += 1
        # The first forty pictures, before the first pattern, are black or white.
        if shown > 40 and draw.random() < 0.2:
            share = np.exp(draw.uniform(np.log(0.001), np.log(0.3)))
            _, light = self._light._shown.pop()
            # The exposure begins a moment after the trigger.
            self._light._shown.append((when + SETTLE + 1e-4 + share * EXPOSURE, light))
        return when

    def noted(self: VirtualCamera, start: float, stop: float, number: int) -> NDArray[Any]:
        data = expose(self, start, stop, number)
        since, light = self._light._shown[-1]
        if start < since < stop:
            apart = self._light.between(start, stop) - self._light.room - light
            level = np.sqrt((apart**2).mean()) * (stop - start) / self._settings.unit * 4031
            share = (since - start) / (stop - start)
            mixed[data.tobytes()] = Mixed(share, float(level) / NOISE)
        return data

    with (
        mock.patch.object(VirtualProjector, "show", late),
        mock.patch.object(VirtualCamera, "_expose", noted),
    ):
        yield mixed


def run(seed: int) -> tuple[list[Mixed], list[Mixed], int]:
    """The mixed photographs that one capture met, those that it kept, and patterns left out."""
    size = (16, 24)[seed % 2]
    patterns = make_patterns("mix", (size, size), _COUNT, seed=seed)
    with (
        open_rig(f"{_RIG},size={size},seed={seed}") as rig,
        tempfile.TemporaryDirectory() as folder,
        come_within(seed) as mixed,
    ):
        settings = CaptureSettings(exposure=EXPOSURE, settle=SETTLE)
        capture = take_capture(
            Path(folder) / "capture", rig, patterns, settings=settings, keep=None
        )
        frames = [capture.frame(k).tobytes() for k in range(capture.count)]
    kept = [mixed[frame] for frame in frames if frame in mixed]
    return list(mixed.values()), kept, _COUNT - capture.count


def main() -> int:
    """Run many, and tell what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    met: list[Mixed] = []
    kept: list[Mixed] = []
    left_out = 0
    for seed in range(options.first, options.first + options.count):
        some, remaining, without = run(seed)
        met += some
        kept += remaining
        left_out += without
        print(f"{seed}: {len(some)} mixed photographs, {len(remaining)} kept", flush=True)
    for least, most in pairwise((0.001, 0.005, 0.01, 0.02, 1.0)):
        total, remained = (
            sum(least <= one.share < most for one in photographs) for photographs in (met, kept)
        )
        print(
            f"shares of {100 * least:g} to {100 * most:g} %: {total} photographs, {remained} kept"
        )
    worst = max((one.light for one in kept), default=0.0)
    print(f"the most that was kept: {worst:.2f} standard deviations of the noise")
    print(f"{left_out} patterns left out")
    # The noise itself passes 1.5 standard deviations now and then; no more must be left.
    return int(worst > 1.5 or left_out > 0)


if __name__ == "__main__":
    sys.exit(main())
