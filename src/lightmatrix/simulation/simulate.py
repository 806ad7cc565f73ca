"""`lm.simulate`: photographs of a scene whose light transport matrix is known."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence, parse_exposures
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.capture.packing import pack_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.paths import as_path
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.progress import Progress
from lightmatrix.ranges import as_float, check_number, check_seed
from lightmatrix.regions import Region
from lightmatrix.resources.threads import work_ahead
from lightmatrix.simulation import library, realism
from lightmatrix.simulation.faults import Faults
from lightmatrix.simulation.realism import in_all_primaries, in_primary, is_of_all_primaries
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import PROJECTORS
from lightmatrix.transport.sparse_rows import row_blocks


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedCapture(Capture):
    """A capture whose light transport matrix is known; made by `simulate`.

    Parameters
    ----------
    truth : Truth
        The T that the frames show, with blur, vignetting and leaking black; never binned, and
        without the room's light.
    sensor : Sensor
        The camera that took the frames.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), leak=0.1)
    >>> white = np.ones((64, 64))
    >>> light = capture.truth.transport().relight(white).sum()
    >>> round(float(light / lm.truth("metal").transport().relight(white).sum()), 3)
    0.9
    """

    truth: Truth = field(kw_only=True)
    sensor: Sensor = field(kw_only=True)

    @property
    def raw_clipped_share(self) -> float:
        """Share of the raw samples of all frames that are at the clip level."""
        level = self.sensor.clip_level
        shares = [float((self.frames.read(k) >= level).mean()) for k in range(self.count)]
        return float(np.mean(shares))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write a capture that `Capture.open` reads, with its T as truth.npz.

        Of a rendered scene, geometry.json and depth.tiff (float32, see `Truth.depth`) stand beside.

        Parameters
        ----------
        folder : str or Path
            The folder to make. A packed capture (see `pack`) is written if it ends in .zarr.
        overwrite : bool
            Whether an existing capture may be replaced.

        Raises
        ------
        InputError
            If the capture is binned, because a folder holds the frames of the camera.
        OutputError
            If the folder exists or cannot be written.
        """
        if self.bin_projector != (1, 1) or self.bin_camera != (1, 1):
            raise InputError("a binned capture cannot be saved", hint="save it first, then bin it")

        def save_truth(part: Path) -> None:
            self.truth.save_beside(part)

        if as_path(folder).suffix.lower() == ".zarr":
            pack_capture(self, folder, save_truth, overwrite=overwrite)
            return
        decoder = self.decoder
        black = decoder.black_frame
        write_capture(
            folder, self.patterns, (self.frames.read(k) for k in range(self.count)),
            sensor=self.sensor, camera_shape=self.frames.shape,
            black=None if black is None else black.reshape(self.frames.shape),
            black_exposure=decoder.black_exposure, provenance=self.provenance,
            projectors=self.projectors, write_extras=save_truth, overwrite=overwrite,
        )  # fmt: skip

    def crop(self, corner: tuple[int, int], shape: tuple[int, int]) -> Self:
        """A rectangle of the photographs, and the rows of the truth that belong to it."""
        cropped = super().crop(corner, shape)
        rows, cols = self.frames.shape[:2]
        return replace(cropped, truth=self.truth.crop(Region(corner, shape, (rows, cols))))

    def select(self, frames: Sequence[int] | np.ndarray) -> Self:
        """The capture that holds the frames of the stated indices only."""
        selected = super().select(frames)
        if np.ndim(self.sensor.exposure):
            exposures = np.asarray(self.sensor.exposure)[np.asarray(frames, np.int64)]
            selected = replace(selected, sensor=replace(self.sensor, exposure=exposures))
        return selected


def simulate(
    scene: str | Path | Truth,
    patterns: PatternSet | str | Path,
    *,
    camera: int = 1,
    exposure: float | str = 0.8,
    bits: int | None = 8,
    noise: float = USUAL_NOISE,
    full_well: float | None = None,
    black_level: float = 0.0,
    blur: float = 0.0,
    camera_blur: float = 0.0,
    leak: float = 0.0,
    ambient: float = 0.0,
    vignetting: float = 0.0,
    primary: str | None = None,
    faults: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> SimulatedCapture:
    """Simulate photographs of a scene, whose light transport matrix is known, under patterns.

    Parameters
    ----------
    scene : str, Path or Truth
        A scene (see `scenes`), bundled or rendered on demand at the size of the patterns; a truth
        file, T.npz; or a truth.
    patterns : PatternSet, str or Path
        K patterns, or a folder of them. Patterns in colour (`ColourPatterns`) are photographed by a
        camera of three channels whose filters overlap; the truth then has the pixels of red, green
        and blue side by side. A truth that has them already is photographed as it is. Patterns of
        several projectors stand one above the other: 128x64 for two of 64 x 64.
    camera : int
        Number of the camera, from 1 on, in scenes that have several.
    exposure : float or str
        Exposure e in sample = min(1, e T p), or several exposures with their shares of the frames,
        such as ``1:0.75,0.25:0.25``.
    bits : {8, 10, 12, 16} or None
        Bit depth; None gives float32 levels.
    noise : float
        Read noise, standard deviation as a share of the clip level, in [0, 1].
    full_well : float, optional
        Electrons at the clip level, whose root is the shot noise: 10,500 give a standard deviation
        of 0.0098 of the clip level. None: no shot noise.
    black_level : float
        Raw level of a sample without light.
    blur : float
        Projector defocus, standard deviation in projector pixels.
    camera_blur : float
        Camera defocus, standard deviation in camera pixels.
    leak : float
        Light of a black projector pixel as a share of a white one, in [0, 1).
    ambient : float
        Room light as a share of the mean white image, >= 0. With room light or a `leak`, the
        capture has a black frame.
    vignetting : float
        Share of the light lost in the camera's corners, in [0, 1).
    primary : {"red", "green", "blue"}, optional
        The primary of a colour projector that shows the patterns. The camera then has three
        channels, whose filters overlap. None: a grey projector and the camera of the scene.
    faults : mapping, optional
        What the rig does wrong, by name and amount, such as ``{"shake": 0.1}``; the page "What
        real rigs do" lists the names, as does the error of an unknown one. The truth has no
        faults. None: nothing.
    seed : int
        Seed of the noise and of the faults.
    progress : callable, optional
        Called with (done, total): paths while the scene is rendered, then rows.

    Returns
    -------
    SimulatedCapture
        A `Capture` that also holds the truth; `save` writes it as a folder.

    Raises
    ------
    InputError
        On unknown scenes and faults, patterns of another size, and values out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure=0.5)
    >>> capture.frames.read(0).dtype, capture.camera_shape
    (dtype('uint8'), (64, 64))
    >>> capture.save("metal")
    >>> lm.Capture.open("metal").digest == capture.digest
    True
    """
    check_seed(seed)
    if not isinstance(patterns, PatternSet):
        patterns = read_patterns(patterns)
    if primary is not None and isinstance(patterns, ColourPatterns):
        hint = "leave out one of the two"
        raise InputError(f"the primary {primary} for patterns in colour", hint=hint)
    exposures = parse_exposures(exposure if isinstance(exposure, str) else repr(as_float(exposure)))
    shot_noise = 0.0
    if full_well is not None:
        hint = "use electrons, such as 10500"
        check_number("a full well", full_well, least=1, most=1e12, hint=hint)
        shot_noise = full_well**-0.5
    sensor = Sensor(
        exposure_sequence(exposures, patterns), as_float(black_level), noise, shot_noise, bits
    )
    widest = max(patterns.shape)
    hint = f"use projector pixels from 0 to {widest}, as many as the projector has"
    check_number("a blur", blur, most=widest, hint=hint)
    hint = "use camera pixels from 0 to 100"
    check_number("a blur of the camera", camera_blur, most=100, hint=hint)
    if not 0 <= as_float(vignetting) < 1:
        raise InputError(f"a vignetting of {vignetting}", hint="use a share from 0 to below 1")
    if not 0 <= as_float(leak) < 1:
        raise InputError(f"a leak of {leak}", hint="use a share from 0 to below 1, such as 0.001")
    hint = "use a share of the white image, from 0 to 1000"
    check_number("an ambient level", ambient, most=1000, hint=hint)
    wrong = Faults(faults or {}, seed)
    if wrong.black_exposure != 1 and not (leak or ambient):
        hint = "add room light too, such as ambient=0.05"
        raise InputError("a fault black without a black frame", hint=hint)
    shape = patterns.red.shape if isinstance(patterns, ColourPatterns) else patterns.shape
    several = 1 if isinstance(scene, Truth) else library.devices_of(scene)[0]
    # Projectors twice as wide as they are high do not exist: these are the patterns of one.
    if shape[0] % several or (several > 1 and shape[1] >= 2 * (shape[0] // several)):
        raise InputError(
            f"patterns of {shape[0]} x {shape[1]} for {several} projectors, one above the other",
            hint="make patterns of as many rows as all projectors have: "
            f"{several * shape[0]}x{shape[1]} for {several} of {shape[0]}x{shape[1]}",
        )
    size = (shape[0] // several, shape[1])
    truth = library.truth(scene, size, camera=camera, progress=progress)
    if blur and is_of_all_primaries(truth):
        raise InputError(
            "a blur of a colour projector's T, whose colours stand side by side",
            hint="blur the grey scene that it was made of",
        )
    if primary is not None:
        truth = in_primary(truth, primary)
    truth = realism.camera_defocus(realism.defocus(truth, blur), camera_blur)
    truth = realism.vignetting(truth, vignetting)
    if isinstance(patterns, ColourPatterns) and not is_of_all_primaries(truth):
        truth = in_all_primaries(truth)
    room = realism.ambient(truth, ambient)
    light = irradiance(truth.matrix, wrong.emitted(patterns), progress=progress)
    # A leak is affine in the pattern, so it can be applied to the light instead of the patterns.
    white = np.asarray(truth.matrix.sum(axis=1), np.float32).ravel()
    dark = (leak * white + room)[:, None]
    light = (1 - leak) * light
    about = (patterns, truth.camera_shape, sensor.exposure)
    if wrong.amounts:
        glow = leak * white[:, None]
        light = wrong.acted("light", light + glow, *about) - glow
    light = wrong.of_camera(light + dark, *about)
    raw = sensor.expose(light, seed=seed)
    frames = np.ascontiguousarray(raw.T).reshape(patterns.count, *truth.camera_shape)
    decoder = sensor.decoder()
    if leak or ambient:
        longest = max(e for e, _ in exposures)
        # The black frame counts as one more frame, so that its noise repeats no other's.
        black = replace(sensor, exposure=longest * wrong.black_exposure).expose(
            dark, seed=seed, first_frame=patterns.count
        )
        decoder = replace(decoder, black_frame=black.ravel(), black_exposure=longest)
    provenance: dict[str, Any] = {
        "scene": "a truth in memory" if isinstance(scene, Truth) else str(scene),
        "seed": seed,
        **truth.metadata,
    }
    if wrong.amounts:
        provenance["faults"] = wrong.amounts
    return SimulatedCapture(
        patterns,
        ArrayStack(frames),
        decoder,
        provenance=provenance,
        # Without the leak, which the black frame holds.
        projectors=tuple((rows, cols) for rows, cols in truth.metadata.get(PROJECTORS, ())),
        truth=truth.scaled(np.float32(1 - leak)) if leak else truth,
        sensor=sensor,
    )


# One task of a thread multiplies rows with about this many stored entries. Chosen by hand: enough
# work per task that starting it costs nothing, and enough tasks to keep all threads busy.
_BLOCK_ENTRIES = 1 << 22
# A block of patterns holds this many float32 values (4 MiB), so that it stays in the cache.
# Measured at 128 x 128 pixels: two to three times faster than all 1,024 patterns at once.
_CACHED_VALUES = 1 << 20


def irradiance(
    matrix: csr_array, patterns: PatternSet, *, progress: Progress | None = None
) -> NDArray[np.float32]:
    """T P' for an (M, N) sparse T and K patterns: (M, K), linear, 1 = clip level at exposure 1."""
    rows, pixels = matrix.shape
    if pixels != patterns.pixels:
        raise InputError(
            f"the patterns have {patterns.shape[0]} x {patterns.shape[1]} pixels, but the matrix "
            f"has {pixels} columns",
            hint="make the patterns for the projector of this scene",
        )
    if 0 < matrix.nnz < pixels:
        # Few rows see little of a large projector, and only that is laid out.
        seen, place = np.unique(matrix.indices, return_inverse=True)
        matrix = csr_array((matrix.data, place, matrix.indptr), (rows, len(seen)))
        patterns = patterns.laid(seen[None])
    light = np.empty((rows, patterns.count), np.float32)
    # Patterns as columns, so that the product of one row adds short vectors of a cached block.
    size = max(16, _CACHED_VALUES // patterns.pixels)
    firsts = range(0, patterns.count, size)
    blocks = [
        np.ascontiguousarray(patterns.rows(k, min(k + size, patterns.count)).T) for k in firsts
    ]
    cuts = row_blocks(matrix.indptr, _BLOCK_ENTRIES)

    def multiply(task: int) -> None:
        start, stop = cuts[task], cuts[task + 1]
        some_rows = matrix[start:stop]
        for k, block in zip(firsts, blocks, strict=True):
            light[start:stop, k : k + size] = some_rows @ block

    for task, _ in enumerate(work_ahead(multiply, range(len(cuts) - 1), os.cpu_count())):
        if progress is not None:
            progress(int(cuts[task + 1]), rows)
    return light
