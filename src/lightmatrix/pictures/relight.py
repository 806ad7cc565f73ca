"""`lm.relight`: camera images under new patterns, from and to files."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files import images as image_files
from lightmatrix.files.colours import colour_paths, holds_colour
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.reading import errors_naming
from lightmatrix.files.writing import check_output
from lightmatrix.paths import as_path
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.ranges import check_number, check_type
from lightmatrix.transport import store
from lightmatrix.transport.matrix import ColourTransport, LightTransport
from lightmatrix.transport.operator import HOW_TO_GIVE

Relit = LightTransport | store.StoredTransport


def relight(
    transport: Relit | ColourTransport | str | Path | Sequence[Relit | str | Path],
    pattern: NDArray[Any] | str | Path,
    *,
    exposure: float = 1.0,
    gamma: float | None = None,
    resize: bool = False,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> NDArray[np.float32]:
    """The camera image under a new pattern: c = e T p.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path, or three of them; or ColourTransport
        T, or where `open` finds it. For a colour projector, the matrices of red, green and blue,
        whose light is added, or the folder of their stores. A store is read block by block, so it
        need not fit into memory.
    pattern : (rows, cols) array, str or Path
        Pattern of the projector's size, in [0, 1], or an image file. A colour projector takes
        (rows, cols, 3), or a grey pattern as white light. If the projector was binned for T, the
        pattern may have the size before binning, and is averaged.
    exposure : float
        Exposure e of the image, > 0.
    gamma : float, optional
        Display gamma of a PNG, 0.1 to 10; 1 keeps it linear. None: 2.2, as in all other pictures.
        Files of other formats are always linear.
    resize : bool
        Whether to resize a pattern of any other size to the projector.
    output : str or Path, optional
        Image file to write: .png (8 bits, clipped at full scale), .tiff, .exr or .npy (all values).
    overwrite : bool
        Whether an existing image may be replaced.

    Returns
    -------
    camera_shape float32
        Linear image, not clipped; 1 is the clip level.

    Raises
    ------
    InputError
        On a pattern of another size that may not be resized, numbers out of range, matrices of
        different rigs, and a number of matrices other than one and three.
    OutputError
        If the image cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> image = lm.relight(known, np.ones((64, 64)), exposure=0.2, output="white.png")
    >>> lm.read_image("white.png").shape
    (64, 64)
    """
    hint = "use a number above 0, such as 1"
    check_number("an exposure", exposure, most=1e9, above=True, hint=hint)
    shown = image_files.DISPLAY_GAMMA if gamma is None else gamma
    check_number("a gamma", shown, least=0.1, most=10, hint="use 0.1 to 10, such as 2.2")
    check_output(output, IMAGE, overwrite=overwrite)
    as_png = output is not None and as_path(output).suffix.lower() == ".png"
    if output is not None and gamma not in (None, 1) and not as_png:
        hint = "write a .png, or leave out the gamma"
        raise InputError(f"a gamma of {gamma:g} for {output}, which holds linear values", hint=hint)
    if isinstance(transport, str | Path) and holds_colour(transport):
        transport = colour_paths(transport)
    several = isinstance(transport, Sequence | ColourTransport) and not isinstance(transport, str)
    sources: list[Any] = [*transport] if several else [transport]  # type: ignore[misc]
    matrices = [_opened(source) for source in sources]
    if len(matrices) not in (1, 3):
        hint = "give one, or those of red, green and blue"
        raise InputError(f"{len(matrices)} matrices", hint=hint)
    for name in ("camera_shape", "projector_shape"):
        first, *others = (getattr(matrix, name) for matrix in matrices)
        for shape in others:
            if shape != first:
                hint = "give red, green and blue of one rig with the same binning"
                raise InputError(f"matrices of {name} {first} and {shape}", hint=hint)
    image = np.zeros(matrices[0].camera_shape, np.float32)
    channels = _channels(pattern, len(matrices))
    for matrix, source, channel in zip(matrices, sources, channels, strict=True):
        # Errors name the store, because its damage may be the reason why the pattern does not fit.
        with errors_naming(Path(source)) if isinstance(source, str | Path) else nullcontext():
            light = _fitted(channel, matrix, resize, pattern)
        with np.errstate(over="ignore", invalid="ignore"):
            image += exposure * matrix.relight(light)
    if not np.isfinite(image).all():
        raise InputError(
            f"an image at exposure {exposure:g} that single precision cannot hold",
            hint="use a lower exposure, such as 1",
        )
    if output is not None:
        written = np.clip(image, 0, 1) ** (1 / shown) if as_png else image
        image_files.write_image(output, written.astype(np.float32), overwrite=overwrite)
    return image


def _channels(pattern: NDArray[Any] | str | Path, count: int) -> list[NDArray[Any]]:
    """The pattern of each of the projector's primaries."""
    if count == 1:
        return [image_files.given_image("a pattern", pattern, image_files.read_grey)]
    image = image_files.given_image("a pattern", pattern, image_files.read_light)
    if image.ndim == 2:
        return [image] * count
    if image.ndim != 3 or image.shape[2] != count:
        hint = "give (rows, cols, 3), or (rows, cols) for white light"
        raise InputError(f"a pattern of shape {image.shape} for a colour projector", hint=hint)
    return list(np.moveaxis(image, 2, 0))


def _opened(transport: Relit | str | Path) -> Relit:
    """A matrix unchanged, or a store that is read block by block."""
    if isinstance(transport, LightTransport | store.StoredTransport):
        return transport
    check_type("a light transport matrix", transport, str, Path, hint=HOW_TO_GIVE)
    if Path(transport).suffix.lower() == ".npz":
        return store.open(transport)
    return store.StoredTransport.open(transport)


def _fitted(pattern: NDArray[Any], transport: Relit, resize: bool, source: Any) -> NDArray[Any]:
    """A pattern averaged as the projector was binned, or resized if that is allowed."""
    wanted = transport.projector_shape
    if pattern.ndim != 2:
        raise InputError(f"a pattern of shape {pattern.shape}", hint="give (rows, cols)")
    if pattern.shape == wanted:
        return pattern
    description = transport.provenance.get("capture_description")
    block = description.get("bin_projector") if isinstance(description, Mapping) else None
    if block and tuple(-(-n // b) for n, b in zip(pattern.shape, block, strict=True)) == wanted:
        rows, cols = (int(b) for b in block)
        return block_mean(pattern[None].astype(np.float64), (rows, cols))[0]
    if not resize:
        name = f"{source}: " if isinstance(source, str | Path) else ""
        what = f"{name}a pattern of shape {pattern.shape} for a projector of"
        raise InputError(f"{what} {wanted[0]} x {wanted[1]}", hint="resize it (resize=True)")
    return image_files.fitted(pattern.astype(np.float32), wanted, "stretch")
