"""`lm.compensate`: the pattern under which the camera sees a wanted picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.writing import check_output
from lightmatrix.ranges import check_number
from lightmatrix.reprs import short_repr
from lightmatrix.uses.images import (
    Picture,
    ambient_samples,
    mask_samples,
    wanted_samples,
    write_shown,
)
from lightmatrix.uses.joint_light import JointLight, joint_light
from lightmatrix.uses.loading import Transport

# Least squares over patterns in [0, 1], by an accelerated projected gradient method.


# The ridge, relative to the median step bound of the projector pixels that are seen. It darkens
# pixels that no camera pixel sees, and costs no PSNR on the bundled scenes (1e-2: up to 0.8 dB).
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class BoundedFit:
    """min over p in [0, 1] of f(p) = 1/2 ||T p - y||^2_W + r/2 ||p||^2.

    FISTA (Beck & Teboulle 2009) in the metric of L = T' W T 1 + r, with the restart by gradient of
    O'Donoghue & Candes (2015). As T has no negative entries, diag(L) - T' W T is diagonally
    dominant, hence positive semidefinite: 1 / L is a safe step for each pixel by itself. Of a T
    with negative entries, L takes the magnitudes.
    """

    light: JointLight
    # (M,) float32: weights W >= 0 of the camera samples.
    weights: NDArray[np.float32]

    @cached_property
    def _bounds(self) -> NDArray[np.float32]:
        """T' W T 1, (N,), of the magnitudes of T."""
        light = self.light.without_signs
        return light.adjoint(self.weights * light.white)

    @cached_property
    def ridge(self) -> float:
        """The ridge r; positive, so that the solution is unique."""
        seen = self._bounds[self._bounds > 0]
        return _RIDGE * float(np.median(seen)) if seen.size else 1.0

    def gradient(
        self, light: NDArray[np.float32], samples: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The gradient of f, (N,), at patterns (N,) for the wanted samples y (M,)."""
        misfit = self.light.forward(light)
        misfit -= samples
        misfit *= self.weights
        gradient = self.light.adjoint(misfit)
        gradient += np.float32(self.ridge) * light
        return gradient

    def solve(
        self, samples: NDArray[np.float32], start: NDArray[np.float32], iterations: int
    ) -> NDArray[np.float32]:
        """The patterns (N,) float32 in [0, 1] after so many iterations from the start (N,)."""
        bounds = self._bounds + np.float32(self.ridge)
        pattern = np.clip(start, 0, 1).astype(np.float32)
        ahead, momentum = pattern, 1.0
        for _ in range(iterations):
            # A projected gradient step from the point ahead.
            updated = ahead - self.gradient(ahead, samples) / bounds
            np.clip(updated, 0, 1, out=updated)
            step = updated - pattern
            # Restart once the step goes against the gradient.
            if float(((ahead - updated) * bounds) @ step) > 0:
                momentum = 1.0
            grown = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = updated + np.float32((momentum - 1) / grown) * step
            pattern, momentum = updated, grown
        return pattern


# Against 300 iterations, 25 lose at most 0.2 dB on the bundled scenes at 64 x 64.
USUAL_ITERATIONS = 25
# A camera sample is in shadow if white gives it less than this share of what bright samples get, a
# quantile of its channel. Chosen by hand: dark surfaces reflect about a tenth.
_SHADOW, _BRIGHT = 0.1, 0.9
# The automatic brightness lets this share of the lit samples ask for more light than white gives
# them. On the bundled scenes half of it costs 20 to 45 % of the brightness.
_TOO_DARK = 0.02
# A camera sample whose row of T has an estimated error of 0.07 counts half, one with n times that
# 1 / (1 + n^2), but at least the second value. Rows that are wrong would spoil the light of their
# neighbours, which are right. Chosen on the scenes of benchmarks/separation_scenes.py, where it
# gains up to 7 dB among metal parts, and 0.03 or 0.15 are worse by up to 1 dB.
_HALF_TRUSTED, _LEAST_TRUST = 0.07, 0.01
# A sample is reached if the prediction misses it by at most this share of the light of wanted
# white: 1 / 20, about 13 levels of an 8-bit picture.
TOLERANCE = 0.05


class Reach(IntEnum):
    """What becomes of a camera sample, the values of `Compensation.reach`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> from lightmatrix.uses.compensation import Reach
    >>> found = lm.compensate(lm.truth("metal").transport(), np.full((64, 64), 0.5))
    >>> bool((found.reach == Reach.SHADOW).any())
    True
    """

    REACHED = 0
    # The mask leaves it out.
    MASKED = 1
    # The projector hardly lights it.
    SHADOW = 2
    # It asks for more light than it gets.
    TOO_DARK = 3
    # It gets more than it asks for: light of other surfaces, or of the room.
    TOO_BRIGHT = 4


@dataclass(frozen=True, eq=False)
class Compensation:
    """The pattern for a wanted picture, and what the camera will see; made by `compensate`.

    Parameters
    ----------
    patterns : tuple of (rows, cols) float32
        The pattern of each projector, or of each primary, in [0, 1].
    predicted : camera_shape float32
        The photograph to expect, c = T p + ambient, at exposure 1, not clipped.
    target : camera_shape float32
        The light that was asked for, s d.
    scale : float
        s: the light of wanted white, in units of camera full scale. With a colour camera the mean
        over its channels, which share it as they do the projector's white.
    brightness : float
        `scale` as a share of what the lit camera samples see under a white pattern, their median.
    reach : camera_shape uint8
        0 where the picture is reached; else why not (see `Reach`): 1 masked, 2 in shadow, 3 too
        dark there, 4 too bright there.
    exposure : float
        The exposure e for which `clipped` is told.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("l_objects").transport()
    >>> found = lm.compensate(known, np.full((64, 64), 0.5))
    >>> found.pattern.shape, bool(found.reachable.mean() > 0.8)
    ((64, 64), True)
    """

    patterns: tuple[NDArray[np.float32], ...]
    predicted: NDArray[np.float32]
    target: NDArray[np.float32]
    scale: float
    brightness: float
    reach: NDArray[np.uint8]
    exposure: float = 1.0

    __repr__ = short_repr

    @property
    def pattern(self) -> NDArray[np.float32]:
        """The pattern (rows, cols) of one projector; of several of one size (rows, cols, count)."""
        if len(self.patterns) == 1:
            return self.patterns[0]
        if len({pattern.shape for pattern in self.patterns}) > 1:
            raise InputError("the projectors differ in size", hint="take them from `patterns`")
        return np.stack(self.patterns, axis=-1)

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Camera samples that come within 5 % of wanted white of what they should be."""
        return self.reach == Reach.REACHED

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """Camera samples that would clip at the exposure."""
        return self.exposure * self.predicted >= 1

    @property
    def psnr(self) -> float:
        """The predicted error on samples that are neither masked nor in shadow, in dB."""
        counted = (self.reach != Reach.MASKED) & (self.reach != Reach.SHADOW)
        missed = (self.predicted - self.target)[counted] / self.scale
        return float(-10 * np.log10(max(float(np.mean(missed**2)), 1e-12)))

    def as_dict(self) -> dict[str, Any]:
        """Scale, brightness, predicted PSNR, and shares of camera samples; JSON-ready."""
        shares = {name.name.lower(): float((self.reach == name).mean()) for name in Reach}
        return {
            "scale": self.scale,
            "brightness": self.brightness,
            "predicted_psnr": self.psnr,
            **shares,
            "clipped": float(self.clipped.mean()),
        }


@dataclass(frozen=True, eq=False)
class Compensator:
    """What compensations of one scene share: T, the room's light, and what white reaches."""

    light: JointLight
    # (M,): light without the projector, in camera full scale.
    ambient: NDArray[np.float32]
    # (M,): samples that count.
    chosen: NDArray[np.bool_]
    exposure: float = 1.0
    # Whether samples count less whose row of T has a large estimated error.
    weigh_errors: bool = True

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Samples that count and that are not in shadow, (M,)."""
        white = self._by_channel(self.light.white)
        bright = np.quantile(white, _BRIGHT, axis=0)
        lit = ((white > _SHADOW * bright) & (white > 0)).ravel() & self.chosen
        if not lit.any():
            raise InputError(
                "the projector lights no camera pixel that counts",
                hint="is the mask right, and is there light in the matrix?",
            )
        return np.asarray(lit)

    @cached_property
    def white_point(self) -> NDArray[np.float32]:
        """The light of wanted white at full brightness, (M,): a median, for each channel."""
        white, lit = self._by_channel(self.light.white), self._by_channel(self.lit)
        medians = [np.median(white[lit[:, c], c]) if lit[:, c].any() else 0 for c in self._channels]
        return np.tile(np.array(medians, np.float32), len(white))

    @cached_property
    def fit(self) -> BoundedFit:
        """The least squares problem; samples in shadow, which nothing helps, do not count."""
        weights = self.lit.astype(np.float32)
        if self.weigh_errors:
            trust = 1 / (1 + (self.light.errors / _HALF_TRUSTED) ** 2)
            weights *= np.maximum(trust, _LEAST_TRUST)
        return BoundedFit(self.light, weights)

    @property
    def _channels(self) -> range:
        shape = self.light.camera_shape
        return range(shape[2] if len(shape) == 3 else 1)

    def _by_channel(self, samples: NDArray[Any]) -> NDArray[Any]:
        return samples.reshape(-1, len(self._channels))

    def automatic_brightness(self, wanted: NDArray[np.float32]) -> float:
        """The brightness at which one lit sample in 50 asks for more light than white gives it."""
        asked = wanted * self.white_point
        counted = self.lit & (asked > 0)
        if not counted.any():
            raise InputError(
                "the wanted picture is black where the projector lights the scene",
                hint="move the picture, or the mask",
            )
        room = (self.light.white + self.ambient)[counted] / asked[counted]
        return float(np.quantile(room, _TOO_DARK))

    def start(self, target: NDArray[np.float32]) -> NDArray[np.float32]:
        """The pattern by gains of single pixels, (N,): what inverse methods without T do.

        Each camera sample asks for target / white, and each projector pixel gets the mean of what
        the samples ask that it lights.
        """
        asked = np.zeros_like(target)
        np.divide(target - self.ambient, self.light.white, out=asked, where=self.lit)
        asked = np.clip(asked, 0, 1)
        weight = self.light.adjoint(self.lit.astype(np.float32))
        light = self.light.adjoint(asked)
        return np.divide(light, weight, out=np.zeros_like(light), where=weight > 0)

    def solve(
        self,
        wanted: NDArray[np.float32],
        brightness: float | None = None,
        *,
        start: NDArray[np.float32] | None = None,
        iterations: int = USUAL_ITERATIONS,
    ) -> Compensation:
        """Compensate for wanted light (M,) in [0, 1]; `start` is the pattern (N,) to begin with."""
        if brightness is None:
            brightness = self.automatic_brightness(wanted)
        target = np.float32(brightness) * wanted * self.white_point
        return self.reaching(target, brightness, start=start, iterations=iterations)

    def reaching(
        self,
        target: NDArray[np.float32],
        brightness: float,
        *,
        start: NDArray[np.float32] | None = None,
        asked: NDArray[np.float32] | None = None,
        iterations: int = USUAL_ITERATIONS,
    ) -> Compensation:
        """The compensation for target light (M,), while the solver is asked for `asked` instead.

        `asked` differs where earlier photographs showed that the prediction is wrong.
        """
        first = self.start(target) if start is None else start
        goal = (target if asked is None else asked) - self.ambient
        pattern = self.fit.solve(goal, first, iterations)
        predicted = self.light.forward(pattern) + self.ambient
        scale = brightness * float(self.white_point[: len(self._channels)].mean())
        shape = self.light.camera_shape
        return Compensation(
            self.light.split(pattern),
            predicted.reshape(shape),
            target.reshape(shape),
            scale,
            brightness,
            self._reach(predicted, target, brightness).reshape(shape),
            self.exposure,
        )

    def _reach(
        self, predicted: NDArray[np.float32], target: NDArray[np.float32], brightness: float
    ) -> NDArray[np.uint8]:
        reach = np.full(len(target), Reach.REACHED, np.uint8)
        missed, allowed = predicted - target, TOLERANCE * brightness * self.white_point
        reach[missed > allowed] = Reach.TOO_BRIGHT
        reach[missed < -allowed] = Reach.TOO_DARK
        reach[~self.lit] = Reach.SHADOW
        reach[~self.chosen] = Reach.MASKED
        return reach


def compensator(
    transport: Transport | Sequence[Transport],
    *,
    ambient: Picture | None = None,
    mask: Picture | None = None,
    exposure: float = 1.0,
) -> Compensator:
    """What compensations of one scene share, from arguments of `compensate`."""
    hint = "use a number above 0, such as 1"
    check_number("an exposure", exposure, most=1e9, above=True, hint=hint)
    light = joint_light(transport)
    shape = light.camera_shape
    return Compensator(light, ambient_samples(ambient, shape), mask_samples(mask, shape), exposure)


def compensate(
    transport: Transport | Sequence[Transport],
    wanted: Picture,
    *,
    ambient: Picture | None = None,
    mask: Picture | None = None,
    brightness: float | None = None,
    gamma: float = 1.0,
    resize: bool = False,
    exposure: float = 1.0,
    iterations: int = USUAL_ITERATIONS,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Compensation:
    """The pattern under which the camera sees a wanted picture.

    Solves min over p in [0, 1] of ||W (T p + a - s d)||^2 + r ||p||^2, where d is the wanted
    picture, s its brightness, a the room's light, W the mask times the trust in each row of T, and
    r a small ridge, by FISTA (Beck & Teboulle, "A Fast Iterative Shrinkage-Thresholding Algorithm",
    SIAM J. Imaging Sci. 2009). Rows with a large estimated error count less. T holds what light
    does on its way from surface to surface, so interreflection is compensated too.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path, or several of them
        T, or where `open` finds it. Several: projectors that light one scene together, or the
        primaries of a colour projector, also as the folder that `save_colour` wrote; their patterns
        are found jointly. A store is loaded.
    wanted : (rows, cols) or (rows, cols, channels) array, str or Path
        The picture in [0, 1], as the camera is to see it. Grey for a colour camera: in the colours
        that the scene has under a white pattern.
    ambient : array, str or Path, optional
        Light without the projector, in units of the clip level, such as a black frame. None: none.
    mask : array, str or Path, optional
        0 where the picture does not matter. None: it matters everywhere.
    brightness : float, optional
        The light of wanted white, as a share of what the lit camera pixels see under a white
        pattern (their median), above 0. None: as bright as possible while no more than one lit
        pixel in 50 asks for more light than white gives it.
    gamma : float
        Display gamma of the picture, 0.1 to 10; 1 if it is linear, 2.2 for most photographs.
    resize : bool
        Whether to resize a picture of another size to the camera.
    exposure : float
        The exposure for which `Compensation.clipped` is told.
    iterations : int
        Of the solver, at least 1.
    output : str or Path, optional
        Image file to write the pattern to: .png (8 bits, linear), .tiff, .exr or .npy. Three
        patterns of one size become one in colour; otherwise several become NAME-1.png, NAME-2.png.
    overwrite : bool
        Whether existing images may be replaced.

    Returns
    -------
    Compensation

    Raises
    ------
    InputError
        On a picture of another size or all black, a mask that leaves nothing, numbers out of range,
        matrices of different cameras, or a store that does not fit into memory.
    OutputError
        If the pattern cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> wanted = np.tile(np.linspace(0.2, 1, 64), (64, 1))
    >>> found = lm.compensate(known, wanted, brightness=0.3, output="shown.png")
    >>> lm.read_image("shown.png").shape
    (64, 64)
    """
    if brightness is not None:
        hint = "use a number above 0, such as 0.7, or leave it out"
        check_number("a brightness", brightness, most=1e6, above=True, hint=hint)
    _check_iterations(iterations)
    if output is not None:
        check_output(output, IMAGE, overwrite=overwrite)
    shared = compensator(transport, ambient=ambient, mask=mask, exposure=exposure)
    samples = wanted_samples(wanted, shared.light.camera_shape, gamma=gamma, resize=resize)
    found = shared.solve(samples, brightness, iterations=iterations)
    if output is not None:
        write_shown(output, found.patterns, overwrite=overwrite)
    return found


def _check_iterations(iterations: int) -> None:
    if not hasattr(iterations, "__index__") or iterations < 1:
        raise InputError(f"{iterations} iterations", hint="use at least 1, such as 25")
