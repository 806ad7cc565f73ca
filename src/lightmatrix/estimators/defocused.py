"""T of a camera that is out of focus, whose rows are mixtures of sharp ones.

Each camera pixel then sees what its neighbours see, too, so that a row of T has many times the
entries of a sharp one, more than a few photographs tell. But T = C S: C blurs images of the camera,
and the rows of S are sparse. All rows of S are estimated together, from what C makes of them,

    min over S >= 0 of  1/2 ||C S P - Y||^2 + penalty sum(S),

by accelerated proximal steps (FISTA, Beck and Teboulle 2009; restarts, O'Donoghue and Candes 2015).
Their light may only lie where the rows of a first T lie, or beside their strongest entries. The
penalty is what noise alone would give a place, and the noise is what the last step left (scaled
lasso, Sun and Zhang 2012). What the samples of a row have in common belongs to its background.

C is a Gaussian or the image of an aperture, whichever predicts photographs held out best.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.samples import Samples
from lightmatrix.estimators.camera_window import window_of_light
from lightmatrix.estimators.coherent import row_errors
from lightmatrix.estimators.coherent.row_errors import HeldOut
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.progress import Progress
from lightmatrix.regions import Region
from lightmatrix.resources.threads import one_blas_thread
from lightmatrix.transport.matrix import LightTransport, prediction_error
from lightmatrix.transport.sparse_rows import SparseRows, footprint_sizes

Array = NDArray[np.float32]

# Standard deviations of the camera's blur that are tried first, in its pixels.
_BLURS = (0.7, 1.0, 1.4, 2.0)
# Camera samples of the trials that find the blur, and of a strip of the camera, which takes about
# 200 MiB with 32 patterns.
_TRIED, _TOGETHER = 1200, 1 << 15
# Pixels at the border of the window of a trial, which see what lies outside.
_BORDER = 5
# The most steps, and those after which places without light are left out. Matte scenes take 300
# steps, glossy ones 600.
_STEPS, _PART = 800, 50


def defocused(
    capture: Capture, first: LightTransport, progress: Progress | None = None
) -> tuple[float, LightTransport] | None:
    """The blur of the camera in its pixels, and T estimated with it; None if it is in focus.

    `first` is an estimate of `capture` that takes each row by itself. T stays only if it predicts
    photographs held out better than `first` by two per cent.
    """
    held, before = HeldOut.choose(capture.patterns), prediction_error(first)
    if not len(held.judged) or before is None or not _is_soft(capture):
        return None
    with one_blas_thread():
        kernel = _found_kernel(capture, first, held)
        transport = first if kernel is None else _estimate(capture, first, kernel, held, progress)
    if kernel is None or (prediction_error(transport) or np.inf) > 0.98 * before:
        return None
    # The standard deviation along an axis, averaged over both.
    place = np.arange(len(kernel)) - len(kernel) // 2
    return float(np.sqrt((kernel * np.add.outer(place**2, place**2)).sum() / 2)), transport


def _is_soft(capture: Capture) -> bool:
    """Whether neighbouring pixels differ so little that the camera may be out of focus.

    Differences of neighbours have 0.7 to 0.9 times the energy of those of pixels further apart
    under random patterns, 0.3 times with a blur of 0.7 pixels. A blurred projector looks alike.
    """
    some = capture.select(np.arange(min(8, capture.count)))
    values = some.samples(0, some.rows).values.reshape(*some.camera_shape[:2], -1, some.count)
    values = values - values.mean(axis=-1, keepdims=True)
    near, far = (
        sum((scipy.ndimage.correlate1d(values, kernel, axis) ** 2).sum() for axis in (0, 1))
        for kernel in ([1, -2, 1], [1, 0, -2, 0, 1])
    )
    return near < 0.6 * far


def _found_kernel(capture: Capture, first: LightTransport, held: HeldOut) -> Array | None:
    """The kernel that predicts photographs held out best in a window of the camera, if it helps."""
    high, wide = capture.camera_shape[:2]
    tested = capture.select(held.judged).tiles()
    energy = np.mean([np.square(tile.values).mean() for _, tile in tested])
    window = window_of_light(capture, np.arange(min(8, capture.count)), _TRIED)
    if window is not None:
        corner, whole = (window[0].start, window[1].start), (high, wide)
        high, wide = (side.stop - side.start for side in window)
        first = first.crop(Region(corner, (high, wide), whole))
        capture = capture.window(*window)
    if min(high, wide) < 4 * _BORDER:
        return None
    inner = np.zeros((high, wide, capture.rows // (high * wide)), np.bool_)
    inner[_BORDER:-_BORDER, _BORDER:-_BORDER] = True

    def misses(size: float, shape: Callable[[float], Array]) -> float:
        whole = _Strip.of(capture, first, shape(size), slice(0, high))
        predicted = whole.without(held.frames).solved(0.05).predicted[:, held.judged]
        missed, _ = row_errors.held_out_energy(whole.samples, predicted, held.judged)
        return float(missed[inner.ravel()].mean())

    before = energy * np.nanmean(first.diagnostics["prediction_error"][inner.ravel()] ** 2)
    # Where T is no better with a small blur, the projector is blurred, or the scene is smooth.
    most = 0.8 * misses(0.0, _gaussian)
    tried: list[tuple[float, float, Callable[[float], Array]]] = []
    for size in _BLURS:
        tried += [(misses(size, shape), size, shape) for shape in (_gaussian, _disk)]
        least, best, shape = min(tried, key=lambda each: each[0])
        # Blurs next to that of a camera missed at most 8 times as much as T by itself does, and
        # where the projector was blurred, mostly 26 to 54 times as much.
        if least > most or (best < size and least > 10 * before):
            return None
    around, exact = (best / 1.4, best * 1.4), {"xatol": 0.03 * best}
    found = scipy.optimize.minimize_scalar(misses, args=(shape,), bounds=around, options=exact)
    return shape(found.x if found.fun < least else best) if found.fun < before else None


def _estimate(
    capture: Capture, first: LightTransport, kernel: Array, held: HeldOut, progress: Progress | None
) -> LightTransport:
    """T with a blurred camera, strip by strip, and how well it predicts the frames held out."""
    lines, width = capture.camera_shape[0], capture.rows // capture.camera_shape[0]
    around, high = len(kernel), max(1, _TOGETHER // width)
    parts = []
    for top in range(0, lines, high):
        near = slice(max(0, top - around), min(lines, top + high + around))
        place = slice(top * width, min(lines, top + high) * width)
        own = slice(place.start - near.start * width, place.stop - near.start * width)
        whole = _Strip.of(capture, first, kernel, near)
        tried = whole.without(held.frames).solved()
        shown = tried.predicted
        samples, predicted = whole.samples.rows(own), shown[own][:, held.judged]
        left = tried.centred(whole.samples.values - shown)
        rest = np.square(left).sum(axis=1) / np.maximum(tried.known.sum(axis=1), 1)
        missed, seen = row_errors.held_out_energy(samples, predicted, held.judged)
        own_facts = {
            "misfit": row_errors.squared_misfit(samples, predicted, held.judged), "missed": missed,
            "seen": seen, "rest": rest[own],
            # A row stays as it is if nearly all samples around it clip.
            "solved": (whole.blurred(whole.known).mean(axis=1) > 0.1)[own].astype(np.float32),
        }  # fmt: skip
        rows = whole.solved().rows(capture.patterns.pixels)
        parts.append(replace(rows.rows(np.arange(own.start, own.stop)), diagnostics=own_facts))
        if progress is not None:
            progress(place.stop, capture.rows)
    rows = SparseRows.joined(parts)
    facts = dict(rows.diagnostics)
    kept = np.flatnonzero(facts["solved"] == 0)
    if len(kept):
        rows = rows.replaced(kept, SparseRows(first.sparse, first.background, facts).rows(kept))
    camera = lines, capture.camera_shape[1], width // capture.camera_shape[1]
    misfit = row_errors.smooth_misfit(facts["misfit"], camera, row_errors.noise_of(facts["rest"]))
    squares = rows.coefficients.multiply(rows.coefficients).sum(axis=1)
    squares = squares + (rows.background**2) @ (1 / np.diff(first.pooling.indptr))
    contrast = AtomPatterns(capture.patterns, (0.0,)).neighbour_contrast
    with np.errstate(divide="ignore", invalid="ignore"):
        own_error = np.sqrt(misfit / np.asarray(squares)) / contrast
        missed = np.sqrt(facts["missed"] / facts["seen"].mean(dtype=np.float64))
    footprint, no_gap = footprint_sizes(rows.coefficients), np.full(capture.rows, np.nan)
    names = "estimated_error", "prediction_error", "footprint", "gap"
    new = dict(zip(names, (own_error, missed, footprint, no_gap), strict=True))
    of_single_rows = {"objective", "searched_everywhere"}
    old = {key: each for key, each in first.diagnostics.items() if key not in of_single_rows}
    return replace(
        first, sparse=rows.coefficients, background=rows.background,
        diagnostics={**old, **{key: each.astype(np.float32) for key, each in new.items()}},
        provenance={**first.provenance, "certificate": "none, rows are solved together"},
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Strip:
    """Whole lines of the camera, m samples under K patterns, that are solved together."""

    samples: Samples
    # Which samples count and do not clip, (m, K).
    known: Array
    # The background of the first T, (m, B), what it gives the samples, (m, K), and what a unit in
    # each of its cells gives them on average.
    background: Array
    low: Array
    even: float
    # The places of row i are those from starts[i] to below starts[i + 1], (m + 1,). Each has a
    # projector pixel, as an index into `pixels`, and the light of S there.
    starts: NDArray[np.int64]
    places: NDArray[np.int64]
    light: Array
    # The n projector pixels that occur, their patterns less their means, (n, K), and these, (n, 1).
    pixels: NDArray[np.int64]
    columns: Array
    means: Array
    # The kernel of C, (2 h + 1, 2 h + 1), and C and its transpose.
    kernel: Array
    blurs: tuple[csr_array, csr_array]

    @classmethod
    def of(cls, capture: Capture, first: LightTransport, kernel: Array, lines: slice) -> "_Strip":
        """The strip with light where the first T has its own."""
        cols, channels = capture.camera_shape[1], int(np.prod(capture.camera_shape[2:]))
        rows = slice(lines.start * cols * channels, lines.stop * cols * channels)
        samples = capture.samples(rows.start, rows.stop)
        known = samples.counted & ~samples.clipped & capture.valid[rows, None]
        starts, places, light = _places(csr_array(first.sparse[rows]), capture.projector_shape)
        pixels, at = np.unique(places, return_inverse=True)
        columns = np.ascontiguousarray(capture.patterns.columns(pixels).T, np.float32)
        means = columns.mean(axis=1, keepdims=True)
        cells = np.concatenate([first.pooling @ part.T for _, part in capture.patterns.chunks()], 1)
        background, even = first.background[rows], float(cells.sum(axis=0).mean())
        blur = _blur((lines.stop - lines.start, cols, channels), kernel)
        return cls(
            samples, known.astype(np.float32), background,
            (background @ cells).astype(np.float32), even, starts, at.astype(np.int64), light,
            pixels, columns - means, means, kernel, (blur, csr_array(blur.T)),
        )  # fmt: skip

    def without(self, frames: NDArray[np.int64]) -> "_Strip":
        """The strip without what some frames say."""
        known = self.known.copy()
        known[:, frames] = 0
        return replace(self, known=known)

    def blurred(self, images: Array) -> Array:
        """C applied to images (m, K)."""
        return np.asarray(self.blurs[0] @ images)

    def shown(self, light: Array, columns: Array) -> Array:
        """C S P of light at the places."""
        return self.blurred(_core.light_at_places(self.starts, self.places, columns, light))

    def gathered(self, samples: Array) -> Array:
        """The adjoint of `shown`, of samples (m, K)."""
        samples = self.blurs[1] @ samples
        return _core.gathered_at_places(self.starts, self.places, self.columns, samples)

    def mean(self, values: Array) -> Array:
        """The mean of the known ones of values (m, K) in each row, (m, 1)."""
        counted = np.maximum(self.known.sum(axis=1, keepdims=True), 1)
        return np.asarray((values * self.known).sum(axis=1, keepdims=True) / counted)

    def centred(self, values: Array) -> Array:
        """The known ones of values (m, K), less their mean in each row."""
        return (values - self.mean(values)) * self.known

    @property
    def predicted(self) -> Array:
        """All samples as C S P says, with the mean of the known ones, (m, K)."""
        shown = self.low + self.shown(self.light, self.columns)
        return shown + self.mean(self.samples.values - shown)

    def solved(self, tolerance: float = 0.01) -> "_Strip":
        """The strip with its light, which `_PART` steps more change by less than the tolerance."""
        strip = self._descended(1.0, _STEPS, tolerance)
        # The penalty makes all light a little too weak. Less of it does where the places are known.
        return strip._at(strip.light > 0)._descended(0.2, _PART, tolerance)

    def _descended(self, share: float, steps: int, tolerance: float) -> "_Strip":
        """The strip after so many steps with a share of the penalty, or when they change little."""
        strip, light, ahead, pace, before = self, self.light, self.light, 1.0, self.light
        if not (len(self.places) and self.known.any()):
            return self
        target = self.centred(self.samples.values - self.low)
        counted = np.maximum(self.known.sum(axis=1), 1)
        length = 1 / self._curvature()
        # The norm of what a unit of light at a place gives all samples.
        norm = np.sqrt(np.square(self.columns).sum(axis=1).mean() * self.known.mean())
        norm *= np.linalg.norm(self.kernel)
        for step in range(1, steps + 1):
            left = strip.centred(strip.shown(ahead, strip.columns)) - target
            noise = np.sqrt(np.median(np.square(left).sum(axis=1) / counted))
            slope, penalty = strip.gathered(left), np.float32(share * noise * norm)
            new = np.maximum(ahead - np.float32(length) * (slope + penalty), 0)
            way = new - light
            if np.vdot(ahead - new, way) > 0:
                pace = 1.0
            following = (1 + np.sqrt(1 + 4 * pace**2)) / 2
            ahead = new + np.float32((pace - 1) / following) * way
            light, pace = new, following
            if step % _PART == 0:
                if np.linalg.norm(light - before) < tolerance * np.linalg.norm(light):
                    break
                # Places that are far from having light are left out.
                stay = (light > 0) | (ahead > 0) | (slope < -penalty / 2) | (step < 3 * _PART)
                strip = replace(strip, light=light)._at(stay)
                light = before = strip.light
                ahead = ahead[stay]
        return replace(strip, light=light)

    def _at(self, stay: NDArray[np.bool_]) -> "_Strip":
        """The strip at some of its places."""
        starts = np.concatenate([[0], np.cumsum(stay)])[self.starts]
        return replace(self, starts=starts, places=self.places[stay], light=self.light[stay])

    def _curvature(self) -> float:
        """At least the largest curvature of the squares, by power iteration."""
        way, size = np.random.default_rng(0).random(len(self.places), np.float32), 1.0
        for _ in range(15):
            way = self.gathered(self.centred(self.shown(way, self.columns)))
            size = float(np.linalg.norm(way))
            way /= np.float32(max(size, 1e-30))
        return 1.05 * size

    def rows(self, pixels: int) -> SparseRows:
        """The rows of T = C S, with what their light leaves of the samples as background."""
        shape = len(self.starts) - 1, pixels
        sharp = csr_array((self.light, self.pixels[self.places], self.starts), shape=shape)
        mixed = csr_array(self.blurs[0] @ sharp)
        most = np.repeat(mixed.max(axis=1).toarray().ravel(), np.diff(mixed.indptr))
        # A thousandth of the strongest entry is less than noise leaves of it.
        mixed.data[mixed.data < 1e-3 * most] = 0
        mixed.eliminate_zeros()
        rest = self.samples.values - self.low - self.shown(self.light, self.columns + self.means)
        even = self.mean(rest) / max(self.even, 1e-6)
        return SparseRows(mixed, np.maximum(self.background + even, 0))


def _places(
    rows: csr_array, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """The places of rows of T: their entries, and the pixels around the strongest ones."""
    count, pixels = rows.shape
    owner = np.repeat(np.arange(count), np.diff(rows.indptr))
    most = np.repeat(rows.max(axis=1).toarray().ravel(), np.diff(rows.indptr))
    strong = rows.data > 0.25 * most
    down, right = np.divmod(rows.indices[strong].astype(np.int64), shape[1])
    down = np.clip(down[:, None, None] + np.arange(-1, 2)[:, None], 0, shape[0] - 1)
    right = np.clip(right[:, None, None] + np.arange(-1, 2), 0, shape[1] - 1)
    around = (owner[strong, None, None] * pixels + down * shape[1] + right).reshape(-1)
    keys, at = np.unique(np.append(owner * pixels + rows.indices, around), return_inverse=True)
    light = np.zeros(len(keys), np.float32)
    light[at[: len(owner)]] = np.maximum(rows.data, 0)
    starts = np.searchsorted(keys, np.arange(count + 1) * pixels)
    return starts, keys % pixels, light


def _gaussian(size: float) -> Array:
    """A kernel of a standard deviation in pixels, as of a lens that is not quite sharp."""
    place = np.arange(-int(np.ceil(3 * size)), int(np.ceil(3 * size)) + 1)
    profile = np.exp(-(place**2) / (2 * max(size, 0.1) ** 2))
    kernel = np.outer(profile, profile)
    return (kernel / kernel.sum()).astype(np.float32)


def _disk(size: float) -> Array:
    """A kernel of a standard deviation in pixels, the image of the aperture of a lens."""
    reach = int(np.ceil(2 * size)) + 1
    # Each pixel is the mean of eight by eight places.
    place = (np.arange((2 * reach + 1) * 8) + 0.5) / 8 - reach - 0.5
    inside = np.add.outer(place**2, place**2) < (2 * size) ** 2
    kernel = inside.reshape(2 * reach + 1, 8, 2 * reach + 1, 8).mean(axis=(1, 3))
    return (kernel / kernel.sum()).astype(np.float32)


def _blur(shape: tuple[int, int, int], kernel: Array) -> csr_array:
    """C of images (lines, columns, channels); beyond their ends it sees the last pixels."""
    lines, cols, channels = shape
    place = np.arange(len(kernel)) - len(kernel) // 2
    down = np.clip(np.arange(lines)[:, None] + place, 0, lines - 1)[:, None, None, :, None]
    right = np.clip(np.arange(cols)[:, None] + place, 0, cols - 1)[None, :, None, None, :]
    pixels = ((down * cols + right) * channels + np.arange(channels)[:, None, None]).reshape(-1)
    count = lines * cols * channels
    starts = np.arange(count + 1) * kernel.size
    weights = np.broadcast_to(kernel.ravel(), (count, kernel.size)).ravel()
    matrix = csr_array((weights, pixels, starts), shape=(count, count))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
