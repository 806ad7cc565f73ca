"""`separate`: the direct and the global part of T."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.images import read_grey, write_image
from lightmatrix.files.kinds import SEPARATION
from lightmatrix.files.writing import atomic_folder, check_output
from lightmatrix.reprs import short_repr
from lightmatrix.transport import store as store
from lightmatrix.transport.correspondence import pixel_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import checked_patterns
from lightmatrix.uses.direct_light import (
    DirectSpots,
    camera_pixels,
    direct_entries,
    find_direct_spots,
    spot_radius,
)
from lightmatrix.uses.epipolar import EpipolarGeometry
from lightmatrix.uses.loading import Transport, loaded
from lightmatrix.uses.spots import entries_of, find_spots, spot_deviation

# Light within this distance of the epipolar line counts as epipolar, in projector pixels and in
# standard deviations of a spot: a line that is one pixel wide, and its blur.
_LINE = (1.0, 2.0)
_GAMMA = 2.2
# Memory that a separation takes, relative to the matrix. A megapixel camera with 29 entries a row
# and 64 values of background took 4.1 (python -m benchmarks.uses_at_scale).
_TIMES_ITS_SIZE = 4.1
# A spot that covers more than this share of the projector is not one. Chosen by hand.
_LARGEST_SPOT = 0.25


@dataclass(frozen=True, eq=False)
class Separation:
    """T = direct + global, both non-negative; the sum is exact.

    Parameters
    ----------
    direct : LightTransport
        Light that met one surface on its way from the projector to the camera.
    global_ : LightTransport
        All other light: interreflections, scattering, the background.
    confidence : (rows, cols) float32
        Share of the 24 neighbours of a camera pixel that agree with it: that see direct light
        beside its own, or none where it has none. NaN where it is dark.
    parallax : (rows, cols) float32
        Where along its epipolar line a camera pixel sees direct light, relative to the scene's mean
        surface, in projector pixels; NaN where it sees none. It orders the scene by depth.
    geometry : EpipolarGeometry
        Where direct light can come from.
    spot : float
        Standard deviation of a spot of direct light in projector pixels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> parts = lm.separate(known)
    >>> both = parts.direct.sparse + parts.global_.sparse
    >>> abs(both - known.sparse).max()
    np.float32(0.0)
    """

    direct: LightTransport
    global_: LightTransport
    confidence: NDArray[np.float32]
    parallax: NDArray[np.float32]
    geometry: EpipolarGeometry
    spot: float

    __repr__ = short_repr

    def relight(self, patterns: NDArray[Any], *, global_scale: float = 1.0) -> NDArray[np.float32]:
        """Camera images with the global light scaled: c = (direct + scale * global) p."""
        direct, others = self.direct.relight(patterns), self.global_.relight(patterns)
        return np.asarray(direct + np.float32(global_scale) * others)

    @cached_property
    def epipolar(self) -> LightTransport:
        """The part of T along the epipolar lines: direct light and little else."""
        return self._part(on_line=True)

    @cached_property
    def non_epipolar(self) -> LightTransport:
        """The part of T off the epipolar lines, which is global, with the whole background.

        O'Toole et al. 2012 and 2014 photograph these parts with special hardware.
        """
        return self._part(on_line=False)

    def _part(self, *, on_line: bool) -> LightTransport:
        matrix = csr_array(self.direct.sparse + self.global_.sparse)
        shape = self.direct.camera_shape
        owner, *pixel = entries_of(matrix, self.direct.projector_shape[1])
        channels = int(np.prod(shape[2:]))
        camera = camera_pixels((shape[0], shape[1]))[owner // channels]
        distance = np.abs(self.geometry.distance(camera, np.stack(pixel, axis=1)))
        near = distance <= _LINE[0] + _LINE[1] * self.spot
        rows = _with_data(matrix, np.where(near == on_line, matrix.data, 0))
        background = self.global_.background
        return replace(
            self.global_,
            sparse=rows,
            background=np.zeros_like(background) if on_line else background,
        )


def separate(
    transport: Transport,
    *,
    pattern: NDArray[Any] | str | Path | None = None,
    epipolar: bool = False,
    non_epipolar: bool = False,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Separation:
    """Split T into direct and global light: T = direct + global.

    A camera pixel on a depth edge sees direct light from two places, so up to three spots of each
    row of T are candidates. A spot is direct if it lies on the pixel's epipolar line, within the
    parallax of the scene, and where enough of its neighbours see direct light too. The global light
    beneath its footprint is estimated from a ring around it.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it. It must have no negative entries. A store is loaded.
    pattern : (rows, cols) array, str or Path, optional
        The pattern of the written images, in [0, 1], or an image file; without it, white.
    epipolar, non_epipolar : bool
        Whether the folder also holds the part of T along the epipolar lines, or the part off them.
        `Separation` has both in any case.
    output : str or Path, optional
        Folder to make: direct.zarr and global.zarr; the images direct and global under the pattern,
        as .png for a look (gamma 2.2, one scale for all) and .npy for use; confidence.npy and
        parallax.npy. Where asked for, epipolar and non-epipolar likewise.
    overwrite : bool
        Whether an existing separation may be replaced.

    Returns
    -------
    Separation
        Both parts, the confidence of each pixel, the epipolar geometry and the parallax.

    Raises
    ------
    InputError
        If T has negative entries, or too little direct light that its epipolar geometry could be
        found; on a pattern that does not fit; if there is not enough memory for a store.
    OutputError
        If the folder exists or cannot be written.

    Notes
    -----
    The lines of the epipolar geometry are parallel, or meet in a point where that fits clearly more
    camera pixels: under strong perspective or keystone.

    References
    ----------
    Nayar et al. 2006 separate the image under white light; O'Toole et al. 2012 the epipolar part.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> parts = lm.separate(lm.truth("l_objects").transport(), output="separated")
    >>> white = np.ones(parts.direct.projector_shape)
    >>> bool(parts.direct.relight(white).sum() > parts.global_.relight(white).sum())
    True
    """
    if output is not None:
        check_output(output, SEPARATION, overwrite=overwrite)
    matrix = loaded(transport, _TIMES_ITS_SIZE)
    lit = pattern_or_white(pattern, matrix.projector_shape)
    _check_positive(matrix)
    shape = (matrix.camera_shape[0], matrix.camera_shape[1])
    rows, background = pixel_rows(matrix)
    width = matrix.projector_shape[1]
    deviation = spot_deviation(matrix, rows)
    _check_concentrated(deviation, matrix.shape[1])
    spots = find_spots(rows, background, width, spot_radius(deviation))
    found = find_direct_spots(spots, shape, deviation)
    channels = int(np.prod(matrix.camera_shape[2:]))
    light = direct_entries(matrix.sparse, found, shape, width, channels)
    direct, others = _parts(matrix, light)
    separation = Separation(
        direct,
        others,
        _confidence(found, shape),
        _parallax(found, shape),
        found.geometry,
        deviation,
    )
    if output is not None:
        chosen = {"direct": separation.direct, "global": separation.global_}
        if epipolar:
            chosen["epipolar"] = separation.epipolar
        if non_epipolar:
            chosen["non-epipolar"] = separation.non_epipolar
        _write(separation, chosen, lit, output, overwrite)
    return separation


def pattern_or_white(
    pattern: NDArray[Any] | str | Path | None, projector_shape: tuple[int, int]
) -> NDArray[np.float32]:
    """A pattern from an image or an array as light, (rows, cols) float32; white by default."""
    if pattern is None:
        return np.ones(projector_shape, np.float32)
    values = read_grey(pattern) if isinstance(pattern, str | Path) else np.asarray(pattern)
    if values.ndim != 2:
        raise InputError(f"a pattern of shape {values.shape}", hint="give (rows, cols)")
    return checked_patterns(values, projector_shape)


def _check_positive(transport: LightTransport) -> None:
    for part in (transport.sparse.data, transport.background):
        if part.size and part.min() < 0:
            raise InputError(
                "T has negative entries, which are neither direct nor global light",
                hint="estimate it without --signed",
            )


def _check_concentrated(deviation: float, pixels: int) -> None:
    area = np.pi * spot_radius(deviation) ** 2
    if area > _LARGEST_SPOT * pixels:
        raise InputError(
            f"the light of a usual row of T is spread over {area:.0f} of {pixels} projector pixels",
            hint="it needs direct light: surfaces that the projector lights and the camera sees",
        )


def _parts(
    transport: LightTransport, light: NDArray[np.float32]
) -> tuple[LightTransport, LightTransport]:
    """Both parts. One of the two differences is exact (Sterbenz), hence so is their sum."""
    matrix = transport.sparse
    others = matrix.data - light
    direct = matrix.data - others
    return (
        replace(
            transport,
            sparse=_with_data(matrix, direct),
            background=np.zeros_like(transport.background),
        ),
        replace(transport, sparse=_with_data(matrix, others)),
    )


def _with_data(matrix: csr_array, data: NDArray[np.floating]) -> csr_array:
    """A matrix with other values at the same places, without those that are 0."""
    result = csr_array((data.copy(), matrix.indices.copy(), matrix.indptr.copy()), matrix.shape)
    result.eliminate_zeros()
    return result


def _confidence(found: DirectSpots, shape: tuple[int, int]) -> NDArray[np.float32]:
    """The share of a pixel's neighbours that agree with how its light was classified."""
    has_direct = found.direct.any(axis=1)
    of_direct = np.where(found.direct, found.agreement, 0).max(axis=1)
    value = np.where(has_direct, of_direct, 1 - found.agreement[:, 0])
    return np.where(found.lit, value, np.nan).astype(np.float32).reshape(shape)


def _parallax(found: DirectSpots, shape: tuple[int, int]) -> NDArray[np.float32]:
    """The parallax of the strongest direct spot of each pixel."""
    first = found.direct.argmax(axis=1)
    place = found.spots.place[np.arange(len(first)), first]
    value = found.geometry.parallax(camera_pixels(shape), place)
    return np.where(found.direct.any(axis=1), value, np.nan).astype(np.float32).reshape(shape)


def _write(
    separation: Separation,
    chosen: Mapping[str, LightTransport],
    pattern: NDArray[np.float32],
    output: str | Path,
    overwrite: bool,
) -> None:
    """Write the chosen parts of T, their images under the pattern, and the maps."""
    images = {name: part.relight(pattern) for name, part in chosen.items()}
    white = max(float((images["direct"] + images["global"]).max()), 1e-9)
    with atomic_folder(output, SEPARATION, overwrite=overwrite) as folder:
        for name, part in chosen.items():
            store.save(folder / f"{name}.zarr", part)
        for name, image in images.items():
            np.save(folder / f"{name}.npy", image)
            write_image(folder / f"{name}.png", (image / white) ** (1 / _GAMMA))
        np.save(folder / "confidence.npy", separation.confidence)
        np.save(folder / "parallax.npy", separation.parallax)
