"""`lm.simulate_procedural`: captures of a procedural scene of any size, written block by block.

Neither the matrix nor the frames are ever in memory as a whole: for a megapixel camera T would take
more than a gigabyte, and 1,024 frames as much again.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposures import USUAL_NOISE, exposure_sequence, parse_exposures
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.packing import write_packed
from lightmatrix.capture.settings import TRUTH
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import CAPTURE, PACKED_CAPTURE
from lightmatrix.outputs.writing import check_output
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import check_seed
from lightmatrix.resources.disk import scratch_array
from lightmatrix.resources.memory import check_memory
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.procedural_scene import ProceduralScene
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.sparse_rows import stack_rows

Progress = Callable[[int, int], None]
# The scene name that the command line and the provenance of a capture use for procedural scenes.
PROCEDURAL = "procedural"
_SHAPES = ("camera_shape", "projector_shape")
# The block sizes below bound the memory of a simulation to some hundred MiB. They were chosen by
# hand and do not change the frames: rows of T that are made at once, samples (all frames together)
# that are exposed at once, and bytes of unpacked float32 patterns.
_ROWS = 1 << 13
_SAMPLES = 1 << 22
_PATTERN_BYTES = 256 << 20
# An entry of T takes this many bytes while its blocks are joined: column, value and direct part,
# 4 bytes each, exist twice.
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
    """Simulate photographs of a procedural scene of any size, in bounded memory.

    The frames are those of `simulate` for the same matrix and seed.

    Parameters
    ----------
    output : str or Path
        A packed capture, written strip by strip, if it ends in .zarr. Otherwise a capture folder,
        whose frames are collected in memory or, above 2 GiB, in a temporary file.
    scene : ProceduralScene
        The scene.
    patterns : PatternSet, str or Path
        K patterns of the scene's projector, or a folder of them.
    exposure, bits, noise, shot_noise, black_level, seed : optional
        See `simulate`.
    truth : bool
        Whether to write the whole of T beside the frames, as truth.npz. That takes about 1.2 kB
        of memory per camera pixel. Without the file, `truth` computes T again from the scene.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Capture
        As `Capture.open` reads it.

    Raises
    ------
    InputError
        On patterns of another projector, values out of range, or a truth larger than the memory.
    OutputError
        If the capture exists, the disk is too full, or it cannot be written.

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
    if not isinstance(patterns, PatternSet):
        patterns = read_patterns(patterns)
    if patterns.shape != scene.projector_shape:
        raise InputError(
            f"patterns of {patterns.shape[0]} x {patterns.shape[1]} pixels for a projector of "
            f"{scene.projector_shape[0]} x {scene.projector_shape[1]}",
            hint="make the patterns for the projector of this scene",
        )
    sensor = Sensor(
        exposure_sequence(exposures, patterns), float(black_level), noise, shot_noise, bits
    )
    if truth:
        check_truth_fits(scene, output)
    shutter = _Shutter(scene, patterns, sensor, seed, progress)
    provenance = {"scene": PROCEDURAL, "seed": seed, PROCEDURAL: _description(scene)}

    def save_truth(part: Path) -> None:
        if truth:
            scene.truth().save(part / TRUTH)

    if packed:
        digits = max(4, len(str(patterns.count - 1)))
        write_packed(
            output,
            patterns,
            shutter.strips,
            decoder=sensor.decoder(),
            shape=scene.camera_shape,
            dtype=sensor.dtype,
            names=[f"image_{k:0{digits}d}" for k in range(patterns.count)],
            provenance=provenance,
            write_extras=save_truth,
            overwrite=overwrite,
        )
    else:
        write_capture(
            output,
            patterns,
            shutter.frames(),
            sensor=sensor,
            camera_shape=scene.camera_shape,
            provenance=provenance,
            write_extras=save_truth,
            overwrite=overwrite,
        )
    return Capture.open(output)


def _description(scene: ProceduralScene) -> dict[str, Any]:
    """The parameters of a scene, JSON-ready; `scene_of` reads them."""
    parameters = asdict(scene)
    return {**parameters, **{name: list(parameters[name]) for name in _SHAPES}}


def scene_of(provenance: Mapping[str, Any]) -> ProceduralScene | None:
    """The procedural scene that a capture's provenance describes; None if it is another."""
    description = provenance.get(PROCEDURAL)
    if not isinstance(description, Mapping):
        return None
    parameters = dict(description)
    try:
        shapes = [tuple(int(n) for n in parameters.pop(name)) for name in _SHAPES]
        (rows, cols), (high, wide) = shapes
        return ProceduralScene((rows, cols), (high, wide), **parameters)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the description of a {PROCEDURAL} scene cannot be read: {error}",
            hint="simulate it again",
        ) from error


def check_truth_fits(scene: ProceduralScene, name: str | Path) -> None:
    """Raise InputError if the whole T of a scene would not fit into memory."""
    check_memory(Path(name), math.prod(scene.camera_shape) * scene.row_entries * _ENTRY_BYTES)


def truth_of(capture: Capture, name: str | Path) -> Truth | None:
    """T of a capture of a procedural scene, computed again; None for captures of others."""
    scene = scene_of(capture.provenance)
    if scene is None:
        return None
    check_truth_fits(scene, name)
    return scene.truth()


@dataclass(frozen=True)
class _Shutter:
    """Exposes a scene under all patterns, some camera rows at a time."""

    scene: ProceduralScene
    patterns: PatternSet
    sensor: Sensor
    seed: int
    progress: Progress | None

    def strips(self, rows: int) -> Iterator[NDArray[Any]]:
        """Raw levels (K, r, cols) from top to bottom; r is a multiple of `rows` but at the end."""
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
        """Raw levels (stop - start, K) of some camera samples."""
        cuts = [*range(start, stop, _ROWS), stop]
        matrix = stack_rows([self.scene.rows(*pair)[0] for pair in itertools.pairwise(cuts)])
        count = self.patterns.count
        light = np.empty((stop - start, count), np.float32)
        step = max(16, _PATTERN_BYTES // (4 * self.patterns.pixels))
        for k in range(0, count, step):
            block = np.arange(k, min(k + step, count))
            light[:, k : k + step] = irradiance(matrix, self.patterns.subset(block))
        return self.sensor.expose(light, seed=self.seed, first_row=start)
