"""Which spots and entries of T are direct light, by epipolar geometry and by neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from lightmatrix.errors import InputError
from lightmatrix.transport.sparse_rows import row_blocks
from lightmatrix.uses.epipolar import EpipolarGeometry, fit_epipolar, mean_surface, on_surface
from lightmatrix.uses.spots import (
    ENTRIES,
    NearSpots,
    Spots,
    as_images,
    by_pixel,
    entries_of,
    near_spots,
)

# Spots of global light that lie on the epipolar line by chance, such as mirror images.


# All thresholds of this file were chosen on the scenes of benchmarks/separation_scenes.py.
# Distances are in projector pixels.
#
# A neighbour's spot continues a spot if it holds this share of its light or more.
_CONTINUES = 0.5
# Two spots share a place on the projector if they lie this close to each other. They belong to two
# surfaces if their parallax differs by as much.
_SAME_PLACE = 1.0


def crossing_spots(
    relative: NDArray[np.float64],
    light: NDArray[np.float64],
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
    strength, near_line = as_images(light, shape), as_images(on_line, shape)
    on, off = np.zeros((2, *strength.shape), np.int8)
    for here, there, near in near_spots(relative, shape, reach=1, radius=radius):
        continues = near & (strength[there] >= _CONTINUES * strength[here][:, None])
        on[here] += (continues & near_line[there]).any(axis=1)
        off[here] += (continues & ~near_line[there]).any(axis=1)
    return by_pixel(off > np.maximum(on, 1))


def outshone_spots(
    place: NDArray[np.float64],
    parallax: NDArray[np.float64],
    light: NDArray[np.float64],
    doubtful: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Doubtful spots whose projector pixel lights another surface more brightly, (n,).

    A projector pixel lights one surface, and direct light comes from there. `place` (n, 2),
    `parallax` (n,) and `light` (n,) are those of all spots that may be direct.
    """
    outshone = np.zeros(len(light), bool)
    asked = np.flatnonzero(doubtful)
    if not asked.size:
        return outshone
    found = cKDTree(place).query_ball_point(place[asked], _SAME_PLACE)
    counts = np.array([len(near) for near in found])
    near = np.concatenate(found).astype(np.int64)
    own = np.repeat(np.arange(len(asked)), counts)
    other = np.abs(parallax[near] - parallax[asked][own]) >= _SAME_PLACE
    rivals, held = (np.bincount(own, light[near] * part, len(asked)) for part in (other, ~other))
    outshone[asked] = rivals > held
    return outshone


# All thresholds of this file were chosen on the scenes of benchmarks/separation_scenes.py, which
# `python -m experiments uses` does not hold. Distances are in projector pixels: a constant, and a
# part that grows with the standard deviation of a spot.
#
# A row fainter than this share of a bright row's light (the 0.9 quantile) is left without direct
# light: it lies in the projector's shadow.
_DARK, _BRIGHT_QUANTILE = 0.02, 0.9
# Rows that the geometry is fitted to: their strongest spot holds this share of the light, and half
# of their neighbours see light beside it.
_STRONG, _HALF = 0.3, 0.5
# A neighbour agrees if its spot lies this close to where the mean surface puts it.
_AGREEMENT = (1.3, 1.0)
# Spots farther from the epipolar line, or beyond the parallax of good rows by more, are global.
_FROM_LINE, _BEYOND_PARALLAX = (0.6, 0.5), (1.0, 0.5)
# A spot is global if fewer of its 24 neighbours agree; the strongest one, and the others.
_LEAST_AGREEMENT, _LEAST_AGREEMENT_OF_WEAK = 0.1, 0.05
# A spot is global if it holds less of the row's light; the strongest one, and the others.
_LEAST_SHARE, _LEAST_SHARE_OF_WEAK = 0.05, 0.02
# Rounds in which spots that were rejected lose their vote on their neighbours.
_VOTES = 3
# A neighbour's spot continues one within this distance, whose place may move by two pixels from
# one camera pixel to the next.
_CROSSING = (2.0, 1.0)
# A spot is global if another surface outshines it at its place, unless it lies within this share of
# the allowed distance from the line, or this share of its neighbours agrees.
_DOUBTFUL, _CERTAIN = 0.4, 0.9
# Half width of the square of neighbours.
_NEIGHBOURS = 2
# The footprint: entries this close to a direct spot, and this close to the epipolar line. A sharp
# camera pixel between projector pixels sees 2 x 2 of them, up to 1.4 pixels from the middle.
_FOOTPRINT, _BAND = (0.6, 2.8), (1.0, 2.0)
# The ring around the footprint that shows the global light beneath it, and how much brighter global
# light is beneath the footprint than in the ring: it peaks where surfaces touch.
_RING_WIDTH, _RING_FACTOR = 1.5, 2.0
# The fewest rows that can tell an epipolar geometry.
_FEWEST = 16


@dataclass(frozen=True, eq=False)
class DirectSpots:
    """Which spots are direct light: `direct` (P, SPOTS), and the `agreement` of neighbours."""

    spots: Spots
    direct: NDArray[np.bool_]
    agreement: NDArray[np.float64]
    lit: NDArray[np.bool_]
    geometry: EpipolarGeometry
    deviation: float


def camera_pixels(shape: tuple[int, int]) -> NDArray[np.float64]:
    """Row and column of each camera pixel, (P, 2)."""
    return np.indices(shape, np.float64).reshape(2, -1).T


def spot_radius(deviation: float) -> float:
    """How far the light of a spot reaches from its peak, in projector pixels."""
    return 1 + 2 * deviation


def find_direct_spots(spots: Spots, shape: tuple[int, int], deviation: float) -> DirectSpots:
    """Fit the epipolar geometry to the camera's spots, and reject those that are global light.

    Raises InputError if too few rows have a spot that their neighbours agree on.
    """
    camera = camera_pixels(shape)
    place, light, total = spots.place, spots.light, spots.total
    bright = float(np.quantile(total, _BRIGHT_QUANTILE))
    lit = (total > _DARK * bright) & (light[:, 0] > 0)
    strong = lit & (light[:, 0] > _STRONG * total)
    if strong.sum() < _FEWEST:
        raise _no_direct_light(int(strong.sum()), len(lit))
    surface = mean_surface(camera[strong], place[strong, 0])
    # Relative to the mean surface, neighbours on one surface see their light at one place.
    relative = place - on_surface(surface, camera)[:, None]
    reach, radius = _NEIGHBOURS, _scaled(_AGREEMENT, deviation)
    pairs = list(near_spots(relative, shape, reach=reach, radius=radius))
    first = np.zeros(light.shape, bool)
    first[:, 0] = True
    agreement = _agreement(pairs, first, shape)
    good = strong & (agreement[:, 0] > _HALF)
    if good.sum() < _FEWEST:
        raise _no_direct_light(int(good.sum()), len(lit))
    geometry = fit_epipolar(camera[good], place[good, 0], surface)
    distance, parallax = _along_lines(geometry, camera, place)
    near_line = np.abs(distance) <= _scaled(_FROM_LINE, deviation)
    possible = near_line & lit[:, None] & _within(geometry, parallax, deviation)
    possible &= light > _LEAST_SHARE_OF_WEAK * total[:, None]
    possible[:, 0] &= light[:, 0] >= _LEAST_SHARE * total
    possible &= ~crossing_spots(relative, light, near_line, shape, _scaled(_CROSSING, deviation))
    direct, agreement = _voted(possible, pairs, shape)
    doubtful = np.abs(distance) > _DOUBTFUL * _scaled(_FROM_LINE, deviation)
    doubtful &= agreement < _CERTAIN
    stray = outshone_spots(place[direct], parallax[direct], light[direct], doubtful[direct])
    possible[direct] &= ~stray
    direct, agreement = _voted(possible, pairs, shape)
    return DirectSpots(spots, direct, agreement, lit, geometry, deviation)


def direct_entries(
    matrix: csr_array, found: DirectSpots, shape: tuple[int, int], width: int, channels: int
) -> NDArray[np.float32]:
    """The direct part of each entry of T, (nnz,), in [0, entry].

    Entries within a footprint are direct, less the global light that the ring around it shows.
    `channels` rows of T belong to each camera pixel.
    """
    camera = camera_pixels(shape)
    direct = np.zeros(matrix.nnz, np.float32)
    cuts = row_blocks(matrix.indptr, ENTRIES)
    for start, stop in pairwise(cuts):
        part = csr_array(matrix[int(start) : int(stop)])
        pixels = np.arange(start, stop) // channels
        ends = slice(int(matrix.indptr[start]), int(matrix.indptr[stop]))
        direct[ends] = _direct_of_block(part, found, camera, pixels, width)
    return direct


def _direct_of_block(
    matrix: csr_array,
    found: DirectSpots,
    camera: NDArray[np.float64],
    pixels: NDArray[np.int64],
    width: int,
) -> NDArray[np.float64]:
    """The direct part of each entry of some rows, which belong to these camera pixels."""
    owner, row, col = entries_of(matrix, width)
    own = pixels[owner]
    light = matrix.data.astype(np.float64)
    radius = _scaled(_FOOTPRINT, found.deviation)
    inside, around = np.zeros(len(own), bool), np.zeros(len(own), bool)
    for number in range(found.direct.shape[1]):
        lit = np.flatnonzero(found.direct[:, number][own])
        place_row, place_col = (found.spots.place[:, number, axis][own[lit]] for axis in (0, 1))
        distance = np.sqrt((row[lit] - place_row) ** 2 + (col[lit] - place_col) ** 2)
        inside[lit] |= distance <= radius
        around[lit] |= distance <= radius + _RING_WIDTH
    chosen = np.flatnonzero(inside)
    pixel = np.stack([row[chosen], col[chosen]], axis=1)
    off_line = np.abs(found.geometry.distance(camera[own[chosen]], pixel))
    inside[chosen] = off_line <= _scaled(_BAND, found.deviation)
    around &= ~inside
    ring = np.bincount(owner, np.where(around, light, 0), matrix.shape[0])
    area = np.pi * ((radius + _RING_WIDTH) ** 2 - radius**2)
    area_of_row = area * np.maximum(found.direct[pixels].sum(axis=1), 1)
    beneath = _RING_FACTOR * ring / area_of_row
    return np.where(inside, np.maximum(light - beneath[owner], 0), 0)


def _voted(
    possible: NDArray[np.bool_], pairs: Sequence[NearSpots], shape: tuple[int, int]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Possible spots that enough neighbours agree with, and the agreement, (P, SPOTS) each."""
    least = np.full(possible.shape[1], _LEAST_AGREEMENT_OF_WEAK)
    least[0] = _LEAST_AGREEMENT
    direct = possible
    for _ in range(_VOTES):
        agreement = _agreement(pairs, direct, shape)
        direct = possible & (agreement >= least)
    return direct, agreement


def _along_lines(
    geometry: EpipolarGeometry, camera: NDArray[np.float64], place: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Each spot's signed distance to its epipolar line and its parallax, (P, SPOTS) each."""
    spots = range(place.shape[1])
    distance = [geometry.distance(camera, place[:, number]) for number in spots]
    parallax = [geometry.parallax(camera, place[:, number]) for number in spots]
    return np.stack(distance, axis=1), np.stack(parallax, axis=1)


def _within(
    geometry: EpipolarGeometry, parallax: NDArray[np.float64], deviation: float
) -> NDArray[np.bool_]:
    """Which spots lie within the parallax of good rows."""
    low, high = geometry.parallax_range
    beyond = _scaled(_BEYOND_PARALLAX, deviation)
    # Comparisons with NaN, where there is no spot, are False.
    return (parallax >= low - beyond) & (parallax <= high + beyond)


def _agreement(
    pairs: Sequence[NearSpots], voters: NDArray[np.bool_], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """The share of each spot's neighbours with a voting spot where the mean surface puts it."""
    votes = as_images(voters, shape)
    agreeing, number_of = np.zeros(votes.shape, np.uint8), np.zeros(shape, np.uint8)
    for here, there, near in pairs:
        agreeing[here] += (near & votes[there]).any(axis=1)
        number_of[here[1:]] += 1
    return by_pixel(agreeing / np.maximum(number_of, 1))


def _scaled(threshold: tuple[float, float], deviation: float) -> float:
    """A distance for spots of this standard deviation."""
    return threshold[0] + threshold[1] * deviation


def _no_direct_light(count: int, pixels: int) -> InputError:
    return InputError(
        f"{count} of {pixels} camera pixels see a spot of light that their neighbours agree on",
        hint="it needs direct light: surfaces that the projector lights and the camera sees",
    )
