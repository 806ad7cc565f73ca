"""Small captures of known T: scenes, patterns and damages of many kinds, at any size.

A capture is a scene under a set of patterns, with one thing wrong with it or nothing. Scenes range
from those that sparse estimation likes (a textured wall in focus) to those that it cannot know
(single rows that hold most of the light). `draw` makes one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.files.images import decode_image, encode_image
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.truth import binned
from lightmatrix.transport.matrix import LightTransport

Floats = NDArray[np.float32]
Generator = np.random.Generator

# Read noise, in units of the clip level.
NOISE = 0.003


@dataclass(frozen=True, eq=False)
class SyntheticCapture:
    """One capture with what made it, and the T that an honest estimate approaches."""

    scene: str
    patterns: str
    damage: str
    size: int
    capture: Capture
    truth: LightTransport

    @property
    def name(self) -> str:
        """What made it, in a word each."""
        return f"{self.scene} {self.patterns} {self.damage} {self.size}"


def draw(scene: str, patterns: str, damage: str, size: int, seed: int) -> SyntheticCapture:
    """A capture of a scene (`SCENES` or bundled) under patterns (`PATTERNS`) with a damage."""
    generator = np.random.default_rng(seed)
    matrix = scene_matrix(scene, size, generator)
    images = (PATTERNS | HIDDEN_PATTERNS)[patterns](size, generator)
    shown: PatternSet = ImagePatterns(images)
    if patterns in _RANDOM:
        shown = BernoulliPatterns((size, size), _RANDOM[patterns], seed=seed)
        images = shown.rows(0, shown.count).reshape(-1, size, size)
    light = np.asarray(matrix @ images.reshape(len(images), -1).T, np.float32)
    strongest = np.maximum.reduceat(matrix.data, matrix.indptr[:-1][np.diff(matrix.indptr) > 0])
    exposure = min(
        1 / float(np.quantile(matrix.sum(axis=1), 0.99)) * 1.5,
        1 / float(np.quantile(strongest[strongest > 0], 0.8)),
    )
    exposure *= 4 if damage == "overexposed" else 1
    light = light.T.reshape(-1, size, size) * exposure
    white = np.asarray(matrix.sum(axis=1)).reshape(size, size) * exposure
    light = _DAMAGED_LIGHT.get(damage, _unchanged)(
        np.asarray(light, np.float32), np.asarray(white, np.float32), generator
    )
    raw = Sensor(1.0, 0.0, NOISE).expose(light.reshape(len(light), -1).T, seed=seed)
    frames = np.ascontiguousarray(raw.T).reshape(light.shape)
    if damage in DAMAGED_FRAMES:
        frames = DAMAGED_FRAMES[damage](frames, generator)
    if damage == "video range":
        frames = np.rint(16 + frames * (219 / 255)).astype(np.uint8)
    elif damage in CLIPPING:
        frames = np.minimum(frames, np.uint8(CLIPPING[damage]))
    if damage == "other seed":
        shown = BernoulliPatterns((size, size), shown.count, seed=seed + 1000)
    if damage == "patterns inverted":
        shown = ImagePatterns(1 - images)
    capture = Capture.from_arrays(shown, np.ascontiguousarray(frames), Sensor(1.0, 0.0, NOISE))
    known = csr_array(matrix * exposure).astype(np.float32)
    nothing = np.zeros((known.shape[0], 1), np.float32)
    truth = LightTransport(known, nothing, (size, size), (size, size))
    return SyntheticCapture(scene, patterns, damage, size, capture, truth)


def scene_matrix(scene: str, size: int, generator: Generator) -> csr_array:
    """T of a scene, (size^2, size^2), with both camera and projector of size x size pixels."""
    if scene == "own pixels":
        return _own_pixels(size, generator)
    if scene in library.BUNDLED:
        times = max(1, library.BUNDLED_SIZE[0] // size)
        known = library.truth(scene, (size * times, size * times))
        return csr_array(binned(known, times, times).matrix)
    return SCENES[scene](size, generator)


def _footprints(places: Floats, size: int, sigma: float, reach: int) -> csr_array:
    """Rows that are Gaussian spots around places (M, 2) of the projector."""
    offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"), -1)
    pixels = np.round(places)[:, None, :] + offsets.reshape(1, -1, 2)
    distance = ((pixels - places[:, None, :]) ** 2).sum(axis=2)
    weight = np.exp(-distance / (2 * sigma**2))
    inside = ((pixels >= 0) & (pixels < size)).all(axis=2)
    rows = np.broadcast_to(np.arange(len(places))[:, None], inside.shape)[inside]
    cols = (pixels[..., 0] * size + pixels[..., 1])[inside].astype(np.int64)
    matrix = csr_array((weight[inside], (rows, cols)), shape=(len(places), size * size))
    return csr_array(matrix / (2 * np.pi * sigma**2))


def _map(size: int, generator: Generator, covered: float = 0.9) -> Floats:
    """Where camera pixels look on the projector: a shear, a scale and a step of depth."""
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 2, indexing="ij"), -1).astype(np.float32)
    shear = np.eye(2) * covered + generator.normal(0, 0.04, (2, 2))
    places = (grid - size / 2) @ shear.T + size / 2
    places[size // 3 :, size // 2 :, 1] += 0.06 * size
    return np.asarray(places.reshape(-1, 2), np.float32)


def _albedo(size: int, generator: Generator) -> Floats:
    texture = gaussian_filter(generator.normal(size=(size, size)), 1.5)
    return np.asarray(np.clip(0.6 + 0.3 * texture / texture.std(), 0.1, 1).ravel(), np.float32)


def _scaled(matrix: csr_array, factors: NDArray[np.floating]) -> csr_array:
    return csr_array(matrix * np.asarray(factors, np.float64)[:, None])


def _wall(size: int, generator: Generator) -> csr_array:
    return _footprints(_map(size, generator), size, 0.6, 2)


def _textured(size: int, generator: Generator) -> csr_array:
    return _scaled(_wall(size, generator), _albedo(size, generator))


def _broad(size: int, generator: Generator) -> csr_array:
    return _footprints(_map(size, generator), size, 3.0, 8)


def _translucent(size: int, generator: Generator) -> csr_array:
    places = _map(size, generator)
    return csr_array(
        0.5 * _footprints(places, size, 0.6, 2) + 0.5 * _footprints(places, size, 3.0, 8)
    )


def _diffuse(size: int, generator: Generator) -> csr_array:
    spread = _footprints(_map(size, generator), size, size / 5, size // 2)
    return csr_array(0.3 * _wall(size, generator) + 0.7 * spread)


def _permutation(size: int, generator: Generator) -> csr_array:
    order = generator.permutation(size * size)
    ones = np.ones(size * size)
    return csr_array((ones, (np.arange(size * size), order)), shape=(size * size,) * 2)


def _fibres(size: int, generator: Generator) -> csr_array:
    """Bundles of 4 x 4 pixels that are permuted."""
    numbers = np.arange(size * size).reshape(size // 4, 4, size // 4, 4).swapaxes(1, 2)
    moved = numbers.reshape(-1, 4, 4)[generator.permutation((size // 4) ** 2)]
    image = moved.reshape(size // 4, size // 4, 4, 4).swapaxes(1, 2).reshape(-1)
    ones = np.ones(size * size)
    return csr_array((ones, (np.arange(size * size), image)), shape=(size * size,) * 2)


def _speckle(size: int, generator: Generator) -> csr_array:
    count = size * size
    rows = np.repeat(np.arange(count), 6)
    light = generator.exponential(size=6 * count)
    return csr_array((light, (rows, generator.integers(0, count, 6 * count))), shape=(count, count))


def _glints(size: int, generator: Generator) -> csr_array:
    bright = np.ones(size * size)
    bright[generator.permutation(size * size)[:2]] = generator.uniform(30, 100, 2)
    return _scaled(_textured(size, generator), bright)


def _columns(size: int, generator: Generator) -> csr_array:
    """Each camera pixel sees a vertical line of the projector."""
    places = _map(size, generator)
    parts = []
    for down in range(-4, 5):
        moved = places + np.array([down, 0], np.float32)
        parts.append(_footprints(moved, size, 0.6, 2))
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return csr_array(total)


def _half_lit(size: int, generator: Generator) -> csr_array:
    return _footprints(_map(size, generator, 0.5), size, 0.6, 2)


def _own_pixels(size: int, generator: Generator) -> csr_array:
    """Each camera pixel sees one projector pixel: a fine camera before a coarse projector."""
    return _scaled(csr_array(np.eye(size * size)), _albedo(size, generator))


SCENES: dict[str, Callable[[int, Generator], csr_array]] = {
    "wall": _wall,
    "textured": _textured,
    "broad": _broad,
    "translucent": _translucent,
    "diffuse": _diffuse,
    "permutation": _permutation,
    "fibres": _fibres,
    "speckle": _speckle,
    "glints": _glints,
    "columns": _columns,
    "half lit": _half_lit,
}


def _bernoulli(count: int, size: int, generator: Generator) -> Floats:
    return generator.integers(0, 2, (count, size, size)).astype(np.float32)


def _with_inverses(size: int, generator: Generator) -> Floats:
    images = _bernoulli(24, size, generator)
    return np.stack([images, 1 - images], 1).reshape(-1, size, size)


def _of_any_density(count: int, size: int, generator: Generator) -> Floats:
    """Patterns whose shares of lit pixels vary."""
    shares = generator.uniform(0.2, 0.8, (count, 1, 1))
    return (generator.random((count, size, size)) < shares).astype(np.float32)


def _repeated(times: int) -> Callable[[int, Generator], Floats]:
    return lambda size, generator: np.repeat(_bernoulli(16, size, generator), times, axis=0)


def _mixed(size: int, generator: Generator) -> Floats:
    parts = []
    for block in (1, 2, 4, 8):
        cells = generator.integers(0, 2, (12, -(-size // block), -(-size // block)))
        parts.append(np.kron(cells, np.ones((block, block)))[:, :size, :size])
    return np.concatenate(parts).astype(np.float32)[generator.permutation(48)]


def _hadamard(size: int, generator: Generator) -> Floats:
    """64 rows of a Hadamard matrix of randomly ordered pixels."""
    rows = generator.permutation(size * size - 1)[:64] + 1
    pixels = generator.permutation(size * size)
    parity = np.array([[bin(int(r & p)).count("1") & 1 for p in pixels] for r in rows])
    return (1 - parity).reshape(-1, size, size).astype(np.float32)


def _tiled(size: int, generator: Generator) -> Floats:
    return np.tile(_bernoulli(48, size // 2, generator), (1, 2, 2))


def _mirrored(size: int, generator: Generator) -> Floats:
    half = generator.integers(0, 2, (48, size, size // 2)).astype(np.float32)
    return np.concatenate([half, half[:, :, ::-1]], axis=2)


def _grey(size: int, generator: Generator) -> Floats:
    images = gaussian_filter(generator.normal(size=(48, size, size)), (0, 1.5, 1.5))
    return np.asarray(np.clip(0.5 + 0.25 * images / images.std(), 0, 1), np.float32)


def _stripes(size: int, generator: Generator) -> Floats:
    """Gray codes of columns and rows with their inverses, after white and black."""
    code = np.arange(size) ^ (np.arange(size) >> 1)
    images = [np.ones((size, size)), np.zeros((size, size))]
    for bit in range(int(np.log2(size)))[::-1]:
        line = np.broadcast_to(((code >> bit) & 1)[None, :], (size, size))
        images += [line, 1 - line, line.T, 1 - line.T]
    return np.stack(images).astype(np.float32)


def _one_pixel(size: int, generator: Generator) -> Floats:
    """One pixel at a time, of a projector that is all shown up to 16 x 16."""
    places = generator.permutation(size * size)[:256]
    images = np.zeros((len(places), size * size), np.float32)
    images[np.arange(len(places)), places] = 1
    return images.reshape(-1, size, size)


_RANDOM = {"random": 64, "few": 16, "some": 24, "many": 128}
PATTERNS: dict[str, Callable[[int, Generator], Floats]] = {
    **{name: partial(_bernoulli, _RANDOM[name]) for name in ("random", "few", "many")},
    "mixed": _mixed,
    "hadamard": _hadamard,
    "with inverses": _with_inverses,
    "shown twice": _repeated(2),
    "shown four times": _repeated(4),
    "tiled": _tiled,
    "mirrored": _mirrored,
    "grey": _grey,
    "stripes": _stripes,
    "one pixel": _one_pixel,
}
# Patterns and damages of `benchmarks.honesty --hidden` alone.
HIDDEN_PATTERNS: dict[str, Callable[[int, Generator], Floats]] = {
    "some": partial(_bernoulli, _RANDOM["some"]),
    "16 of any density": partial(_of_any_density, 16),
    "46 of any density": partial(_of_any_density, 46),
}


def _unchanged(light: Floats, white: Floats, generator: Generator) -> Floats:
    return light


def _curve(light: Floats, white: Floats, generator: Generator) -> Floats:
    return np.asarray(np.clip(light, 0, 1) ** (1 / 2.2), np.float32)


def _pedestal(light: Floats, white: Floats, generator: Generator) -> Floats:
    return np.asarray(light + 0.15, np.float32)


def _leak(light: Floats, white: Floats, generator: Generator) -> Floats:
    return np.asarray(0.7 * light + 0.3 * white, np.float32)


def _drift(light: Floats, white: Floats, generator: Generator) -> Floats:
    return np.asarray(light * np.linspace(1, 0.7, len(light))[:, None, None], np.float32)


def _motion(light: Floats, white: Floats, generator: Generator) -> Floats:
    """The scene moves by one pixel half way."""
    moved = light.copy()
    moved[len(light) // 2 :] = np.roll(moved[len(light) // 2 :], 1, axis=2)
    return moved


_DAMAGED_LIGHT: dict[str, Callable[[Floats, Floats, Generator], Floats]] = {
    "curve": _curve,
    "pedestal": _pedestal,
    "leak": _leak,
    "drift": _drift,
    "motion": _motion,
}


def _second_half(
    turn: Callable[[NDArray[np.uint8]], NDArray[np.uint8]],
) -> Callable[[NDArray[np.uint8], Generator], NDArray[np.uint8]]:
    def damaged(frames: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
        half = len(frames) // 2
        return np.concatenate([frames[:half], turn(frames[half:])])

    return damaged


def _by_name(frames: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    return frames[sorted(range(len(frames)), key=lambda k: str(k + 1))]


def _late_rows(frames: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    late = frames.copy()
    late[1:, 1::2] = frames[:-1, 1::2]
    return late


def _torn(frames: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    late = frames.copy()
    half = frames.shape[1] // 2
    late[1:, half:] = frames[:-1, half:]
    return late


def _jpeg(frames: NDArray[np.uint8], generator: Generator) -> NDArray[np.uint8]:
    def through(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        coded = encode_image(image, "jpeg", quality=60)
        return np.asarray(decode_image(coded), np.uint8)

    return np.stack([through(image) for image in frames])


DAMAGED_FRAMES: dict[str, Callable[[NDArray[np.uint8], Generator], NDArray[np.uint8]]] = {
    "negative": lambda frames, _: np.asarray(255 - frames, np.uint8),
    "random order": lambda frames, generator: frames[generator.permutation(len(frames))],
    "by name": _by_name,
    "one later": lambda frames, _: np.roll(frames, 1, axis=0),
    "half turned": _second_half(lambda images: images[:, ::-1, ::-1]),
    "half mirrored": _second_half(lambda images: images[:, :, ::-1]),
    "half turned by 90": _second_half(lambda images: np.rot90(images, axes=(1, 2))),
    "rows late": _late_rows,
    "torn": _torn,
    "jpeg": _jpeg,
}
# Raw levels at which cameras clip without saying so.
CLIPPING = {"clips at 250": 250, "clips at 128": 128}
DAMAGES = ("overexposed", "other seed", "patterns inverted", *_DAMAGED_LIGHT, *DAMAGED_FRAMES)
# Captures whose frames belong to other patterns, or to other rows of T, than they seem to.
MISREAD = (
    "other seed", "patterns inverted", "negative", "random order", "by name", "half turned",
    "half mirrored", "half turned by 90", "rows late",
)  # fmt: skip
