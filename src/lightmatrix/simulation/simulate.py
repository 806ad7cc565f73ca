"""A simulated rig: a known scene photographed under patterns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lightmatrix.camera.exposure_sequence import exposure_sequence, parse_exposures
from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.description import TRUTH
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.capture.packing import pack_capture
from lightmatrix.errors import InputError
from lightmatrix.patterns.folder import read_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import check_seed
from lightmatrix.regions import Region
from lightmatrix.simulation import library, realism
from lightmatrix.simulation.colour import in_primary
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.truth import Truth

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedCapture(Capture):
    """A capture whose light transport matrix is known; made by `simulate`.

    Parameters
    ----------
    truth : Truth
        The T that was photographed: blurred, vignetted and of less contrast as the frames were,
        neither binned nor under the room's light.
    sensor : Sensor
        The camera that took the frames.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), leak=0.1)
    >>> white = np.ones((64, 64))
    >>> shown = capture.truth.transport().relight(white).sum()
    >>> round(float(shown / lm.truth("metal").transport().relight(white).sum()), 3)
    0.9
    """

    truth: Truth = field(kw_only=True)
    sensor: Sensor = field(kw_only=True)

    @property
    def raw_clipped_share(self) -> float:
        """Share of the samples of all frames that are at the clip level."""
        level = self.sensor.clip_level
        shares = [float((self.frames.read(k) >= level).mean()) for k in range(self.count)]
        return float(np.mean(shares))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write a capture that `Capture.open` reads, with the T photographed as truth.npz.

        Parameters
        ----------
        folder : str or Path
            The folder to make, whole or not at all; packed (see `pack`) if it ends in .zarr.
        overwrite : bool
            Whether an existing capture may be replaced.

        Raises
        ------
        InputError
            If the capture is binned, since a folder holds frames as they were taken.
        OutputError
            If the folder exists or cannot be written.
        """
        if self.bin_projector != (1, 1) or self.bin_camera != (1, 1):
            raise InputError("a binned capture cannot be saved", hint="save it first, then bin it")
        if Path(folder).suffix.lower() == ".zarr":
            pack_capture(
                self,
                folder,
                beside=lambda part: self.truth.save(part / TRUTH),
                overwrite=overwrite,
            )
            return
        decoder = self.decoder
        black = decoder.black_frame
        write_capture(
            folder,
            self.patterns,
            (self.frames.read(k) for k in range(self.count)),
            sensor=self.sensor,
            camera_shape=self.frames.shape,
            black=None if black is None else black.reshape(self.frames.shape),
            black_exposure=decoder.black_exposure,
            provenance=self.provenance,
            beside=lambda part: self.truth.save(part / TRUTH),
            overwrite=overwrite,
        )

    def crop(self, corner: tuple[int, int], shape: tuple[int, int]) -> SimulatedCapture:
        """A rectangle of the photographs, with the rows of the truth that belong to it."""
        part = super().crop(corner, shape)
        assert isinstance(part, SimulatedCapture)
        rows, cols = self.frames.shape[:2]
        region = Region(corner, shape, (rows, cols))
        return replace(part, truth=self.truth.crop(region))

    def select(self, frames: Sequence[int] | np.ndarray) -> SimulatedCapture:
        """The capture of the frames of the given indices, such as all but one."""
        chosen = super().select(frames)
        assert isinstance(chosen, SimulatedCapture)
        exposure = self.sensor.exposure
        if np.ndim(exposure):
            picked = np.asarray(exposure)[np.asarray(frames, np.int64)]
            chosen = replace(chosen, sensor=replace(self.sensor, exposure=picked))
        return chosen


def simulate(
    scene: str | Path | Truth,
    patterns: PatternSet | str | Path,
    *,
    exposure: float | str = 0.8,
    bits: int | None = 8,
    noise: float = USUAL_NOISE,
    shot_noise: float = 0.0,
    black_level: float = 0.0,
    blur: float = 0.0,
    leak: float = 0.0,
    ambient: float = 0.0,
    vignetting: float = 0.0,
    primary: str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> SimulatedCapture:
    """Photograph a scene whose light transport matrix is known under patterns.

    Parameters
    ----------
    scene : str, Path or Truth
        A scene (see `scenes`), bundled or rendered on demand at the size of the patterns; a truth
        file, T.npz; or a truth.
    patterns : PatternSet, str or Path
        K patterns, or a folder of them.
    exposure : float or str
        Exposure e: sample = min(1, e T p). Or several and their shares of the frames, such as
        ``1:0.75,0.25:0.25``.
    bits : {8, 10, 12, 16} or None
        Bit depth; None gives float32 levels.
    noise : float
        Read noise, standard deviation as a share of the clip level, in [0, 1].
    shot_noise : float
        Shot noise at the clip level, standard deviation as a share of it, in [0, 1].
    black_level : float
        Raw level of a sample without light.
    blur : float
        Projector defocus, standard deviation in projector pixels.
    leak : float
        Light of a black projector pixel as a share of a white one, in [0, 1).
    ambient : float
        Room light as a share of the mean white image, >= 0. With it or with `leak` a black frame
        is taken too.
    vignetting : float
        Share of the light lost in the camera's corners, in [0, 1).
    primary : {"red", "green", "blue"}, optional
        The primary of a colour projector that shows the patterns; the camera then has three
        channels, whose filters overlap. None: a grey projector, and the camera of the scene.
    seed : int
        Seed of the noise.
    progress : callable, optional
        Called with (done, total): paths where the scene is rendered, then rows.

    Returns
    -------
    SimulatedCapture
        A `Capture` that also holds the truth that was photographed; `save` writes it as a folder.

    Raises
    ------
    InputError
        On unknown scenes, patterns of another size, and values out of range.

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
    exposures = parse_exposures(exposure if isinstance(exposure, str) else repr(float(exposure)))
    shown = patterns if isinstance(patterns, PatternSet) else read_patterns(patterns)
    sensor = Sensor(
        exposure_sequence(exposures, shown), float(black_level), noise, shot_noise, bits
    )
    realism.check_realism(shown.shape, blur=blur, vignetting=vignetting, leak=leak, ambient=ambient)
    truth = library.truth(scene, shown.shape, progress=progress)
    if primary is not None:
        truth = in_primary(truth, primary)
    truth = realism.vignetting(realism.defocus(truth, blur), vignetting)
    room = realism.ambient(truth, ambient)
    light = irradiance(truth.matrix, shown, progress=progress)
    # Leaking black is affine in the pattern, so it acts on the light as it does on the patterns.
    white = np.asarray(truth.matrix.sum(axis=1), np.float32).ravel()
    dark = (leak * white + room)[:, None]
    light = (1 - leak) * light + dark
    raw = sensor.expose(light, seed=seed)
    frames = np.ascontiguousarray(raw.T).reshape(shown.count, *truth.camera_shape)
    decoder = sensor.decoder()
    if leak or ambient:
        longest = max(e for e, _ in exposures)
        # A frame of its own number, so that its noise is its own.
        exposed = replace(sensor, exposure=longest).expose(dark, seed=seed, first_frame=shown.count)
        decoder = replace(decoder, black_frame=exposed.ravel(), black_exposure=longest)
    # As JSON keeps it, so that a capture read back is the same.
    name = "a truth in memory" if isinstance(scene, Truth) else str(scene)
    return SimulatedCapture(
        shown,
        ArrayStack(frames),
        decoder,
        provenance={"scene": name, "seed": seed, **truth.metadata},
        truth=_less_contrast(truth, leak),
        sensor=sensor,
    )


def _less_contrast(truth: Truth, leak: float) -> Truth:
    """T as it is seen once the light of black pixels has been subtracted."""
    if leak == 0:
        return truth
    share = np.float32(1 - leak)
    return replace(
        truth,
        matrix=truth.with_data(share * truth.matrix.data),
        direct_data=share * truth.direct_data,
    )
