"""Relighting from files to files, as `lightmatrix relight` does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightmatrix import store
from lightmatrix.errors import InputError
from lightmatrix.files.images import read_grey, read_light, write_image
from lightmatrix.files.json_files import errors_naming
from lightmatrix.outputs.kinds import IMAGE
from lightmatrix.outputs.writing import check_output
from lightmatrix.patterns.grids import block_mean
from lightmatrix.ranges import check_number
from lightmatrix.transport.matrix import LightTransport

Relit = LightTransport | store.StoredTransport


def relight(
    transport: Relit | str | Path | Sequence[Relit | str | Path],
    pattern: NDArray[Any] | str | Path,
    *,
    exposure: float = 1.0,
    gamma: float = 1.0,
    resize: bool = False,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> NDArray[np.float32]:
    """The camera image under a pattern that need not have been projected: c = e T p.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path, or three of them
        T, or where `open` finds it; of a colour projector those of its red, green and blue, whose
        light adds up. Of a store no more than a part is in memory at a time.
    pattern : (rows, cols) array, str or Path
        Of the projector's size, in [0, 1]; or an image, whose largest value is 1. For a colour
        projector (rows, cols, 3), or grey as white light. If the projector was binned for T, it may
        have the size before, and is averaged likewise.
    exposure : float
        Exposure e of the image, > 0.
    gamma : float
        Display gamma of a PNG, 0.1 to 10; 1 keeps it linear.
    resize : bool
        Whether a pattern of any other size is resized to the projector.
    output : str or Path, optional
        An image to write as well: .png (8 bits, cut off at full scale), .tiff, .exr or .npy (all
        values).
    overwrite : bool
        Whether an existing image may be replaced.

    Returns
    -------
    camera_shape float32
        Linear, not clipped; 1 is the clip level.

    Raises
    ------
    InputError
        On a pattern of another size, unless it is resized, numbers out of range, and matrices of
        different cameras or projectors, or of a number other than one and three.
    OutputError
        If the image cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> image = lm.relight(known, np.ones((64, 64)), exposure=0.2, gamma=2.2, output="white.png")
    >>> lm.read_image("white.png").shape
    (64, 64)
    """
    hint = "use a number above 0, such as 1"
    check_number("an exposure", exposure, most=1e9, above=True, hint=hint)
    check_number("a gamma", gamma, least=0.1, most=10, hint="use 0.1 to 10, such as 2.2")
    if output is not None:
        target = check_output(output, IMAGE, overwrite=overwrite)
        if gamma != 1 and target.suffix.lower() != ".png":
            raise InputError(
                f"a gamma of {gamma:g} for {target}, which keeps linear values",
                hint="write a .png, or leave the gamma out",
            )
    single = isinstance(transport, LightTransport | store.StoredTransport | str | Path)
    given: list[Any] = [transport] if single else [*transport]  # type: ignore[misc]
    found = _of_one_rig([_opened(one) for one in given])
    image = np.zeros(found[0].camera_shape, np.float32)
    for one, name, part in zip(found, given, _parts(pattern, len(found)), strict=True):
        # A store that was damaged may be what does not fit.
        named = errors_naming(Path(name)) if isinstance(name, str | Path) else nullcontext()
        with named:
            light = _fitted(part, one, resize)
        image += exposure * one.relight(light)
    if output is not None:
        written = image
        if target.suffix.lower() == ".png":
            written = np.clip(image, 0, 1) ** (1 / gamma)
        write_image(output, written.astype(np.float32), overwrite=overwrite)
    return image


def _of_one_rig(found: list[Relit]) -> list[Relit]:
    """The matrices of a projector, one or three, which belong together."""
    if len(found) not in (1, 3):
        raise InputError(f"{len(found)} matrices", hint="give one, or those of red, green and blue")
    for one in found[1:]:
        for what in ("camera_shape", "projector_shape"):
            if getattr(one, what) != getattr(found[0], what):
                raise InputError(
                    f"matrices of {what} {getattr(found[0], what)} and {getattr(one, what)}",
                    hint="red, green and blue must be of one rig, binned alike",
                )
    return found


def _parts(pattern: NDArray[Any] | str | Path, count: int) -> list[NDArray[Any]]:
    """What each of the projector's primaries shows."""
    if count == 1:
        return [read_grey(pattern) if isinstance(pattern, str | Path) else np.asarray(pattern)]
    shown = read_light(pattern) if isinstance(pattern, str | Path) else np.asarray(pattern)
    if shown.ndim == 2:
        return [shown] * count
    if shown.ndim != 3 or shown.shape[2] != count:
        raise InputError(
            f"a pattern of shape {shown.shape} for a colour projector",
            hint="give (rows, cols, 3), or (rows, cols) for white light",
        )
    return list(np.moveaxis(shown, 2, 0))


def _opened(transport: Relit | str | Path) -> Relit:
    """A matrix as it is; a store is left on disk and read block by block."""
    if isinstance(transport, LightTransport | store.StoredTransport):
        return transport
    if Path(transport).suffix.lower() == ".npz":
        return store.open(transport)
    return store.StoredTransport.open(transport)


def _fitted(pattern: NDArray[Any], transport: Relit, resize: bool) -> NDArray[Any]:
    """A pattern in the size of the projector of T, where it can be known or is asked for."""
    wanted = transport.projector_shape
    if pattern.ndim != 2 or pattern.shape == wanted:
        return pattern
    described = transport.provenance.get("capture_description")
    block = described.get("bin_projector") if isinstance(described, Mapping) else None
    if block and tuple(-(-n // b) for n, b in zip(pattern.shape, block, strict=True)) == wanted:
        rows, cols = (int(b) for b in block)
        return block_mean(pattern[None].astype(np.float64), (rows, cols))[0]
    if not resize:
        raise InputError(
            f"a pattern of shape {pattern.shape} for a projector of {wanted[0]} x {wanted[1]}",
            hint="resize it; --resize, or resize=True, does",
        )
    # Means over pixels where it shrinks, so that light is kept; bilinear where it grows.
    shrinks = pattern.shape[0] >= wanted[0] and pattern.shape[1] >= wanted[1]
    how = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    drawn = Image.fromarray(pattern.astype(np.float32))
    return np.asarray(drawn.resize((wanted[1], wanted[0]), how)).clip(0, 1)
