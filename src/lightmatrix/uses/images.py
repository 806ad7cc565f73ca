"""What a compensation is given: the wanted picture, the mask and the ambient light, checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightmatrix.errors import InputError
from lightmatrix.files.images import read_image, read_light, write_image
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.writing import check_output
from lightmatrix.ranges import check_number

# Patterns that a use has found, written as images.


def write_shown(
    output: str | Path, patterns: Sequence[NDArray[np.float32]], *, overwrite: bool = False
) -> list[Path]:
    """Write patterns as images: one, three in colour, or several with numbers."""
    path = Path(output)
    if len(patterns) == 3 and len({pattern.shape for pattern in patterns}) == 1:
        images = {path: np.stack(patterns, axis=-1)}
    elif len(patterns) == 1:
        images = {path: patterns[0]}
    else:
        names = [path.with_name(f"{path.stem}-{k}{path.suffix}") for k, _ in enumerate(patterns, 1)]
        images = dict(zip(names, patterns, strict=True))
    for place in images:
        check_output(place, IMAGE, overwrite=overwrite)
    for place, image in images.items():
        write_image(place, image, overwrite=overwrite)
    return list(images)


Picture = NDArray[Any] | str | Path


def wanted_samples(
    wanted: Picture,
    camera_shape: tuple[int, ...],
    *,
    gamma: float = 1.0,
    resize: bool = False,
    black: bool = False,
) -> NDArray[np.float32]:
    """The wanted light of each camera sample, (M,) in [0, 1].

    A grey picture asks all channels of a colour camera for the same. `black` allows one that is all
    black.
    """
    check_number("a gamma", gamma, least=0.1, most=10, hint="use 0.1 to 10, such as 2.2")
    name = str(wanted) if isinstance(wanted, str | Path) else "the wanted picture"
    image = read_light(wanted) if isinstance(wanted, str | Path) else np.asarray(wanted)
    if image.dtype.kind not in "bfiu":
        raise InputError(f"{name} has {image.dtype} values", hint="give values in [0, 1]")
    # Written so that it refuses NaN, too.
    if image.size and not (image.min() >= 0 and image.max() <= 1):
        raise InputError(
            f"{name} has values from {image.min():g} to {image.max():g}",
            hint="give values in [0, 1]: divide raw levels by their largest one, such as 255",
        )
    light = image.astype(np.float32) ** np.float32(gamma)
    if light.ndim == 3 and len(camera_shape) == 2 and (light == light[..., :1]).all():
        light = light[..., 0]
    if light.ndim == 3 and len(camera_shape) == 2:
        raise InputError(
            f"{name} is in colour, for a camera that is not",
            hint="convert it to grey, or take its mean over the colours",
        )
    if resize and light.ndim >= 2 and light.shape[:2] != camera_shape[:2]:
        light = _resized(light, camera_shape[:2])
    samples = camera_samples(light, camera_shape, name, "resize it with --resize, or resize=True")
    if not (black or samples.any()):
        raise InputError(f"{name} is all black", hint="black needs no compensation: show black")
    return samples


def camera_samples(
    image: NDArray[Any], camera_shape: tuple[int, ...], name: str, hint: str
) -> NDArray[np.float32]:
    """An image as one value for each camera sample, (M,); grey counts for all channels."""
    if image.shape == camera_shape:
        values = image
    elif len(camera_shape) == 3 and image.shape == camera_shape[:2]:
        values = np.broadcast_to(image[..., None], camera_shape)
    else:
        raise InputError(
            f"{name} has shape {image.shape}, for a camera of {' x '.join(map(str, camera_shape))}",
            hint=hint,
        )
    return np.ascontiguousarray(values, np.float32).ravel()


def mask_samples(mask: Picture | None, camera_shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which camera samples count, (M,): those where the mask is not 0."""
    if mask is None:
        return np.ones(int(np.prod(camera_shape)), np.bool_)
    name = str(mask) if isinstance(mask, str | Path) else "the mask"
    image: NDArray[Any] = read_image(mask) if isinstance(mask, str | Path) else np.asarray(mask)
    if image.ndim == 3 and len(camera_shape) == 2:
        image = image.max(axis=2)
    hint = "give one value for each camera pixel, 0 where the picture does not matter"
    samples = camera_samples(image, camera_shape, name, hint)
    if not np.isfinite(samples).all():
        raise InputError(f"{name} has values that are not finite", hint="use 0 and 1")
    chosen = samples != 0
    if not chosen.any():
        raise InputError(f"{name} leaves no camera pixel", hint="it must be above 0 somewhere")
    return chosen


def ambient_samples(ambient: Picture | None, camera_shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Light that is there without the projector, (M,) >= 0, in units of the clip level."""
    if ambient is None:
        return np.zeros(int(np.prod(camera_shape)), np.float32)
    name = str(ambient) if isinstance(ambient, str | Path) else "the ambient light"
    image = read_light(ambient) if isinstance(ambient, str | Path) else np.asarray(ambient)
    if image.ndim == 3 and len(camera_shape) == 2:
        image = image.mean(axis=2)
    samples = camera_samples(image, camera_shape, name, "give a photograph of the same camera")
    if not (np.isfinite(samples).all() and samples.min() >= 0):
        raise InputError(
            f"{name} has values from {np.min(samples):g} to {np.max(samples):g}",
            hint="give light of at least 0, in units of the camera's clip level",
        )
    return samples


def _resized(light: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An image of another size, averaged where it shrinks, which keeps its light."""
    size = (shape[1], shape[0])
    channels = light[..., None] if light.ndim == 2 else light
    done = [
        np.asarray(Image.fromarray(channels[..., c]).resize(size, Image.Resampling.BOX))
        for c in range(channels.shape[2])
    ]
    return np.stack(done, axis=-1).reshape(*shape, *light.shape[2:]).clip(0, 1)
