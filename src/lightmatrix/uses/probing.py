"""`probe` keeps chosen paths of light; `max_min` is a quick look that needs no T."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, sparray

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import grid_cells
from lightmatrix.ranges import check_type
from lightmatrix.reprs import short_repr
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import HOW_TO_GIVE


def probe(transport: LightTransport, mask: sparray) -> LightTransport:
    """Keep the light that travels between chosen pairs of projector and camera pixels.

    A probed photograph is c = (T * mask) p, entry by entry (O'Toole et al. 2012, Eq. 2): a mask of
    pairs that lie on each other's epipolar lines shows direct light, one of pairs near each other
    short-range scattering, its complement long-range light.

    Parameters
    ----------
    transport : LightTransport
        T.
    mask : (M, N) sparse array
        Weight of each pair of a camera sample and a projector pixel, finite; pairs without an entry
        are not kept.

    Returns
    -------
    LightTransport
        T * mask, with the background of the kept pairs among its entries.

    Raises
    ------
    InputError
        If the mask has another shape or weights that are not finite.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> import scipy.sparse
    >>> known = lm.truth("metal").transport()
    >>> near = scipy.sparse.eye_array(*known.shape)
    >>> lm.probe(known, near).relight(np.ones((64, 64))).shape
    (64, 64)
    """
    check_type("a light transport matrix", transport, LightTransport, hint=HOW_TO_GIVE)
    if getattr(mask, "shape", None) != transport.shape:
        hint = f"give a sparse array of {transport.shape}: camera samples, projector pixels"
        raise InputError(f"a probing mask of shape {getattr(mask, 'shape', 'none')}", hint=hint)
    kept = csr_array(mask, dtype=np.float32)
    if not np.isfinite(kept.data).all():
        raise InputError("a probing mask with weights that are not finite", hint="use 0 to 1")
    cell = grid_cells(transport.projector_shape, transport.background_grid)
    size = np.bincount(cell)
    row = np.repeat(np.arange(transport.shape[0]), np.diff(kept.indptr))
    own = cell[kept.indices]
    diffuse = kept.data * transport.background[row, own] / size[own]
    spread = csr_array((diffuse, kept.indices, kept.indptr), kept.shape)
    matrix = csr_array(transport.sparse.multiply(kept) + spread, dtype=np.float32)
    return replace(transport, sparse=matrix, background=np.zeros_like(transport.background))


@dataclass(frozen=True, eq=False)
class QuickLook:
    """Direct and global light under white, guessed from a capture's own frames.

    Parameters
    ----------
    direct, global_ : camera_shape float32
        Images in camera full scale at exposure 1.
    """

    direct: NDArray[np.float32]
    global_: NDArray[np.float32]

    __repr__ = short_repr


def max_min(capture: Capture) -> QuickLook:
    """Guess direct and global light under white from a capture's own frames, without T.

    The brightest frame of a pixel has its direct light and half of its global light, the darkest
    frame only the latter, if the patterns are finer than the global light (Nayar et al. 2006,
    Eq. 5 and 6, with the patterns' own mean in place of a half). Patterns that are blurred, and
    frames that clip, leave direct light out.

    Parameters
    ----------
    capture : Capture
        Frames under patterns that switch each projector pixel on and off, such as Bernoulli's.

    Returns
    -------
    QuickLook
        Both images.

    Raises
    ------
    InputError
        If all patterns are dark.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> parts = lm.max_min(lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32)))
    >>> bool(parts.direct.mean() > parts.global_.mean())
    True
    """
    check_type("a capture", capture, Capture, hint="give what lm.Capture.open returned")
    pixels = int(np.prod(capture.projector_shape))
    lit = capture.patterns.forward(np.ones((1, pixels), np.float32))
    share = float(np.mean(lit)) / pixels
    if share <= 0:
        raise InputError("patterns that are all dark", hint="project patterns with light")
    extremes = [(t.values.max(axis=1), t.values.min(axis=1)) for _, t in capture.tiles()]
    high, low = map(np.concatenate, zip(*extremes, strict=True))
    images = (np.maximum(each, 0).astype(np.float32) for each in (high - low, low / share))
    return QuickLook(*(each.reshape(capture.camera_shape) for each in images))
