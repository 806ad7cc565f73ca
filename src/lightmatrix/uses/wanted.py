"""Pictures that are wanted, masks and ambient light, as one value for each camera sample."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, warn
from lightmatrix.files import images as image_files
from lightmatrix.files.extras import upright
from lightmatrix.ranges import check_number

WantedPicture = NDArray[Any] | str | Path


def wanted_samples(
    wanted: WantedPicture,
    camera_shape: tuple[int, ...],
    *,
    gamma: float | None = None,
    fit: str | None = None,
    black: bool = False,
    levels: bool = False,
) -> NDArray[np.float32]:
    """The wanted light of each camera sample, (M,) in [0, 1].

    A grey picture asks all channels of a colour camera for the same, and of one in colour the
    luminance counts for a grey camera. `black` allows one that is all black, `levels` says that an
    array holds whole levels, as files do.
    """
    if gamma is not None:
        check_number("a gamma", gamma, least=0.1, most=10, hint="use 0.1 to 10, such as 2.2")
    if fit not in (None, "cover", "contain", "stretch"):
        raise InputError(f"a fit of {fit!r}", hint="use cover, contain or stretch")
    name = str(wanted) if isinstance(wanted, str | Path) else "the wanted picture"
    # Turned as viewers show it.
    image = image_files.given_image(
        name, wanted, lambda path: upright(path, image_files.read_image(path))
    )
    if fit is None and image.shape[:2] != camera_shape[:2]:
        # Shapes are refused before values, which a view may have without end.
        _samples(image, camera_shape, name, _FIT)
    if image.ndim == 3 and len(camera_shape) == 2 and image_files.is_grey(image):
        image = image[..., 0]
    if (levels or isinstance(wanted, str | Path)) and image.dtype != np.float32:
        # Files of whole levels hold pictures for displays, files of floats hold light.
        white = np.iinfo(image.dtype).max
        curve = np.linspace(0, 1, white + 1) ** (
            image_files.DISPLAY_GAMMA if gamma is None else gamma
        )
        light = curve.astype(np.float32).take(image)
    # Written so that it refuses NaN, too.
    elif image.size and not (image.min() >= 0 and image.max() <= 1):
        hint = "give values in [0, 1]: divide raw levels by their largest one, such as 255"
        raise InputError(f"{name} has values from {image.min():g} to {image.max():g}", hint=hint)
    else:
        light = image.astype(np.float32) ** np.float32(1.0 if gamma is None else gamma)
    if light.ndim == 3 and len(camera_shape) == 2:
        warn(f"{name} is in colour, for a camera that is not: its luminance is taken")
        # The weights of linear red, green and blue (ITU-R BT.709).
        light = light @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    if fit is not None and light.ndim >= 2 and light.shape[:2] != camera_shape[:2]:
        light = image_files.fitted(light, (camera_shape[0], camera_shape[1]), fit)
    samples = _samples(light, camera_shape, name, _FIT)
    if not (black or samples.any()):
        raise InputError(f"{name} is all black", hint="black needs no compensation: show black")
    return samples


_FIT = 'fit it with fit="cover", "contain" or "stretch"'


def _samples(
    image: NDArray[Any], shape: tuple[int, ...], name: str, hint: str, device: str = "camera"
) -> NDArray[np.float32]:
    """An image as one value for each sample of a device, (M,); grey counts for all channels."""
    if image.shape == shape:
        values = image
    elif len(shape) == 3 and image.shape == shape[:2]:
        values = np.broadcast_to(image[..., None], shape)
    else:
        size = " x ".join(map(str, shape))
        raise InputError(f"{name} has shape {image.shape}, for a {device} of {size}", hint=hint)
    return np.ascontiguousarray(values, np.float32).ravel()


def mask_samples(
    mask: WantedPicture | None, shape: tuple[int, ...], device: str = "camera"
) -> NDArray[np.bool_]:
    """Which samples of a camera or a projector count, (M,): those where the mask is not 0."""
    if mask is None:
        return np.ones(int(np.prod(shape)), np.bool_)
    name = str(mask) if isinstance(mask, str | Path) else "the mask"
    image = image_files.given_image(name, mask, image_files.read_image)
    if image.ndim == 3 and len(shape) == 2:
        image = image.max(axis=2)
    hint = f"give one value for each pixel of the {device}, 0 for those that do not count"
    samples = _samples(image, shape, name, hint, device)
    if not np.isfinite(samples).all():
        raise InputError(f"{name} has values that are not finite", hint="use 0 and 1")
    chosen = samples != 0
    if not chosen.any():
        raise InputError(f"{name} leaves no {device} pixel", hint="it must be above 0 somewhere")
    return chosen


def ambient_samples(
    ambient: WantedPicture | None, camera_shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Light that is there without the projector, (M,) >= 0, in units of the clip level."""
    if ambient is None:
        return np.zeros(int(np.prod(camera_shape)), np.float32)
    name = str(ambient) if isinstance(ambient, str | Path) else "the ambient light"
    image = image_files.given_image(name, ambient, image_files.read_light)
    if image.ndim == 3 and len(camera_shape) == 2:
        image = image.mean(axis=2)
    samples = _samples(image, camera_shape, name, "give a photograph of the same camera")
    if not (np.isfinite(samples).all() and samples.min() >= 0):
        raise InputError(
            f"{name} has values from {np.min(samples):g} to {np.max(samples):g}",
            hint="give light of at least 0, in units of the camera's clip level",
        )
    return samples
