"""What camera pixels see: spots on the projector, where each lies, and how probably it is right."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.geometry.rig_geometry import DIAMOND_ROWS, RigGeometry, staggered
from lightmatrix.ranges import check_number
from lightmatrix.resources.threads import work_ahead
from lightmatrix.transport.correspondence import Correspondence, pixel_rows
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.separation import SPOTS, blocks_of, camera_pixels, entries_of, spot_deviation

# The middle of a spot lies within this distance of the epipolar line, in projector pixels, and the
# 3 x 3 pixels around it reach as far. Chosen by hand: one pixel and a half leave room for a spot
# that lies between pixels.
_REACH = 1.5
Array = NDArray[np.float64]


def find_line_spots(
    matrix: csr_array,
    background: Array,
    lines: Array,
    pixels: Array,
    shape: tuple[int, int],
    half_width: float,
    stagger: float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Find the spots of each row of T, (P, N): two beside its line, and a third anywhere.

    Of all 3 x 3 pixels whose middle lies within 1.5 pixels of the line, the brightest are the first
    spot; the second is the brightest that lies apart from it. A spot's place is the centroid of the
    light in a window around it, whose borders cut pixels in parts, so that it moves smoothly.

    `lines` (P, 3) are a, b, c with a^2 + b^2 = 1 and a col + b row + c = 0, `pixels` (N, 2) the
    column and row of each projector pixel without distortion, and `stagger` how far odd rows stand
    to the right. Returns places (P, 3, 2) as (row, col), NaN where there is none, light and
    standard deviations (P, 3), and the light of rows (P,).
    """
    if not matrix.has_sorted_indices:
        matrix = matrix.copy()
        matrix.sort_indices()

    def find(rows: slice) -> tuple[Array, ...]:
        some = csr_array(matrix[rows])
        return _of_block(some, lines[rows], pixels, shape, half_width, stagger)

    # Two blocks are computed at a time, since each takes about 400 MiB.
    parts = work_ahead(find, blocks_of(matrix), threads=2)
    place, light, width, total = map(np.concatenate, zip(*parts, strict=True))
    return place, light, width, total + np.maximum(background, 0)


def uncut_places(place: Array, lines: Array, shape: tuple[int, int], margin: float) -> Array:
    """Places of spots, corrected where the projector's border cuts a spot off.

    Within `margin` of the outermost pixels, the coordinate across the border is where the line
    crosses the other coordinate, which nothing cuts. It moves outwards only, and by a pixel at
    most; distortion hardly matters over so short a way.
    """
    result = place.copy()
    for axis in (0, 1):
        along, across = lines[:, 1 - axis], lines[:, axis]
        low, high = place[:, axis] < margin, place[:, axis] > shape[axis] - 1 - margin
        # Columns of `lines` belong to (col, row), those of `place` to (row, col).
        with np.errstate(invalid="ignore", divide="ignore"):
            crossing = -(across * place[:, 1 - axis] + lines[:, 2]) / along
        # Chosen by hand: errors of the coordinate grow threefold at most.
        steep = np.abs(along) >= 0.3
        outwards = np.where(low, place[:, axis] - crossing, crossing - place[:, axis])
        cut = (low | high) & steep & (outwards > 0) & (outwards <= 1)
        result[cut, axis] = crossing[cut]
    return result


def _of_block(
    matrix: csr_array,
    lines: Array,
    pixels: Array,
    shape: tuple[int, int],
    half_width: float,
    stagger: float,
) -> tuple[Array, ...]:
    """Places, light, widths and total light of the spots of some rows."""
    count = int(matrix.shape[0])
    owner, row, col = entries_of(matrix, shape[1])
    # Some estimates allow negative light, which does not count.
    light = np.maximum(matrix.data, 0).astype(np.float64)
    # Coordinate by coordinate: NumPy takes several times as long over pairs of them.
    ideal_col, ideal_row = np.ascontiguousarray(pixels.T).take(matrix.indices, axis=1)
    across, down, shift = np.ascontiguousarray(lines.T)
    distance = np.abs(across[owner] * ideal_col + down[owner] * ideal_row + shift[owner])
    # The light of the 3 x 3 pixels around each entry, in its row of T. Entries are sorted by row
    # and pixel; the numbers of pixels have a border, so that no neighbour lies across an edge.
    width = shape[1] + 2
    pixel = (row.astype(np.int64) + 1) * width + col.astype(np.int64) + 1
    pixel += owner * ((shape[0] + 2) * width)
    padded = np.append(pixel, [np.iinfo(np.int64).max] * 3)
    padded_light = np.append(light, [0.0] * 3)
    sums = np.zeros(len(pixel))
    for first in (pixel - width - 1, pixel - 1, pixel + width - 1):
        found = np.searchsorted(pixel, first)
        for step in range(3):
            sums += np.where(padded[found + step] <= first + 2, padded_light[found + step], 0)
    col += stagger * (row % 2)
    del pixel, padded, padded_light, first, found, ideal_col, ideal_row
    places, lights, widths = np.full((SPOTS, count, 2), np.nan), *np.zeros((2, SPOTS, count))
    free = light > 0
    for number in range(SPOTS):
        chosen = np.flatnonzero(free & ((distance <= _REACH) | (number == 2)))
        best = np.zeros(count)
        np.maximum.at(best, owner[chosen], sums[chosen])
        # The order is reversed, so that the first of several equal ones stays.
        chosen = chosen[sums[chosen] == best[owner[chosen]]][::-1]
        middle_row, middle_col = np.full((2, count), np.nan)
        middle_row[owner[chosen]], middle_col[owner[chosen]] = row[chosen], col[chosen]
        away = np.maximum(np.abs(row - middle_row[owner]), np.abs(col - middle_col[owner]))
        # The windows of two spots have no pixel in common, but for what they move: by up to one.
        free &= ~(away < 2 * half_width)
        inside = np.flatnonzero(away <= half_width + _REACH)
        own, y, x, held_by = owner[inside], row[inside], col[inside], light[inside]
        with np.errstate(invalid="ignore", divide="ignore"):
            # The window is centred on the light within it; it then moves by less than 0.01 pixels.
            for _ in range(4):
                share = np.clip(half_width + 0.5 - np.abs(y - middle_row[own]), 0, 1)
                share *= np.clip(half_width + 0.5 - np.abs(x - middle_col[own]), 0, 1)
                share *= held_by
                lights[number] = held = np.bincount(own, share, count).astype(np.float64)
                middle_row = np.bincount(own, share * y, count) / held
                middle_col = np.bincount(own, share * x, count) / held
            squared = share * ((y - middle_row[own]) ** 2 + (x - middle_col[own]) ** 2) / 2
            widths[number] = np.sqrt(np.bincount(own, squared, count) / held)
        places[number] = np.stack([middle_row, middle_col], axis=1)
    total = np.bincount(owner, light, count).astype(np.float64)
    return places.swapaxes(0, 1), lights.T, widths.T, total


@dataclass(frozen=True, eq=False)
class Seen:
    """What P camera pixels see in up to n places each, and where that lies; (P, n) but for some."""

    # Row and column on the projector, (P, n, 2); NaN where there is none.
    place: Array
    # The light of a spot, its share of the row's or the confidence of a decoded place, and its
    # standard deviation in those of a usual spot.
    light: Array
    share: Array
    width: Array
    # The row's stated error, or the uncertainty of a decoded place in projector pixels, (P,), and
    # whether the row clips whenever its strongest pixel is lit.
    error: Array
    bounded: NDArray[np.bool_]
    # The standard deviation of a usual spot in projector pixels, at least 0.3.
    usual: float
    # Signed distance from the epipolar line in projector pixels.
    away: Array
    # Points (P, n, 3), their depth, NaN behind camera or projector, and how far a projector pixel
    # along the line moves it.
    points: Array
    depth: Array
    slope: Array
    grid: tuple[int, int]
    decoded: bool

    @property
    def on_line(self) -> NDArray[np.bool_]:
        """Spots (P, n) of light that may have met one surface: within a pixel of their line."""
        return np.abs(self.away) <= 1

    @property
    def direct(self) -> NDArray[np.bool_]:
        """Spots (P, n) on their line whose points lie before camera and projector."""
        return self.on_line & np.isfinite(self.depth)


def on_diamonds(source: Correspondence, stagger: float) -> Correspondence:
    """Matches whose places, counted in pixels, become where diamond pixels lie."""
    if not stagger:
        return source
    # A camera whose pixels step over rows sees odd and even ones alike: its pixels, as large as
    # the distance of columns, are means of as many rows.
    steps = np.abs(np.diff(source.place[..., 0], axis=0))
    known = steps[np.isfinite(steps)]
    height = 1.0 if known.size and np.median(known) < 1 else DIAMOND_ROWS
    place = staggered(source.place[..., ::-1].astype(np.float64), stagger, height)[..., ::-1]
    return replace(source, place=place.astype(np.float32))


def seen_by(source: LightTransport | Correspondence, geometry: RigGeometry) -> Seen:
    """What the camera's pixels see of the projector, in T or in a correspondence."""
    camera = camera_pixels(geometry.camera_shape)[:, ::-1]
    # The epipolar lines (P, 3) on the projector without distortion: a col + b row + c = 0 with
    # a^2 + b^2 = 1.
    lines = np.column_stack([geometry.undistort_camera(camera), np.ones(len(camera))])
    lines = lines @ geometry.fundamental_matrix().T
    lines = lines / np.hypot(lines[:, 0], lines[:, 1])[:, None]
    # Lines and directions for columns as the projector counts them, which mirrors may reverse.
    counted, along = lines, np.column_stack([-lines[:, 1], lines[:, 0]])
    if geometry.projector_mirrored:
        a, b, c = lines.T
        counted = np.column_stack([-a, b, c + a * (geometry.projector_shape[1] - 1)])
        along *= (-1, 1)
    shape, usual, margin = geometry.projector_shape, 1.0, 0.5
    if isinstance(source, Correspondence):
        # Places within half a pixel of the border may be cut off, as for a sharp spot of T. With
        # columns or rows only, a place is where they cross the line.
        source = on_diamonds(source, geometry.projector_stagger)
        place = source.place.reshape(-1, 2).astype(np.float64)
        known = np.isfinite(place)
        if not known.all(axis=1).any():
            a, b, c = counted.T
            with np.errstate(invalid="ignore", divide="ignore"):
                crossing = -np.column_stack([a * place[:, 1] + c, b * place[:, 0] + c])
                place = np.where(known, place, crossing / np.column_stack([b, a]))
        place, share = place[:, None], source.confidence.reshape(-1, 1).astype(np.float64)
        light = share if source.light is None else source.light.reshape(-1, 1).astype(np.float64)
        width, error = np.ones_like(share), np.zeros(len(share))
        bounded = np.zeros(len(share), bool)
        if source.uncertainty is not None:
            stated = source.uncertainty.reshape(-1, 2).astype(np.float64)
            error = np.nan_to_num(stated).max(axis=1)
    else:
        rows, background = pixel_rows(source)
        usual = spot_deviation(source, rows)
        pixels = geometry.projector_places(camera_pixels(shape)[:, ::-1])
        pixels = geometry.undistort_projector(pixels)
        # The window reaches 1.5 projector pixels to each side of sharp spots, and 2.5 under a blur
        # of 1 pixel. Chosen by hand.
        half_width = max(1.5, 2.4 * usual)
        margin = half_width - 1
        stagger = geometry.projector_stagger
        found = find_line_spots(rows, background, lines, pixels, shape, half_width, stagger)
        place, light, width, total = found
        share = np.nan_to_num(light / np.maximum(total, 1e-30)[:, None])
        channels = int(np.prod(source.camera_shape[2:]))
        stated, clips = (
            np.nan_to_num(source.diagnostics.get(name, np.zeros(len(lines) * channels)))
            for name in ("estimated_error", "only_bounded")
        )
        error = stated.reshape(-1, channels).mean(axis=1, dtype=np.float64)
        bounded = clips.reshape(-1, channels).any(axis=1)
    away, depth, slope = np.full((3, *light.shape), np.nan)
    points = np.full((*light.shape, 3), np.nan)
    axis = geometry.projector_matrix[2]
    for number in range(light.shape[1]):
        some = np.flatnonzero(np.isfinite(place[:, number]).all(axis=1))
        # A spot that the projector's border cuts off seems to lie farther inside than it does.
        place[some, number] = uncut_places(place[some, number], counted[some], shape, margin)
        lit, pixel = place[some, number, ::-1], camera[some]
        ideal = geometry.undistort_projector(lit)
        away[some, number] = (lines[some, :2] * ideal).sum(axis=1) + lines[some, 2]
        points[some, number] = found_points = geometry.triangulate(pixel, lit)
        deep = geometry.depth(found_points)
        moved = geometry.depth(geometry.triangulate(pixel, lit + 0.1 * along[some]))
        slope[some, number] = np.abs(moved - deep) / 0.1
        before = (deep > 0) & (found_points @ axis[:3] + axis[3] > 0)
        depth[some, number] = np.where(before, deep, np.nan)
    decoded, usual = isinstance(source, Correspondence), max(usual, 0.3)
    of_spots = (light, share, width / usual, error, bounded, usual, away, points, depth, slope)
    return Seen(place, *of_spots, geometry.camera_shape, decoded)


# How probably a spot is a surface.

# Coefficients of a logistic regression on `features`, for T (False) and for decoded places (True).
# The last two: how much steeper the score rises, and from where on.
# `python -m benchmarks.shape_probability` fits them, and tests each scene with those of the others.
COEFFICIENTS = {
    False: (2.05, -1.54, -0.72, -0.68, -0.95, 0.19, -0.37, 0.38, 0.18, 0.36, 0.73, 1.59),
    True: (1.63, -0.49, 0.0, -0.19, -0.55, 0.59, -0.42, 0.27, 0.12, 0.0, 1.65, 1.36),
}


def features(seen: Seen, tolerance: float) -> dict[str, Array]:
    """What is known of each direct spot, by name, (S,) each, in the order of ``seen.direct``.

    `away` is its distance from its line, `width` its own. A surface continues in the 8 neighbours
    of its camera pixel: `step` is how far the depth is from those nearest to it, `bend` how far
    from the middle of two opposite ones, in logarithms of the tolerated error. `room` is that error
    in standard deviations of a usual spot, and `noise` the row's stated error relative to the share
    of the spot, as logarithms too. Doubts do not simply add up, which the products take up.
    """
    # Spots fainter than the stated error of their row are no neighbours. The limits were chosen by
    # hand: exact matrices state no error, and rows that see little light large ones.
    strong = seen.direct & (seen.share > np.clip(seen.error, 0.01, 0.5)[:, None])
    surfaces = np.where(strong, seen.depth, np.nan).astype(np.float32).T.copy()
    depth = seen.depth[seen.direct].astype(np.float32)
    pixel = np.nonzero(seen.direct)[0]
    (rows, cols), (row, col) = seen.grid, np.divmod(pixel, seen.grid[1])
    # Relative steps to the nearest depth in pairs of opposite neighbours: a tenth where they have
    # none, or none as near, and NaN outside of the image.
    steps = np.full((8, len(depth)), np.nan, np.float32)
    around = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
    for step, (down, right) in zip(steps, around, strict=True):
        inside = (row + down >= 0) & (row + down < rows) & (col + right >= 0) & (col + right < cols)
        there = np.where(inside, pixel + down * cols + right, 0)
        step[inside] = 0.1
        for surface in surfaces:
            away = surface[there] / depth - 1
            np.copyto(step, away, where=np.abs(away) < np.abs(step))
    # Corners of the image have no opposite neighbours.
    bend = np.nan_to_num(np.fmax.reduce(np.abs(steps[::2] + steps[1::2])) / 2, nan=0.1)
    nearest = np.nan_to_num(np.partition(np.abs(steps), 2, axis=0)[:3], nan=0.1).mean(axis=0)
    step, bend = (
        np.log(np.maximum(each / tolerance, 0.05)).astype(np.float64) for each in (nearest, bend)
    )
    away, width = np.abs(seen.away[seen.direct]), seen.width[seen.direct]
    tolerated = tolerance * seen.depth[seen.direct] / seen.slope[seen.direct]
    room = np.log(np.maximum(tolerated / seen.usual, 1e-3))
    noise = np.log(seen.error[pixel] / np.maximum(seen.share[seen.direct], 1e-3) + 0.05)
    return {
        "one": np.ones_like(away), "away": away, "width": width, "bend": bend, "step": step,
        "room": room, "noise": noise, "away noise": away * noise, "step noise": step * noise,
        "width bend": width * bend,
    }  # fmt: skip


def check_thresholds(tolerance: float, least_probability: float) -> None:
    """Refuse a tolerated error that is no share of the distance, and what is no probability."""
    hint = "use a share such as 0.01"
    check_number("a tolerance", tolerance, most=1, above=True, hint=hint)
    check_number("a least probability", least_probability, most=1, hint="use 0 to 1")


def surface_probability(seen: Seen, tolerance: float) -> Array:
    """How probably each spot (P, n) lies within a share of the distance of a surface; 0 off it."""
    *weights, steeper, start = COEFFICIENTS[seen.decoded]
    known = features(seen, tolerance).values()
    score = np.sum([weight * each for weight, each in zip(weights, known, strict=True)], axis=0)
    score += steeper * np.maximum(score - start, 0)
    result = np.zeros(seen.light.shape)
    result[seen.direct] = 1 / (1 + np.exp(-np.clip(score, -50, 50)))
    # How bright the strongest pixel is beside its neighbours is unknown in rows that are bounded,
    # and so is the place, by half the width of the spot. In `corner`, exposed four times too long,
    # 69 % of such places were right where this exceeds the tolerated error.
    unsure = 0.5 * seen.width * seen.usual * seen.slope > tolerance * seen.depth
    return np.where(seen.bounded[:, None] & unsure, np.minimum(result, 0.69), result)
