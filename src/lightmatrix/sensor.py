"""The camera: from light to raw levels (exposure, noise, clipping, bits), and the way back.

Forward, for a camera sample that receives T p under a frame of exposure e:

    sample = e (T p) + noise           noise std = sqrt(read^2 + shot^2 e (T p))
    level  = round(black + min(1, sample) (clip - black))

and back, where f undoes the response (the identity for a linear camera):

    sample = (f(level) - f(black)) / (f(clip) - f(black)),    clipped where level >= clip

so 1.0 is always the clip level. Samples are handed on divided by their exposure.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from lightmatrix.errors import InputError

BIT_DEPTHS = (8, 10, 12, 16)


@dataclass(frozen=True, eq=False)
class Sensor:
    """A linear camera that can be simulated.

    Parameters
    ----------
    exposure : float or (K,) array
        Exposure e of every frame, > 0, as a factor on T p.
    black_level : float
        Raw level of a sample without light, below `clip`.
    read_noise : float
        Standard deviation of the noise without light, in units of the clip level.
    shot_noise : float
        Standard deviation of the shot noise at the clip level, in units of the clip level; it
        grows with the root of the sample.
    bits : {8, 10, 12, 16} or None
        Bit depth; None means float32 levels in [0, 1] without quantisation.
    clip : float, optional
        Raw level at which the camera clips; None means the end of the range.

    Raises
    ------
    InputError
        On values out of range.
    """

    exposure: float | NDArray[Any] = 1.0
    black_level: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0
    bits: int | None = 8
    clip: float | None = None

    def __post_init__(self) -> None:
        if self.bits is not None and self.bits not in BIT_DEPTHS:
            raise InputError(
                f"a camera of {self.bits} bits",
                hint=f"use one of {', '.join(map(str, BIT_DEPTHS))}",
            )
        exposure = np.asarray(self.exposure)
        if exposure.ndim > 1 or not (np.isfinite(exposure).all() and (exposure > 0).all()):
            raise InputError(
                f"an exposure of {self.exposure}", hint="use positive numbers, such as 1"
            )
        for name in ("read_noise", "shot_noise"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(
                    f"{name.replace('_', ' ')} of {getattr(self, name)}",
                    hint="use a share of the clip level, such as 0.003",
                )
        _check_levels(self.clip_level, self.black_level, self.full_scale)

    @property
    def full_scale(self) -> float:
        """The highest raw level: 255, 1023, 4095, 65535, or 1 for float levels."""
        return 1.0 if self.bits is None else 2.0**self.bits - 1

    @property
    def clip_level(self) -> float:
        """The raw level at which the camera clips."""
        return self.full_scale if self.clip is None else self.clip

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the frames: uint8, uint16 or float32."""
        if self.bits is None:
            return np.dtype(np.float32)
        return np.dtype(np.uint8 if self.bits == 8 else np.uint16)

    def expose(
        self,
        irradiance: NDArray[Any],
        *,
        seed: int = 0,
        first_row: int = 0,
        first_frame: int = 0,
    ) -> NDArray[Any]:
        """Photograph: T p to raw levels.

        The noise of a sample depends on `seed`, its frame and its row alone, so any division into
        tiles gives the same frames.

        Parameters
        ----------
        irradiance : (m, n) float
            T p of m camera samples under n patterns, in camera full scale at exposure 1.
        seed : int
            Seed of the noise, in [0, 2^64).
        first_row, first_frame : int
            Where this tile begins in the whole capture.

        Returns
        -------
        (m, n) uint8, uint16 or float32
            Raw levels.

        Raises
        ------
        InputError
            If there are more frames than exposures.
        """
        rows, frames = irradiance.shape
        exposure = _of_frames(self.exposure, first_frame, first_frame + frames, "exposures")
        sample = np.asarray(irradiance, np.float64) * exposure
        if self.read_noise or self.shot_noise:
            deviation = np.sqrt(self.read_noise**2 + self.shot_noise**2 * sample.clip(0))
            for k in range(frames):
                sample[:, k] += deviation[:, k] * _normals(seed, first_frame + k, first_row, rows)
        top = self.clip_level
        level = self.black_level + np.minimum(sample, 1) * (top - self.black_level)
        if self.bits is None:
            return level.astype(np.float32)
        return np.rint(level).clip(0, np.floor(top)).astype(self.dtype)

    def decoder(self) -> Decoder:
        """The way back from this camera's levels."""
        clip = self.clip_level if self.bits is None else np.floor(self.clip_level)
        return Decoder(clip, self.full_scale, self.black_level, exposure=self.exposure)


def _normals(seed: int, frame: int, first: int, count: int) -> NDArray[np.float64]:
    """Standard normal numbers first..first + count of the endless sequence of (seed, frame)."""
    # One Philox counter yields four numbers. Inverting the distribution uses exactly one number a
    # sample (the ziggurat does not), which is what lets a tile begin anywhere.
    skip = first % 4
    generator = np.random.Philox(counter=first // 4, key=np.array([seed, frame], np.uint64))
    raw = generator.random_raw(skip + count)[skip:]
    normals: NDArray[np.float64] = ndtri(((raw >> np.uint64(11)) + 0.5) * 2.0**-53)
    return normals


@dataclass(frozen=True, eq=False)
class Response:
    """The camera's response: which share of the full level belongs to which share of light.

    Parameters
    ----------
    levels, light : (n,) float64
        Matching points of the curve, both from 0 to 1, levels increasing, light not decreasing;
        straight in between. None for the linear response.
    name : str
        As given to `parse`.
    """

    levels: NDArray[np.float64] | None = None
    light: NDArray[np.float64] | None = None
    name: str = "linear"

    @classmethod
    def parse(cls, text: str, folder: Path = Path()) -> Response:
        """Read a response: ``linear``, ``gamma:2.2``, ``srgb`` or ``curve:FILE``.

        A curve is a text file (or npy) of two columns, level and light, each from 0 to its own
        maximum; or of one column, the light at equally spaced levels. A relative FILE is looked
        for in `folder`.

        Raises
        ------
        InputError
            On an unknown name, a gamma out of [0.1, 10], or a curve that does not increase.
        """
        kind, _, argument = text.partition(":")
        if text == "linear":
            return cls()
        # Fine enough that the straight pieces are exact to 16 bits everywhere but near zero.
        levels = np.linspace(0, 1, 65536)
        if text == "srgb":
            light = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
            return cls(levels, light, text)
        if kind == "gamma":
            try:
                gamma = float(argument)
            except ValueError:
                gamma = np.nan
            if not 0.1 <= gamma <= 10:
                raise InputError(f"a response of {text!r}", hint="write for example gamma:2.2")
            return cls(levels, levels**gamma, text)
        if kind == "curve" and argument:
            return cls(*_read_curve(folder / argument), text)
        raise InputError(
            f"a response of {text!r}", hint="use linear, gamma:2.2, srgb or curve:FILE"
        )

    def linearise(self, share: NDArray[Any]) -> NDArray[np.float64]:
        """Light, as a share of its maximum, at levels given as a share of theirs."""
        share = np.asarray(share, np.float64)
        if self.levels is None or self.light is None:
            return share
        return np.interp(share, self.levels, self.light)


def _read_curve(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        if file.suffix == ".npy":
            table = np.load(file, allow_pickle=False)
        else:
            text = file.read_text().replace(",", " ").replace(";", " ")
            rows = [line.split() for line in text.splitlines() if line.strip()]
            table = np.array([[float(v) for v in row] for row in rows if row[0][0] != "#"])
        table = np.asarray(table, np.float64).reshape(len(table), -1)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{file}: the response curve cannot be read ({error})",
            hint="write two columns of numbers, level and light",
        ) from error
    if table.shape[1] == 1:
        table = np.column_stack([np.arange(len(table)), table[:, 0]])
    levels, light = table[:, 0], table[:, 1]
    increasing = len(table) > 1 and (np.diff(levels) > 0).all() and (np.diff(light) >= 0).all()
    if table.shape[1] != 2 or not np.isfinite(table).all() or not increasing or light[-1] <= 0:
        raise InputError(
            f"{file}: a response curve of {table.shape[0]} x {table.shape[1]} numbers that does "
            "not increase",
            hint="write two columns, level and light, from dark to bright",
        )
    return levels / levels[-1], light / light[-1]


@dataclass(frozen=True)
class Decoded:
    """Linear samples of a tile, every one with its own clip state.

    Parameters
    ----------
    values : (m, n) float32
        In units of the clip level at exposure 1; where clipped, a lower bound.
    clipped : (m, n) bool
        Whether the raw level reached the clip level.
    clip_level : (n,) or (m, n) float32
        The value at which each sample clips.
    """

    values: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    clip_level: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Decoder:
    """From raw levels to linear samples.

    Parameters
    ----------
    clip : float or (K,)
        Raw level at which each frame clips.
    full_scale : float
        Raw level that the response calls 1.
    black_level : float or (K,)
        Raw level without any light (the camera's pedestal), below `clip`.
    response : Response
        Undone before the black level is subtracted.
    exposure : float or (K,)
        Exposure of each frame; the samples are divided by it.
    black_frame : (M,) float, optional
        Raw levels of each camera sample under a black pattern; subtracted instead of
        `black_level`, which still sets the scale.
    black_exposure : float, optional
        Exposure of the black frame; its light above `black_level` grows with the exposure. None
        means that of the frames, which must then be one.

    Raises
    ------
    InputError
        On levels out of range, or a black frame without exposure where the frames' differ.
    """

    clip: float | NDArray[Any]
    full_scale: float
    black_level: float | NDArray[Any] = 0.0
    response: Response = field(default_factory=Response)
    exposure: float | NDArray[Any] = 1.0
    black_frame: NDArray[Any] | None = None
    black_exposure: float | None = None

    def __post_init__(self) -> None:
        _check_levels(self.clip, self.black_level, self.full_scale)
        exposure = np.asarray(self.exposure)
        if not (np.isfinite(exposure).all() and (exposure > 0).all()):
            raise InputError(
                f"an exposure of {exposure.min()}", hint="use positive numbers, such as 1"
            )
        if self.black_frame is not None and self.black_exposure is None and np.ptp(exposure) > 0:
            raise InputError(
                "a black frame of unknown exposure, while the frames differ in exposure",
                hint="give the exposure of the black frame in capture.json",
            )

    @cached_property
    def _table(self) -> NDArray[np.float32]:
        """Light at each of the integer levels."""
        levels = np.arange(int(self.full_scale) + 1)
        return self.response.linearise(levels / self.full_scale).astype(np.float32)

    def _light(self, levels: float | NDArray[Any]) -> NDArray[np.float64]:
        share = np.asarray(levels, np.float64) / self.full_scale
        return self.response.linearise(share)

    @property
    def hot(self) -> NDArray[np.bool_] | None:
        """Samples that clip without light and so tell nothing, (M,); None without black frame."""
        if self.black_frame is None:
            return None
        return np.asarray(np.asarray(self.black_frame) >= np.min(self.clip))

    def decode(self, raw: NDArray[Any], *, first_row: int = 0, first_frame: int = 0) -> Decoded:
        """Decode a tile.

        Parameters
        ----------
        raw : (m, n) uint8, uint16 or float32
            Raw levels of m camera samples in n frames.
        first_row, first_frame : int
            Where this tile begins in the whole capture.

        Returns
        -------
        Decoded
            Samples in units of the clip level above `black_level`, at exposure 1.
        """
        rows, frames = raw.shape
        stop = first_frame + frames
        clip = _of_frames(self.clip, first_frame, stop, "clip levels")
        pedestal = self._light(_of_frames(self.black_level, first_frame, stop, "black levels"))
        exposure = _of_frames(self.exposure, first_frame, stop, "exposures")
        # The first level of the raw type that is not below the clip level.
        if raw.dtype.kind == "u":
            clipped = raw >= np.ceil(clip).astype(raw.dtype)
            light = self._table[np.minimum(raw, int(self.full_scale))]
        else:
            clipped = raw >= clip.astype(np.float32)
            light = self._light(raw).astype(np.float32)
        ceiling = self._light(clip)
        black = pedestal
        if self.black_frame is not None:
            dark = self._light(self.black_frame[first_row : first_row + rows])[:, None]
            ratio = exposure / self.black_exposure if self.black_exposure else 1.0
            black = pedestal + (dark - pedestal) * ratio
        scale = 1 / ((ceiling - pedestal) * exposure)
        values = (light - black.astype(np.float32)) * scale.astype(np.float32)
        level = ((ceiling - black) * scale).astype(np.float32)
        # Exactly the clip level, not one rounding away from it.
        np.copyto(values, np.broadcast_to(level, values.shape), where=clipped)
        return Decoded(values, clipped, level)


def bin_samples(
    decoded: Decoded,
    valid: NDArray[np.bool_] | None,
    shape: tuple[int, ...],
    block: tuple[int, int],
) -> tuple[Decoded, NDArray[np.bool_]]:
    """Means over blocks of camera pixels that keep the truth about clipping.

    A binned sample is clipped if any of its pixels is, and is then a lower bound like theirs.
    Pixels that are not valid are left out; blocks at the border may be smaller.

    Parameters
    ----------
    decoded : Decoded
        Samples (M, n) of whole frames.
    valid : (M,) bool, optional
        Which samples count; None means all.
    shape : (rows, cols) or (rows, cols, channels)
        Of the camera, M = product.
    block : (int, int)
        Rows and columns of a block.

    Returns
    -------
    binned : Decoded
        Samples (M', n); 0 and not clipped where no pixel of the block is valid.
    valid : (M',) bool
        Whether any pixel of the block is.
    """
    grid = (*shape[:2], shape[2] if len(shape) == 3 else 1)
    weight = np.ones(grid) if valid is None else valid.reshape(grid).astype(np.float64)
    counts = _block_sums(weight[..., None], block)
    share = 1 / np.maximum(counts, 1)

    def mean(samples: NDArray[Any]) -> NDArray[np.float32]:
        sums = _block_sums(samples.reshape(*grid, -1) * weight[..., None], block)
        return (sums * share).reshape(-1, sums.shape[-1]).astype(np.float32)

    any_clipped = mean(decoded.clipped.astype(np.float32)) > 0
    level = decoded.clip_level
    if level.ndim == 2:
        level = mean(np.broadcast_to(level, decoded.values.shape))
    return Decoded(mean(decoded.values), any_clipped, level), counts.ravel() > 0


def _block_sums(values: NDArray[Any], block: tuple[int, int]) -> NDArray[np.float64]:
    """Sums over blocks of the first two axes."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], block[0]), axis=0, dtype=float)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], block[1]), axis=1)


def _of_frames(
    value: float | NDArray[Any], start: int, stop: int, name: str
) -> NDArray[np.float64]:
    array = np.asarray(value, np.float64)
    if array.ndim == 0:
        return np.full(stop - start, array)
    if stop > len(array):
        raise InputError(f"{len(array)} {name} for {stop} frames", hint="give one for each frame")
    return array[start:stop]


def _check_levels(
    clip: float | NDArray[Any], black_level: float | NDArray[Any], full_scale: float
) -> None:
    clips, blacks = np.asarray(clip, np.float64), np.asarray(black_level, np.float64)
    if not (np.isfinite(clips).all() and (clips > 0).all() and (clips <= full_scale).all()):
        raise InputError(
            f"a clip level of {clips.min() if clips.size else clip:g}",
            hint=f"use a raw level above 0 and at most {full_scale:g}",
        )
    if not (np.isfinite(blacks).all() and (blacks >= 0).all() and (blacks < clips).all()):
        raise InputError(
            f"a black level of {blacks.flat[0]:g} with a clip level of {clips.flat[0]:g}",
            hint="use a raw level of at least 0 and below the clip level",
        )
