"""What real rigs do wrong, put into simulated photographs: one small function a fault.

Faults act in the order of the light: on the pattern within the projector, on the light of the
projector over time, on the light of the room, on where the camera stands, and in the camera, before
`Sensor` adds noise, clips and rounds. The truth of a capture has none of them: it is T under the
mean light, seen from the camera's mean position.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.ranges import check_number

Images = NDArray[np.float32]


@dataclass(frozen=True)
class _Shots:
    """What a fault's function knows of the capture besides its images."""

    amount: float
    # The fault's own random numbers: the same of a seed, whatever else happens.
    random: np.random.Generator
    # Mean of each pattern and exposure of each frame, (K,).
    means: NDArray[np.float64]
    exposures: NDArray[np.float64]

    def each(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """One value for each frame, (K,), to be multiplied with images."""
        return np.asarray(values, np.float32)[:, None, None, None]


# In the projector: patterns (K, rows, primaries, cols) in [0, 1] and what is emitted of them.


def _sharpening(shown: Images, shots: _Shots) -> Images:
    blurred = scipy.ndimage.gaussian_filter(shown, (0, 1, 0, 1), mode="nearest")
    return (shown + shots.amount * (shown - blurred)).clip(0, 1)


def _crosstalk(shown: Images, shots: _Shots) -> Images:
    # A pixel at the border has no neighbour beyond it, and counts as its own there.
    wide = np.pad(shown, ((0, 0), (1, 1), (0, 0), (1, 1)), mode="edge")
    neighbours = wide[:, :-2, :, 1:-1] + wide[:, 2:, :, 1:-1]
    neighbours += wide[:, 1:-1, :, :-2] + wide[:, 1:-1, :, 2:]
    return np.asarray(shown * (1 - shots.amount * (1 - neighbours / 4)))


# The projector's light at the camera, (K, rows, cols, channels), at exposure 1.


def _before(light: Images) -> Images:
    """The light of the pattern before; the first one was shown before it was photographed."""
    return np.concatenate([light[:1], light[:-1]])


def _previous(light: Images, shots: _Shots) -> Images:
    return light + np.float32(shots.amount) * (_before(light) - light)


def _torn(light: Images, shots: _Shots) -> Images:
    first = round((1 - shots.amount) * light.shape[1])
    return np.concatenate([light[:, :first], _before(light)[:, first:]], axis=1)


def _dynamic_contrast(light: Images, shots: _Shots) -> Images:
    return light * shots.each(1 + shots.amount * (shots.means - 0.5))


def _gain(light: Images, shots: _Shots) -> Images:
    gains = (1 + shots.amount * shots.random.standard_normal(len(light))).clip(0)
    return light * shots.each(gains / max(gains.mean(), 1e-9))


def _rows(light: Images, shots: _Shots) -> Images:
    # A shutter rolls over the picture in 5 to 30 ms: half a period to three of light at 100 Hz.
    periods = shots.random.uniform(0.5, 3)
    phases = shots.random.uniform(0, 2 * np.pi, len(light))
    place = 2 * np.pi * periods * np.arange(light.shape[1]) / light.shape[1]
    wave = np.sin(place + phases[:, None])[:, :, None, None]
    return np.asarray(light * (1 + shots.amount * wave), np.float32)


# All light at the camera, (K, rows, cols, channels), at exposure 1.


def _ambient(light: Images, shots: _Shots) -> Images:
    grown = np.linspace(0, shots.amount, len(light)) / shots.exposures.max()
    return light + shots.each(grown)


def _exposure(light: Images, shots: _Shots) -> Images:
    late = np.arange(len(light)) >= len(light) // 2
    return light * shots.each(1 + shots.amount * late)


def _camera_sharpening(light: Images, shots: _Shots) -> Images:
    blurred = scipy.ndimage.gaussian_filter(light, (0, 1, 1, 0), mode="nearest")
    return (light + np.float32(shots.amount) * (light - blurred)).clip(0)


def _tone_mapping(light: Images, shots: _Shots) -> Images:
    mean = light.mean(axis=(1, 2, 3), keepdims=True) + np.float32(1e-9)
    around = scipy.ndimage.gaussian_filter(light, (0, 4, 4, 0), mode="nearest").clip(0)
    # A hundredth of the mean keeps the gain of black surroundings finite.
    gain = ((around + mean / 100) / mean) ** np.float32(-shots.amount)
    return np.asarray(light * gain)


def _camera_curve(light: Images, shots: _Shots) -> Images:
    exposures = shots.each(shots.exposures)
    return np.asarray((light * exposures).clip(0) ** np.float32(1 / shots.amount) / exposures)


# Displacement of each frame: where its image lies in the still one, (K, 2, 3) as an affine map of
# the place (row, col) from the middle to a displacement in pixels.


def _shake(shape: tuple[int, ...], shots: _Shots) -> NDArray[np.float64]:
    moves = np.zeros((shape[0], 2, 3))
    moves[:, :, 2] = shots.amount * shots.random.standard_normal((shape[0], 2))
    return moves


def _creep(shape: tuple[int, ...], shots: _Shots) -> NDArray[np.float64]:
    moves = np.zeros((shape[0], 2, 3))
    moves[:, :, 2] = np.linspace(0, shots.amount / np.sqrt(2), shape[0])[:, None]
    return moves


def _breathing(shape: tuple[int, ...], shots: _Shots) -> NDArray[np.float64]:
    radius = np.hypot(shape[1], shape[2]) / 2
    zoom = shots.amount * shots.random.standard_normal(shape[0]) / radius
    return zoom[:, None, None] * np.eye(2, 3)


@dataclass(frozen=True)
class Fault:
    """A fault: where it acts, what it does, the range of its amount, and what that means."""

    place: str
    act: Callable[..., NDArray[Any]]
    most: float
    meaning: str
    # The least amount, and the one that changes nothing.
    least: float = 0.0


# The faults in the order in which they act.
FAULTS: dict[str, Fault] = {
    "projector-curve": Fault(
        "projector", lambda shown, shots: shown**shots.amount, 10, "gamma of grey values", 0.1
    ),
    "sharpening": Fault("projector", _sharpening, 10, "strength of the projector's unsharp mask"),
    "crosstalk": Fault(
        "projector", _crosstalk, 1, "share of its light that a pixel loses among dark ones"
    ),
    "previous": Fault("light", _previous, 1, "share of the picture before in each photograph"),
    "torn": Fault("light", _torn, 1, "share of the rows that show the picture before"),
    "dynamic-contrast": Fault(
        "light", _dynamic_contrast, 1, "light of a white pattern less that of a black one"
    ),
    "gain": Fault("light", _gain, 1, "standard deviation of the frames' light"),
    "rows": Fault("light", _rows, 1, "amplitude of a wave over the camera's rows"),
    "ambient": Fault("room", _ambient, 1, "room light at the end, as a share of the clip level"),
    "shake": Fault("camera's place", _shake, 100, "standard deviation, in camera pixels"),
    "creep": Fault("camera's place", _creep, 100, "from the first frame to the last, in pixels"),
    "breathing": Fault(
        "camera's place", _breathing, 100, "standard deviation of the zoom, in pixels at a corner"
    ),
    "exposure": Fault("camera", _exposure, 10, "change from the middle of the capture on", -0.9),
    "camera-sharpening": Fault(
        "camera", _camera_sharpening, 10, "strength of the camera's unsharp mask"
    ),
    "tone-mapping": Fault(
        "camera", _tone_mapping, 1, "exponent by which dark surroundings are brightened"
    ),
    "camera-curve": Fault("camera", _camera_curve, 10, "gamma of the levels", 0.1),
    # `simulate` takes the black frame by itself, see `Faults.black_exposure`.
    "black": Fault(
        "black frame", lambda light, _: light, 10, "change of the black frame's exposure", -0.9
    ),
}


class Faults:
    """The faults of one capture, by name and amount."""

    def __init__(self, amounts: Mapping[str, float], seed: int) -> None:
        for name, amount in amounts.items():
            if name not in FAULTS:
                hint = f"use one of {', '.join(FAULTS)}"
                raise InputError(f"there is no fault called {name!r}", hint=hint)
            fault = FAULTS[name]
            check_number(
                f"a fault {name}", amount, least=fault.least, most=fault.most,
                hint=f"use a number from {fault.least:g} to {fault.most:g}: {fault.meaning}",
            )  # fmt: skip
        self.amounts = {name: float(amounts[name]) for name in FAULTS if name in amounts}
        self._seed = seed

    def _at(self, *places: str) -> list[str]:
        return [name for name in self.amounts if FAULTS[name].place in places]

    def _shots(self, name: str, patterns: PatternSet, exposures: NDArray[Any]) -> _Shots:
        random = np.random.default_rng([self._seed, *name.encode()])
        each = np.broadcast_to(np.asarray(exposures, np.float64), patterns.count)
        return _Shots(self.amounts[name], random, patterns.means, each)

    def emitted(self, patterns: PatternSet) -> PatternSet:
        """What the projector emits in place of the patterns; the patterns if it has no fault."""
        names = self._at("projector")
        if not names:
            return patterns
        rows, cols = patterns.red.shape if isinstance(patterns, ColourPatterns) else patterns.shape
        shown = patterns.rows(0, patterns.count).reshape(patterns.count, rows, -1, cols)
        for name in names:
            shown = FAULTS[name].act(shown, self._shots(name, patterns, np.ones(1)))
        return ImagePatterns(shown.reshape(patterns.count, *patterns.shape))

    def of_camera(
        self, light: Images, patterns: PatternSet, shape: tuple[int, ...], exposures: Any
    ) -> Images:
        """All light (M, K) as the camera takes it: grown by the room, moved, and processed."""
        light = self.acted("room", light, patterns, shape, exposures)
        if names := self._at("camera's place"):
            size = (patterns.count, *shape)
            each = [
                FAULTS[name].act(size, self._shots(name, patterns, exposures)) for name in names
            ]
            moves = np.sum(each, axis=0)
            light = _moved(light, moves - moves.mean(axis=0), shape)
        return self.acted("camera", light, patterns, shape, exposures)

    def acted(
        self, at: str, light: Images, patterns: PatternSet, shape: tuple[int, ...], exposures: Any
    ) -> Images:
        """Light (M, K) after the faults of a place; `shape` is that of a frame."""
        names = self._at(at)
        if not names:
            return light
        images = light.T.reshape(-1, shape[0], shape[1], light.shape[0] // (shape[0] * shape[1]))
        for name in names:
            images = FAULTS[name].act(images, self._shots(name, patterns, exposures))
        return np.asarray(images.reshape(patterns.count, -1).T, np.float32)

    @property
    def black_exposure(self) -> float:
        """The exposure of the black frame, as a multiple of the stated one."""
        return 1 + self.amounts.get("black", 0.0)


def _moved(light: Images, moves: NDArray[np.float64], shape: tuple[int, ...]) -> Images:
    """Frames (M, K), each from where its affine map (2, 3) puts it; a cubic spline in between."""
    images = light.T.reshape(-1, shape[0], shape[1], light.shape[0] // (shape[0] * shape[1]))
    middle = (np.array(shape[:2]) - 1) / 2
    moved = np.empty_like(images)
    for image, result, move in zip(images, moved, moves, strict=True):
        matrix = np.eye(2) - move[:, :2]
        offset = middle - matrix @ middle - move[:, 2]
        for channel in range(image.shape[2]):
            result[..., channel] = scipy.ndimage.affine_transform(
                image[..., channel], matrix, offset, order=3, mode="nearest"
            )
    # A spline swings below zero beside a bright edge, which light does not.
    return np.asarray(moved.clip(0).reshape(len(moves), -1).T)
