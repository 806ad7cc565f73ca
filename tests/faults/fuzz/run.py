"""One mutation by its number: damage, command, verdict."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np

from ..case import Case, Limits, Outcome, SkipError, judge
from ..snapshot import snapshot
from ..work import copy_work
from ..zygote import run_command
from .subjects import SUBJECTS

# Images and captures are read most often, and in most ways.
ORDER = ("image", "store", "capture", "archive", "image", "store", "partial", "capture", "archive")
# Seconds and bytes that a small input may take. An accidental decompression bomb exceeds the memory
# and ends with exit code 3.
_SECONDS = 20.0
_MEMORY = 2 << 30


def run_one(number: int, template: Path) -> tuple[Outcome, str, float]:
    """What became of mutation `number`: the same for the same number."""
    name = ORDER[number % len(ORDER)]
    subject = SUBJECTS[name]
    draw = np.random.default_rng([zlib.crc32(name.encode()), number])
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=template.parent) as base:
        place = Path(base) / "outer" / "work"
        copy_work(template, place, subject.needs)
        (Path(base) / "tmp").mkdir()
        os.environ["TMPDIR"] = str(Path(base) / "tmp")
        try:
            words = subject.damage(draw, place)
        except SkipError as reason:
            return Outcome.SKIPPED, str(reason), 0.0
        command = subject.commands[int(draw.integers(len(subject.commands)))]
        picture = next(iter(place.glob("picture.*")), Path())
        command = command.replace("{suffix}", picture.suffix)
        case = Case(words, command, code=(0, 2, 3), makes=subject.makes, leaves=_kept(name))
        before = snapshot(Path(base))
        ran = run_command(command, place, limits=Limits(memory=_MEMORY), seconds=_SECONDS)
        outcome, detail = judge(case, ran, before, snapshot(Path(base)))
        if outcome is Outcome.FINE:
            if name == "store":
                shutil.copytree(template / "scene.zarr", place / "sound.zarr")
            try:
                complaint = subject.sane(place, words)
            except ValueError as error:
                complaint = str(error)
            if complaint:
                outcome, detail = Outcome.ACCEPTED_WRONGLY, complaint
    return outcome, f"{name}: {words}; `{command}`: {detail}", time.perf_counter() - started


def _kept(name: str) -> tuple[str, ...]:
    """What may be changed although a command is refused: damaged tiles may be swept."""
    return ("new.zarr.partial",) if name == "partial" else ()
