"""Captures of a virtual rig that fails in every way it can, and is killed: are they still right?

`python -m tests.rig.rig_faults --count 200` runs many; `make live-faults N=200` does it.

Each run draws a scene, a camera, and times for its faults, at fixed rates. It is killed
(SIGKILL) at random moments, meets a disk that takes no more (a small one of its own where root may
mount it, else a limit on the size of files), and goes on each time. In the end each frame is held
against what its pattern alone gives, pixel by pixel.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import LightMatrixError, OutputError
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import to_grey
from lightmatrix.rig.capturing import take_capture
from lightmatrix.rig.devices.virtual import VirtualSettings
from lightmatrix.rig.rig import Rig

from .faulty_rig import Faults, faulty, levels_of
from .small_disk import SmallDisk, small_disk

if sys.platform != "win32":
    import resource

_FULL, _DONE, _BROKEN = 3, 0, 4
_PATIENCE = 120.0


@dataclass
class Outcome:
    """What became of a run."""

    # Ends of the capture before its own.
    kills: int = 0
    full_disks: int = 0
    # Photographs that were taken again, by reason.
    again: Counter[str] = field(default_factory=Counter)
    # Patterns that were named as without a frame, and frames that are not those of their patterns.
    left_out: int = 0
    wrong: list[str] = field(default_factory=list)


def rig_of(seed: int) -> Rig:
    """The rig of a run."""
    draw = np.random.default_rng([seed, 14])
    settings = VirtualSettings(
        scene="procedural",
        size=int(draw.choice([16, 24])),
        delay=float(draw.integers(0, 6)),
        fps=float(draw.choice([0, 30, 29.97, 55])),
        seed=seed,
        real=0,
    )
    faults = Faults(
        unplugged=5.0,
        # Frames begin after 3 s, or 17 s where the rig is not known yet.
        unplugged_at=float(draw.uniform(2, 25)),
        altered=float(draw.choice([0.5, 2.0])),
        altered_at=float(draw.uniform(2, 25)),
        late=0.05,
        dropped=0.03,
        duplicate=0.02,
        torn=0.01,
    )
    return faulty(settings, faults)


def _photograph(folder: Path, seed: int, count: int, largest_file: int | None) -> None:
    """One attempt at the capture, in a process of its own."""
    warnings.simplefilter("ignore")
    code = _DONE
    try:
        with rig_of(seed) as rig:
            patterns = make_patterns("mix", rig.projector.shape, count, seed=seed)
            if largest_file is not None:
                # As a full disk does, it lets a part of a file be written.
                resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
            take_capture(folder / "capture", rig, patterns, keep=folder / "rig.json")
    except OutputError:
        # Nothing is printed: the limit on files holds for a log too.
        code = _FULL
    except LightMatrixError as error:
        print(error, file=sys.stderr)
        code = _BROKEN
    sys.exit(code)


def run(folder: Path, seed: int, *, count: int = 40, kills: int = 3) -> Outcome:
    """Take a capture, killed and robbed of its disk meanwhile, and look at what comes of it."""
    with small_disk(folder) as disk:
        return _run(folder, disk, seed, count, kills)


def _run(folder: Path, disk: SmallDisk | None, seed: int, count: int, kills: int) -> Outcome:
    outcome = Outcome()
    draw = np.random.default_rng([seed, 15])
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["lightmatrix.rig.capturing", "tests.rig.faulty_rig"])
    robbed = False
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        if (folder / "capture").exists():
            # Killed when it had just finished.
            break
        largest, full = None, outcome.kills >= kills // 2 and not robbed
        if full:
            robbed = True
            if disk is not None:
                disk.leave(int(draw.integers(0, 200 << 10)))
            else:
                largest = int(draw.integers(200, 1500))
        process = context.Process(target=_photograph, args=(folder, seed, count, largest))
        process.start()
        if outcome.kills < kills and not full:
            process.join(float(draw.uniform(0.05, 0.8)))
            if process.is_alive():
                process.kill()
                outcome.kills += 1
        process.join()
        if full and disk is not None:
            disk.free()
        if process.exitcode == _FULL and full:
            outcome.full_disks += 1
        elif process.exitcode == _DONE:
            break
        elif process.exitcode != -9:
            outcome.wrong.append(f"ended with {process.exitcode}")
            return outcome
    else:
        outcome.wrong.append("did not end")
        return outcome
    capture = Capture.open(folder / "capture")
    outcome.again.update(capture.provenance["photographed_again"])
    outcome.left_out = len(capture.provenance["left_out"])
    outcome.wrong += wrong_frames(capture, rig_of(seed))
    return outcome


def wrong_frames(capture: Capture, rig: Rig) -> list[str]:
    """Frames of a virtual rig that are not what their pattern alone gives, pixel by pixel.

    No sample may be off by more than 6.5 standard deviations of its noise, 0.3 % of 12 bits.
    """
    seconds = capture.exposures * capture.provenance["exposure_1_in_seconds"]
    wrong = []
    for k in range(capture.count):
        image = to_grey(capture.patterns.images(k, k + 1)[0])
        level = levels_of(rig, image, seconds[k])
        far = np.abs(capture.frame(k).ravel() - level) / (0.003 * 4095)
        if far.max() > 6.5:
            rows = (far.reshape(capture.camera_shape) > 6.5).any(axis=1).sum()
            wrong.append(f"frame {k}: {far.max():.0f} deviations off, in {rows} rows")
    return wrong


def main() -> int:
    """Run many, and tell what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kills", type=int, default=20)
    options = parser.parse_args()
    total = Outcome()
    for seed in range(options.first, options.first + options.count):
        with tempfile.TemporaryDirectory() as folder:
            # Every other one lives longer, and meets more faults in one life.
            most = options.kills if seed % 2 else seed // 2 % (options.kills + 1)
            outcome = run(Path(folder), seed, kills=most)
        total.again += outcome.again
        total.kills += outcome.kills
        total.full_disks += outcome.full_disks
        total.left_out += outcome.left_out
        total.wrong += [f"run {seed}: {what}" for what in outcome.wrong]
        print(f"run {seed}: {outcome}", flush=True)
    print(f"{options.count} runs: {total}")
    return 1 if total.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
