"""`separate`: the direct and the global part of T.

The light of a row of T concentrates in spots on the projector. Epipolar geometry and the spots of
neighbouring camera pixels tell which of them are direct light.
"""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import pictures
from lightmatrix.errors import InputError
from lightmatrix.files.images import given_image, read_grey
from lightmatrix.files.kinds import SEPARATION
from lightmatrix.files.reading import errors_naming
from lightmatrix.files.writing import atomic_folder, check_output
from lightmatrix.geometry.matches import ROBUST, fit_fundamental
from lightmatrix.reprs import ShortRepr
from lightmatrix.transport import store
from lightmatrix.transport.correspondence import pixel_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import checked_patterns
from lightmatrix.transport.sparse_rows import footprint_sizes, row_blocks
from lightmatrix.uses.loading import Transport, loaded

Floats = NDArray[np.float64]

# The epipolar geometry of a projector and a camera, from where camera pixels see their light.


@dataclass(frozen=True, eq=False, repr=False)
class EpipolarGeometry(ShortRepr):
    """Where direct light can come from: on the line F (camera row, col, 1) of the projector.

    Lines are parallel (the affine epipolar geometry, Koenderink & van Doorn 1991) unless the data
    ask for a perspective one. Long lenses and shallow scenes do with the affine one, which a
    fundamental matrix in general would fit less stably.

    Parameters
    ----------
    fundamental : (3, 3) float64
        F; direct light fulfils (projector row, col, 1) F (camera row, col, 1)' = 0.
    spread : float
        Standard deviation of the distances of good rows to their lines, in projector pixels.
    surface : (6, 2) float64
        The projector pixel of the scene's mean surface as a polynomial of second degree of the
        camera pixel: coefficients of 1, row, col, row^2, row col, col^2.
    parallax_range : (float, float)
        Where along the line good rows lie, relative to the mean surface, in projector pixels.
    """

    fundamental: Floats
    spread: float
    surface: Floats
    parallax_range: tuple[float, float]

    def distance(self, camera: Floats, projector: Floats) -> Floats:
        """Signed distances of projector pixels (n, 2) to the lines of camera pixels (n, 2)."""
        line = self._lines(camera)
        row, col = projector.T
        return np.asarray(line[:, 0] * row + line[:, 1] * col + line[:, 2])

    def parallax(self, camera: Floats, projector: Floats) -> Floats:
        """Places of projector pixels (n, 2) along the line, relative to the mean surface."""
        away, line = projector - _monomials(camera) @ self.surface, self._lines(camera)
        # The direction of a line is its normal, turned by 90 degrees.
        return np.asarray((away * np.stack([-line[:, 1], line[:, 0]], axis=1)).sum(axis=1))

    def _lines(self, camera: Floats) -> Floats:
        """Epipolar lines (n, 3) with normals of length 1."""
        line = np.column_stack([camera, np.ones(len(camera))]) @ self.fundamental.T
        return np.asarray(line / np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)[:, None])


def mean_surface(camera: Floats, projector: Floats) -> Floats:
    """The polynomial (6, 2) from camera to projector, by reweighted least squares (Cauchy).

    Its second degree follows keystone, whose exact map, a homography, is less stable where the
    scene is not flat.
    """
    design = _monomials(camera)
    # Columns of one size, so that squares do not dominate.
    size = np.abs(design).max(axis=0).clip(1)
    weight = np.ones(len(camera))
    surface: Floats = np.zeros((6, 2))
    for _ in range(ROBUST.rounds):
        root = np.sqrt(weight)[:, None]
        scaled = np.linalg.lstsq(design / size * root, projector * root, rcond=None)[0]
        surface = np.asarray(scaled / size[:, None])
        error = ((projector - design @ surface) ** 2).sum(axis=1)
        weight = 1 / (1 + error / max(float(np.median(error)), ROBUST.least_spread_of_spots**2))
    return surface


def fit_epipolar(camera: Floats, projector: Floats, surface: Floats) -> EpipolarGeometry:
    """Fit parallel lines to matches (n, 2) each, n >= 4, or lines that meet where those miss."""

    def fitted(fundamental: Floats) -> tuple[EpipolarGeometry, float]:
        """The geometry of lines, and the share of matches that lie close to them."""
        made = EpipolarGeometry(fundamental, 0.0, surface, (0.0, 0.0))
        distance = made.distance(camera, projector)
        share = float((np.abs(distance) < ROBUST.support).mean())
        # The standard deviation of normal distances is 1.48 times the median of their magnitudes.
        spread = max(1.48 * float(np.median(np.abs(distance))), ROBUST.least_spread_of_spots)
        return replace(made, spread=spread), share

    geometry, share = fitted(fit_fundamental(camera, projector, parallel=True))
    # A fundamental matrix has 7 unknowns, so that fewer matches hardly support it.
    if len(camera) >= 64:
        meeting, more = fitted(fit_fundamental(camera, projector))
        # Typical distances tell less than shares: a plane, to which most rows may belong, fits many
        # geometries. On scenes without perspective, rendered or of the experiment `uses`, the
        # shares differ by at most 0.001.
        if more - share > 0.02:
            geometry = meeting
    on_line = np.abs(geometry.distance(camera, projector)) <= max(
        ROBUST.support, 2 * geometry.spread
    )
    if not on_line.any():
        return geometry
    place = geometry.parallax(camera[on_line], projector[on_line])
    # A few stray rows at either end do not count.
    low, high = np.quantile(place, (0.002, 0.998))
    return replace(geometry, parallax_range=(float(low), float(high)))


def _monomials(points: Floats) -> Floats:
    """The terms (n, 6) whose product with a polynomial, such as the mean surface, is its value."""
    row, col = points.T
    return np.stack([np.ones_like(row), row, col, row**2, row * col, col**2], axis=1)


# Spots that are searched in each row. A pixel on a depth edge sees two surfaces; the third place is
# for global light that outshines one of them.
SPOTS = 3


@dataclass(frozen=True)
class _Tuning:
    """Thresholds, chosen on the scenes of benchmarks/separation_scenes.py.

    Distances are in projector pixels. A pair is a constant, and a part that grows with the standard
    deviation of a spot.
    """

    # A row fainter than this share of a bright row's light lies in the projector's shadow.
    dark: float = 0.02
    # The geometry is fitted to rows whose strongest spot holds this share of their light, and half
    # of whose neighbours see light beside it; and to so many rows at least.
    strong: float = 0.3
    fewest: int = 16
    # A neighbour agrees if its spot lies this close to where the mean surface puts it.
    agreement: tuple[float, float] = (1.3, 1.0)
    # Spots farther from the epipolar line, or beyond the parallax of good rows by more, are global.
    from_line: tuple[float, float] = (0.6, 0.5)
    beyond_parallax: tuple[float, float] = (1.0, 0.5)
    # A spot is global if fewer of its 24 neighbours agree, or if it holds less of the row's light;
    # the strongest one, and the others.
    least_agreement: tuple[float, float] = (0.1, 0.05)
    least_share: tuple[float, float] = (0.05, 0.02)
    # Rounds in which spots that were rejected lose their vote on their neighbours.
    votes: int = 3
    # A neighbour's spot continues one within this distance, whose place may move by two pixels from
    # one camera pixel to the next, if it holds this share of its light or more.
    crossing: tuple[float, float] = (2.0, 1.0)
    continues: float = 0.5
    # A spot is global if another surface outshines it at its place, unless it lies within this
    # share of the allowed distance from the line, or this share of its neighbours agrees.
    doubtful: float = 0.4
    certain: float = 0.9
    # Two spots share a place on the projector if they lie this close to each other. They belong to
    # two surfaces if their parallax differs by as much.
    same_place: float = 1.0
    # The footprint: entries this close to a direct spot, and this close to the epipolar line. A
    # sharp camera pixel between projector pixels sees 2 x 2 of them, up to 1.4 pixels away.
    footprint: tuple[float, float] = (0.6, 2.8)
    band: tuple[float, float] = (1.0, 2.0)
    # The ring around the footprint shows the global light beneath it, which is brighter there by
    # this factor: it peaks where surfaces touch.
    ring_width: float = 1.5
    ring_factor: float = 2.0


_TUNING = _Tuning()

# Which spots of neighbouring camera pixels lie near each other on the projector.

Places = tuple[slice, slice, slice]
# One neighbour of all camera pixels that have it: these pixels and their neighbours, in images
# (SPOTS, rows, cols), and which spot here lies near which spot there, (SPOTS, SPOTS, ..., ...).
NearSpots = tuple[Places, Places, NDArray[np.bool_]]


def near_spots(
    place: Floats, shape: tuple[int, int], *, reach: int, radius: float
) -> Iterator[NearSpots]:
    """For each neighbour up to `reach` pixels away, the spots within `radius` of each other.

    `place` (P, SPOTS, 2) are rows and columns on the projector, NaN where there is no spot.
    """
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    row, col = _as_images(place[..., 0], shape), _as_images(place[..., 1], shape)
    steps = range(-reach, reach + 1)
    for down, right in ((d, r) for d in steps for r in steps if d or r):
        here = slice(None), shifted(shape[0], -down), shifted(shape[1], -right)
        there = slice(None), shifted(shape[0], down), shifted(shape[1], right)
        # In place, as these are the largest arrays of a separation.
        squared = (row[there] - row[here][:, None]) ** 2
        squared += (col[there] - col[here][:, None]) ** 2
        # Comparisons with NaN are False.
        yield here, there, squared <= radius**2


def _as_images(values: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Values (P, SPOTS) of spots as images (SPOTS, rows, cols)."""
    return np.ascontiguousarray(values.T).reshape(-1, *shape)


def by_pixel(images: NDArray[Any]) -> NDArray[Any]:
    """Images (SPOTS, rows, cols) as values (P, SPOTS)."""
    return np.ascontiguousarray(images.reshape(len(images), -1).T)


def shifted(size: int, by: int) -> slice:
    """The part of an axis that still lies inside once it is moved back by so many pixels."""
    return slice(max(0, by), size - max(0, -by))


# The spots of each row of T: the few places on the projector where its light concentrates.


@dataclass(frozen=True, eq=False)
class Spots:
    """Spots of P camera pixels, up to n each, the strongest first.

    `place` (P, n, 2) is the centre of each spot as row and column of the projector, NaN where there
    is none; `light` (P, n) what it holds; `total` (P,) is the light of the whole row, background
    included.
    """

    place: Floats
    light: Floats
    total: Floats


def camera_pixels(shape: tuple[int, int]) -> Floats:
    """Row and column of each camera pixel, (P, 2)."""
    return np.indices(shape, np.float64).reshape(2, -1).T


def entries_of(matrix: csr_array, width: int) -> tuple[NDArray[np.int64], Floats, Floats]:
    """The row number of each entry; row and column of its projector pixel."""
    owner = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    row, col = np.divmod(matrix.indices, np.int32(width))
    return owner, row.astype(np.float64), col.astype(np.float64)


def blocks_of(matrix: csr_array) -> list[slice]:
    """Blocks of rows, such that temporary arrays for all entries of one stay below 1 GB."""
    cuts = row_blocks(matrix.indptr, 1 << 22).tolist()
    return [slice(start, stop) for start, stop in pairwise(cuts)]


def spot_deviation(transport: LightTransport, matrix: csr_array) -> float:
    """Standard deviation of a usual spot in projector pixels, from the median footprint.

    A Gaussian spot of standard deviation s has a footprint of 4 pi s^2 projector pixels.
    """
    sizes = np.asarray(transport.diagnostics.get("footprint", np.full(1, np.nan)), float)
    known = sizes[np.isfinite(sizes) & (sizes > 0)]
    if not known.size:
        peak = np.asarray(matrix.max(axis=1).toarray(), float).ravel()
        owner = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        # Fainter entries are mostly global light. Chosen by hand.
        bright = np.where(matrix.data >= 0.05 * peak[owner], matrix.data, 0)
        sizes = footprint_sizes(csr_array((bright, matrix.indices, matrix.indptr), matrix.shape))
        known = sizes[sizes > 0]
    return float(np.sqrt(np.median(known) / (4 * np.pi))) if known.size else 0.0


def _find_spots(matrix: csr_array, background: Floats, width: int, radius: float) -> Spots:
    """The strongest spots of each row; a spot is what lies within `radius` of its peak."""
    place = np.full((matrix.shape[0], SPOTS, 2), np.nan)
    light, total = np.zeros((matrix.shape[0], SPOTS)), np.zeros(matrix.shape[0])
    for rows in blocks_of(matrix):
        part = csr_array(matrix[rows])
        count = int(part.shape[0])
        # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
        owner, row, col = entries_of(part, width)
        left = part.data.astype(np.float64)
        total[rows] = np.bincount(owner, left, count)
        for number in range(SPOTS):
            peak = np.zeros(count)
            np.maximum.at(peak, owner, left)
            strongest = np.full(count, -1, np.int64)
            at_peak = np.flatnonzero((left == peak[owner]) & (left > 0))
            # In reverse order, so that the first of several equal entries stays.
            strongest[owner[at_peak[::-1]]] = at_peak[::-1]
            valid = strongest >= 0
            if not valid.any():
                break
            middle_row, middle_col = (np.where(valid, ax[strongest], np.inf) for ax in (row, col))
            down, right = row - middle_row[owner], col - middle_col[owner]
            near = np.flatnonzero(down * down + right * right <= radius**2)
            own, held = owner[near], left[near]
            light[rows, number] = held_by = np.bincount(own, held, count)
            for axis, (middle, away) in enumerate(((middle_row, down), (middle_col, right))):
                shift = np.bincount(own, held * away[near], count)
                place[rows, number, axis][valid] = middle[valid] + shift[valid] / held_by[valid]
            left[near] = 0
    return Spots(place, light, total + background)


# Which spots and entries of T are direct light, by epipolar geometry and by neighbours.


def crossing_spots(
    relative: Floats,
    light: Floats,
    on_line: NDArray[np.bool_],
    shape: tuple[int, int],
    radius: float,
) -> NDArray[np.bool_]:
    """Spots that sweep across the epipolar line from pixel to pixel, (P, SPOTS).

    Direct light stays on the line. A mirror image moves across it, so that the spots of neighbours
    that continue it lie off their lines. Places (P, SPOTS, 2) are `relative` to the mean surface;
    a neighbour's spot continues a spot within `radius` of it, with enough of its light. Of the 8
    neighbours, more than one, and more than half of those that continue it, lie off their lines.
    """
    strength, near_line = _as_images(light, shape), _as_images(on_line, shape)
    on, off = np.zeros((2, *strength.shape), np.int8)
    for here, there, near in near_spots(relative, shape, reach=1, radius=radius):
        continues = near & (strength[there] >= _TUNING.continues * strength[here][:, None])
        on[here] += (continues & near_line[there]).any(axis=1)
        off[here] += (continues & ~near_line[there]).any(axis=1)
    return by_pixel(off > np.maximum(on, 1))


def outshone_spots(
    place: Floats, parallax: Floats, light: Floats, doubtful: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Doubtful spots whose projector pixel lights another surface more brightly, (n,).

    A projector pixel lights one surface, and direct light comes from there. `place` (n, 2),
    `parallax` (n,) and `light` (n,) are those of all spots that may be direct.
    """
    outshone = np.zeros(len(light), bool)
    asked = np.flatnonzero(doubtful)
    if not asked.size:
        return outshone
    found = scipy.spatial.cKDTree(place).query_ball_point(place[asked], _TUNING.same_place)
    counts = np.array([len(near) for near in found])
    near = np.concatenate(found).astype(np.int64)
    own = np.repeat(np.arange(len(asked)), counts)
    other = np.abs(parallax[near] - parallax[asked][own]) >= _TUNING.same_place
    rivals, held = (np.bincount(own, light[near] * part, len(asked)) for part in (other, ~other))
    outshone[asked] = rivals > held
    return outshone


@dataclass(frozen=True, eq=False)
class _DirectSpots:
    """Which spots are direct light: `direct` (P, SPOTS), and the `agreement` of neighbours."""

    spots: Spots
    direct: NDArray[np.bool_]
    agreement: Floats
    lit: NDArray[np.bool_]
    geometry: EpipolarGeometry
    deviation: float


def _find_direct_spots(spots: Spots, shape: tuple[int, int], deviation: float) -> _DirectSpots:
    """Fit the epipolar geometry to the camera's spots, and reject those that are global light."""
    camera = camera_pixels(shape)
    place, light, total = spots.place, spots.light, spots.total
    lit = (total > _TUNING.dark * float(np.quantile(total, 0.9))) & (light[:, 0] > 0)
    strong = lit & (light[:, 0] > _TUNING.strong * total)
    _check_direct_light(strong)
    surface = mean_surface(camera[strong], place[strong, 0])
    # Relative to the mean surface, neighbours on one surface see their light at one place.
    relative = place - (_monomials(camera) @ surface)[:, None]
    radius = _scaled(_TUNING.agreement, deviation)
    pairs = list(near_spots(relative, shape, reach=2, radius=radius))
    first = np.zeros(light.shape, bool)
    first[:, 0] = True
    good = strong & (_agreement(pairs, first, shape)[:, 0] > 0.5)
    _check_direct_light(good)
    geometry = fit_epipolar(camera[good], place[good, 0], surface)
    each = range(SPOTS)
    distance = np.stack([geometry.distance(camera, place[:, k]) for k in each], axis=1)
    parallax = np.stack([geometry.parallax(camera, place[:, k]) for k in each], axis=1)
    from_line = _scaled(_TUNING.from_line, deviation)
    near_line = np.abs(distance) <= from_line
    low, high = geometry.parallax_range
    beyond = _scaled(_TUNING.beyond_parallax, deviation)
    # Comparisons with NaN, where there is no spot, are False.
    possible = near_line & lit[:, None] & (parallax >= low - beyond) & (parallax <= high + beyond)
    possible &= light > _TUNING.least_share[1] * total[:, None]
    possible[:, 0] &= light[:, 0] >= _TUNING.least_share[0] * total
    reach = _scaled(_TUNING.crossing, deviation)
    possible &= ~crossing_spots(relative, light, near_line, shape, reach)
    direct, agreement = _voted(possible, pairs, shape)
    doubtful = np.abs(distance) > _TUNING.doubtful * from_line
    doubtful &= agreement < _TUNING.certain
    stray = outshone_spots(place[direct], parallax[direct], light[direct], doubtful[direct])
    possible[direct] &= ~stray
    direct, agreement = _voted(possible, pairs, shape)
    return _DirectSpots(spots, direct, agreement, lit, geometry, deviation)


def _direct_entries(
    matrix: csr_array, found: _DirectSpots, shape: tuple[int, int], width: int, channels: int
) -> NDArray[np.float32]:
    """The direct part of each entry of T, (nnz,); `channels` rows belong to each camera pixel."""
    camera = camera_pixels(shape)
    direct = np.zeros(matrix.nnz, np.float32)
    radius = _scaled(_TUNING.footprint, found.deviation)
    outer = radius + _TUNING.ring_width
    for rows in blocks_of(matrix):
        part = csr_array(matrix[rows])
        owner, row, col = entries_of(part, width)
        pixels = np.arange(rows.start, rows.stop) // channels
        own = pixels[owner]
        light = part.data.astype(np.float64)
        inside, around = np.zeros(len(own), bool), np.zeros(len(own), bool)
        for number in range(SPOTS):
            lit = np.flatnonzero(found.direct[:, number][own])
            place_row, place_col = (found.spots.place[:, number, ax][own[lit]] for ax in (0, 1))
            distance = np.sqrt((row[lit] - place_row) ** 2 + (col[lit] - place_col) ** 2)
            inside[lit] |= distance <= radius
            around[lit] |= distance <= outer
        chosen = np.flatnonzero(inside)
        pixel = np.stack([row[chosen], col[chosen]], axis=1)
        off_line = np.abs(found.geometry.distance(camera[own[chosen]], pixel))
        inside[chosen] = off_line <= _scaled(_TUNING.band, found.deviation)
        ring = np.bincount(owner, np.where(around & ~inside, light, 0), part.shape[0])
        area = np.pi * (outer**2 - radius**2)
        area_of_row = area * np.maximum(found.direct[pixels].sum(axis=1), 1)
        # Entries within a footprint are direct, less the global light that the ring shows.
        beneath = _TUNING.ring_factor * ring / area_of_row
        ends = slice(int(matrix.indptr[rows.start]), int(matrix.indptr[rows.stop]))
        direct[ends] = np.where(inside, np.maximum(light - beneath[owner], 0), 0)
    return direct


def _voted(
    possible: NDArray[np.bool_], pairs: Sequence[NearSpots], shape: tuple[int, int]
) -> tuple[NDArray[np.bool_], Floats]:
    """Possible spots that enough neighbours agree with, and the agreement, (P, SPOTS) each."""
    least = np.full(possible.shape[1], _TUNING.least_agreement[1])
    least[0] = _TUNING.least_agreement[0]
    direct = possible
    for _ in range(_TUNING.votes):
        agreement = _agreement(pairs, direct, shape)
        direct = possible & (agreement >= least)
    return direct, agreement


def _agreement(
    pairs: Sequence[NearSpots], voters: NDArray[np.bool_], shape: tuple[int, int]
) -> Floats:
    """The share of each spot's neighbours with a voting spot where the mean surface puts it."""
    votes = _as_images(voters, shape)
    agreeing, number_of = np.zeros(votes.shape, np.uint8), np.zeros(shape, np.uint8)
    for here, there, near in pairs:
        agreeing[here] += (near & votes[there]).any(axis=1)
        number_of[here[1:]] += 1
    return by_pixel(agreeing / np.maximum(number_of, 1))


def _scaled(threshold: tuple[float, float], deviation: float) -> float:
    """A distance for spots of this standard deviation."""
    return threshold[0] + threshold[1] * deviation


_NEEDS_DIRECT_LIGHT = (
    "it needs direct light: surfaces that the projector lights and the camera sees"
)


def _check_direct_light(good: NDArray[np.bool_]) -> None:
    if good.sum() < _TUNING.fewest:
        raise InputError(
            f"{int(good.sum())} of {len(good)} camera pixels see a spot of light that their "
            "neighbours agree on",
            hint=_NEEDS_DIRECT_LIGHT,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Separation(ShortRepr):
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
    """

    direct: LightTransport
    global_: LightTransport
    confidence: NDArray[np.float32]
    parallax: NDArray[np.float32]
    geometry: EpipolarGeometry
    spot: float

    def show(self) -> "pictures.style.Picture":
        """A Matplotlib figure of direct and global light under white; notebooks show it."""
        white = np.ones(self.direct.projector_shape, np.float32)
        return pictures.transport.draw_parts(
            {"direct": self.direct.relight(white), "global": self.global_.relight(white)}
        )

    def _repr_png_(self) -> bytes:
        return self.show()._repr_png_()

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
        # A line that is one pixel wide, and its blur.
        near = distance <= 1 + 2 * self.spot
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
        Folder to make: direct.zarr and global.zarr; their images under the pattern, direct.npy and
        global.npy, and both in separation.png for a look; confidence.npy and parallax.npy. Where
        asked for, epipolar and non-epipolar likewise.
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
    check_output(output, SEPARATION, overwrite=overwrite)
    # A megapixel camera with 29 entries a row and 64 values of background took 4.1 times the memory
    # of its matrix (python -m benchmarks.uses_at_scale).
    matrix = loaded(transport, 4.1)
    lit = pattern_or_white(pattern, matrix.projector_shape)
    sparse, background = matrix.sparse, matrix.background
    if any(part.size and part.min() < 0 for part in (sparse.data, background)):
        raise InputError(
            "T has negative entries, which are neither direct nor global light",
            hint="estimate it without signed=True",
        )
    shape = (matrix.camera_shape[0], matrix.camera_shape[1])
    rows, light_behind = pixel_rows(matrix)
    width = matrix.projector_shape[1]
    deviation = spot_deviation(matrix, rows)
    # How far the light of a spot reaches from its peak. One that covers a quarter of the projector
    # is none; chosen by hand.
    radius = 1 + 2 * deviation
    if np.pi * radius**2 > 0.25 * matrix.shape[1]:
        raise InputError(
            f"the light of a usual row of T is spread over {np.pi * radius**2:.0f} of "
            f"{matrix.shape[1]} projector pixels",
            hint=_NEEDS_DIRECT_LIGHT,
        )
    found = _find_direct_spots(_find_spots(rows, light_behind, width, radius), shape, deviation)
    channels = int(np.prod(matrix.camera_shape[2:]))
    # One of the two differences is exact (Sterbenz), hence so is their sum.
    others = sparse.data - _direct_entries(sparse, found, shape, width, channels)
    direct = replace(
        matrix,
        sparse=_with_data(sparse, sparse.data - others),
        background=np.zeros_like(background),
    )
    has_direct = np.asarray(found.direct.any(axis=1))
    # The share of a pixel's neighbours that agree with how its light was classified.
    of_direct = np.where(found.direct, found.agreement, 0).max(axis=1)
    confidence = np.where(has_direct, of_direct, 1 - found.agreement[:, 0])
    # The parallax of the strongest direct spot.
    place = found.spots.place[np.arange(len(has_direct)), found.direct.argmax(axis=1)]
    parallax = found.geometry.parallax(camera_pixels(shape), place)
    separation = Separation(
        direct,
        replace(matrix, sparse=_with_data(sparse, others)),
        np.where(found.lit, confidence, np.nan).astype(np.float32).reshape(shape),
        np.where(has_direct, parallax, np.nan).astype(np.float32).reshape(shape),
        found.geometry,
        deviation,
    )
    if output is None:
        return separation
    chosen = {"direct": separation.direct, "global": separation.global_}
    if epipolar:
        chosen["epipolar"] = separation.epipolar
    if non_epipolar:
        chosen["non-epipolar"] = separation.non_epipolar
    images = {name: part.relight(lit) for name, part in chosen.items()}
    with atomic_folder(output, SEPARATION, overwrite=overwrite) as folder:
        for name, part in chosen.items():
            store.save(folder / f"{name}.zarr", part)
        for name, image in images.items():
            np.save(folder / f"{name}.npy", image)
        pictures.transport.draw_parts(images).draw_file(folder / "separation.png")
        np.save(folder / "confidence.npy", separation.confidence)
        np.save(folder / "parallax.npy", separation.parallax)
    return separation


def pattern_or_white(
    pattern: NDArray[Any] | str | Path | None, projector_shape: tuple[int, int]
) -> NDArray[np.float32]:
    """A pattern from an image or an array as light, (rows, cols) float32; white by default."""
    if pattern is None:
        return np.ones(projector_shape, np.float32)
    values = given_image("a pattern", pattern, read_grey)
    if values.ndim != 2:
        raise InputError(f"a pattern of shape {values.shape}", hint="give (rows, cols)")
    with errors_naming(Path(pattern)) if isinstance(pattern, str | Path) else nullcontext():
        return checked_patterns(values, projector_shape)


def _with_data(matrix: csr_array, data: NDArray[np.floating]) -> csr_array:
    """A matrix with other values at the same places, without those that are 0."""
    result = csr_array((data.copy(), matrix.indices.copy(), matrix.indptr.copy()), matrix.shape)
    result.eliminate_zeros()
    return result
