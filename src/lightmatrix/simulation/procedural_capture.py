"""Captures of a made-up scene of any size, row block by row block, straight to disk.

The matrix is never there as a whole, nor need the frames be: of a megapixel, T would take more than
a gigabyte, and at 1,024 patterns the frames as much.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposure_sequence import exposure_sequence, parse_exposures
from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.description import TRUTH
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.packing import write_packed
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import CAPTURE, PACKED_CAPTURE
from lightmatrix.outputs.writing import check_output
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import check_seed
from lightmatrix.resources.memory import check_room
from lightmatrix.resources.scratch import scratch_array
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.procedural_scene import ProceduralScene
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.sparse_rows import stacked

Progress = Callable[[int, int], None]
# What a scene is called that is made up rather than rendered.
PROCEDURAL = "procedural"
# Rows of T made at once, and samples of them photographed at once.
_ROWS, _SAMPLES = 1 << 13, 1 << 22
# Of patterns unpacked at once.
_PATTERN_BYTES = 256 << 20
# Of an entry of T while its blocks are joined: column, value and direct part, twice.
_ENTRY_BYTES = 24


def simulate_procedural(
    output: str | Path,
    scene: ProceduralScene,
    patterns: PatternSet | str | Path,
    *,
    exposure: float | str = 0.8,
    bits: int | None = 8,
    noise: float = USUAL_NOISE,
    shot_noise: float = 0.0,
    black_level: float = 0.0,
    seed: int = 0,
    truth: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Capture:
    """Photograph a made-up scene of any size, in bounded memory.

    The frames are those of `simulate` for the same matrix and seed.

    Parameters
    ----------
    output : str or Path
        A packed capture if it ends in .zarr, which is written as it comes; otherwise a capture
        folder, whose frames are turned over in memory or, above 2 GiB, in a temporary file.
    scene : ProceduralScene
        What is photographed.
    patterns : PatternSet, str or Path
        K patterns of the scene's projector, or a folder of them.
    exposure, bits, noise, shot_noise, black_level, seed : optional
        See `simulate`.
    truth : bool
        Whether the whole of T is kept beside the frames, as truth.npz: about 1.2 kB a camera
        pixel in memory while it is written. Without it `truth_of` makes it again when it is asked
        for.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Capture
        As `Capture.open` reads it, not checked.

    Raises
    ------
    InputError
        On patterns of another projector, values out of range, or a truth larger than the memory.
    OutputError
        If the capture exists, the disk has not enough room, or it cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> scene = lm.ProceduralScene((24, 32), (16, 16))
    >>> patterns = lm.BernoulliPatterns((16, 16), 8)
    >>> capture = lm.simulate_procedural("made.zarr", scene, patterns)
    >>> capture.camera_shape, lm.truth("made.zarr").matrix.shape
    ((24, 32), (768, 256))
    """
    check_seed(seed)
    packed = Path(output).suffix.lower() == ".zarr"
    check_output(output, PACKED_CAPTURE if packed else CAPTURE, overwrite=overwrite)
    exposures = parse_exposures(exposure if isinstance(exposure, str) else repr(float(exposure)))
    shown = patterns if isinstance(patterns, PatternSet) else read_patterns(patterns)
    if shown.shape != scene.projector_shape:
        raise InputError(
            f"patterns of {shown.shape[0]} x {shown.shape[1]} pixels for a projector of "
            f"{scene.projector_shape[0]} x {scene.projector_shape[1]}",
            hint="make the patterns for the projector of this scene",
        )
    sensor = Sensor(
        exposure_sequence(exposures, shown), float(black_level), noise, shot_noise, bits
    )
    if truth:
        check_truth(scene, output)
    rig = _Photographer(scene, shown, sensor, seed, progress)
    provenance = {"scene": PROCEDURAL, "seed": seed, PROCEDURAL: _described(scene)}

    def beside(part: Path) -> None:
        if truth:
            scene.truth().save(part / TRUTH)

    if packed:
        digits = max(4, len(str(shown.count - 1)))
        write_packed(
            output,
            shown,
            rig.strips,
            decoder=sensor.decoder(),
            shape=scene.camera_shape,
            dtype=sensor.dtype,
            names=[f"image_{k:0{digits}d}" for k in range(shown.count)],
            provenance=provenance,
            beside=beside,
            overwrite=overwrite,
        )
    else:
        write_capture(
            output,
            shown,
            rig.frames(),
            sensor=sensor,
            camera_shape=scene.camera_shape,
            provenance=provenance,
            beside=beside,
            overwrite=overwrite,
        )
    return Capture.open(output)


def scene_of(provenance: Mapping[str, Any]) -> ProceduralScene | None:
    """The made-up scene that a capture says it is of; None if it is of another.

    Raises
    ------
    InputError
        On parameters that no such scene has.
    """
    told = provenance.get(PROCEDURAL)
    if not isinstance(told, Mapping):
        return None
    values = dict(told)
    try:
        shapes = [tuple(int(n) for n in values.pop(name)) for name in _SHAPES]
        (rows, cols), (high, wide) = shapes
        return ProceduralScene((rows, cols), (high, wide), **values)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"a description of a {PROCEDURAL} scene that cannot be read: {error}",
            hint="simulate it again",
        ) from error


def check_truth(scene: ProceduralScene, name: str | Path) -> None:
    """Refuse to make a whole T that would not fit into memory.

    Raises
    ------
    InputError
        Saying what it needs.
    """
    check_room(Path(name), math.prod(scene.camera_shape) * scene.row_entries * _ENTRY_BYTES)


def truth_of(capture: Capture, name: str | Path) -> Truth | None:
    """The whole T of a capture of a made-up scene, made again; None for captures of others.

    Raises
    ------
    InputError
        If it would not fit into memory.
    """
    scene = scene_of(capture.provenance)
    if scene is None:
        return None
    check_truth(scene, name)
    return scene.truth()


_SHAPES = ("camera_shape", "projector_shape")


def _described(scene: ProceduralScene) -> dict[str, Any]:
    told = asdict(scene)
    return {**told, **{name: list(told[name]) for name in _SHAPES}}


class _Photographer:
    """Photographs the rows of a scene, some at a time."""

    def __init__(
        self,
        scene: ProceduralScene,
        patterns: PatternSet,
        sensor: Sensor,
        seed: int,
        progress: Progress | None,
    ) -> None:
        self.scene, self.patterns, self.sensor = scene, patterns, sensor
        self.seed, self.progress = seed, progress

    def strips(self, rows: int) -> Iterator[NDArray[Any]]:
        """Levels (K, r, cols), r a multiple of `rows` but for the last."""
        height, width = self.scene.camera_shape
        step = rows * max(1, _SAMPLES // (rows * width * max(64, self.patterns.count)))
        for top in range(0, height, step):
            end = min(top + step, height)
            levels = self._expose(top * width, end * width)
            yield np.ascontiguousarray(levels.T).reshape(-1, end - top, width)
            if self.progress is not None:
                self.progress(end * width, height * width)

    def frames(self) -> Iterator[NDArray[Any]]:
        """Whole frames, (rows, cols)."""
        shape = (self.patterns.count, *self.scene.camera_shape)
        stack, top = scratch_array(shape, self.sensor.dtype), 0
        for strip in self.strips(1):
            stack[:, top : top + strip.shape[1]] = strip
            top += strip.shape[1]
        yield from stack

    def _expose(self, start: int, stop: int) -> NDArray[Any]:
        cuts = [*range(start, stop, _ROWS), stop]
        matrix = stacked([self.scene.rows(*pair)[0] for pair in itertools.pairwise(cuts)])
        count = self.patterns.count
        light = np.empty((stop - start, count), np.float32)
        step = max(16, _PATTERN_BYTES // (4 * self.patterns.pixels))
        for k in range(0, count, step):
            some = np.arange(k, min(k + step, count))
            light[:, k : k + step] = irradiance(matrix, self.patterns.subset(some))
        return self.sensor.expose(light, seed=self.seed, first_row=start)
