"""`lm.Tracker`: T that follows a scene, photograph by photograph (`docs/tracking.md`).

Each photograph is predicted before it is used. What the prediction misses tells which rows changed
and when, by Page's cumulative sum (Biometrika 1954); other rows stay bit by bit. Those that changed
are solved again with the photographs since then. Eight black and white ones tell 256 projector
pixels apart, not all of them. But T knows how far, and along which line, depth moves light: only
there rows search. They are unknown until they predict photographs that they have not used.
"""

import re
import time
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, capture_of_samples, open_capture
from lightmatrix.capture.exposures import frame_weights
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError, warn
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.neighbourhood import REACH, Neighbourhood
from lightmatrix.estimators.coherent.row_solver import RowSolver
from lightmatrix.estimators.coherent.schedule import Round
from lightmatrix.estimators.estimate import estimate
from lightmatrix.files.new_files import NewFiles
from lightmatrix.files.stacks import ImageStack, natural_order
from lightmatrix.geometry.matches import fit_homography, moved
from lightmatrix.patterns.atoms import AtomPatterns
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.ranges import real_array
from lightmatrix.reprs import percent
from lightmatrix.solvers.active_set import Candidates, Cells, solve_weighted
from lightmatrix.solvers.problem import Result
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import SparseRows

# What multiplies the squares missed by less than the first is no change but an error of T. A region
# has changed, and a row within it, if sums of log-likelihood ratios exceed the other two. They stay
# below 2 in 64 photographs of a still scene of 64 x 64 pixels (`python -m benchmarks.track`).
_RATIO, _REGION, _ROW = 25.0, 10.0, 2.0
# Numbers of photographs: a row is solved from so many since its change on (from four on costs as
# much again, and leaves the same errors after eight); so many judge whether it is known; up to so
# many it is searched whether known or not. Chosen by hand.
_FIRST, _JUDGED, _SEARCHED = 5, 3, 8
# Rows that were searched learn from their neighbours in all three rounds, others in the last.
_ROUNDS = (
    Round(1, (2, 1), 3, has_pseudo_samples=True),
    Round(1, (2, 1), 4, has_pseudo_samples=True),
    Round(1, (1, 1), 5, last=True, has_pseudo_samples=True),
)


class Update(NamedTuple):
    """What a photograph said of the scene."""

    # Its number, from 1 on; the name of its frame or file; and the number of its pattern among
    # those of the capture that was given with it.
    photograph: int
    name: str
    pattern: int
    # Camera samples that it showed to have changed, and those whose rows are not known yet.
    changed: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    # The relative error of its prediction by all other rows, and the seconds that it took.
    missed: float
    seconds: float


class Tracker:
    """T after each further photograph of a scene in which things move.

    Parameters
    ----------
    capture : Capture, str or Path
        The first K photographs; further ones slide through a window of K.
    transport : LightTransport, optional
        T of these. None: it is estimated.

    Raises
    ------
    InputError
        If T does not fit the capture or has no light, or a projector shows colours.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 33), exposure=0.15)
    >>> tracker = lm.Tracker(capture.select(range(32)))
    >>> step = tracker.update(capture.frame(32), capture.patterns.images(32)[0])
    >>> step.photograph, step.changed.shape
    (1, (64, 64))
    """

    def __init__(
        self, capture: Capture | str | Path, transport: LightTransport | None = None
    ) -> None:
        # What the rig did to further photographs is not known.
        self._capture = replace(open_capture(capture), correction=None)
        if isinstance(self._capture.patterns, ColourPatterns) or self._capture.projectors:
            hint = "track photographs of one projector, in grey"
            raise InputError("several projectors or colours at once", hint=hint)
        self._given = transport or estimate(capture, progress=False)
        if self._given.image_shapes != (self._capture.camera_shape, self._capture.projector_shape):
            hint = "give the matrix of these photographs"
            raise InputError(f"photographs of other sizes than those of {self._given}", hint=hint)
        self._camera: tuple[int, ...] = (*self._given.camera_shape, 1)[:3]
        estimator = CoherentEstimator(background_grid=self._given.background_grid)
        self._solver = estimator.row_solver(self._capture)
        self._light = SparseRows(self._given.sparse, self._given.background)
        self._centres, self._steps = _parallax(self._given)
        # The last photographs, at most K: patterns, (N,), and samples, (M, 1).
        self._window: tuple[tuple[NDArray[np.float32], Samples], ...] = ()
        shown, samples = self._capture.patterns.dense(), self._capture.samples()
        self._longest = float(self._capture.exposures.max())
        misses = _squares(samples, self._predicted(self._light, shown)).T
        # Photographs that T was estimated from are missed by less than others: squares were 1 to 3
        # times as large on `l_objects` at 64 x 64.
        self._usual = 4 * self._around(misses.mean(axis=0)) + 1e-12
        # The variance of the camera's noise is at most this: most rows are right but for noise.
        self._noise = float(np.quantile(self._usual, 0.25)) / 4
        rows = len(self._usual)
        self.photographs, self.since = 0, np.zeros(rows, np.int64)
        # Squares by which rows missed the last photographs, infinite until they are solved; and
        # those of the photographs that they were solved with.
        self._missed, self._misfit = misses[-_JUDGED:], np.zeros(rows)
        # Cumulative sums of rows and of the regions around them, and where the latter began.
        (self._own, self._region), self._began = np.zeros((2, rows)), self.since.copy()
        # Rows that were solved again, in order, as atoms; and the light of all rows times the
        # contrast of the patterns, to which misses are relative.
        self._rows, self._atoms, self._length = self.since[:0], self._light, np.ones(rows)
        # Whether the user was told that the photographs do not follow the patterns.
        self._doubted = False

    def update(
        self, photograph: NDArray[Any], pattern: NDArray[Any], *, exposure: float | None = None
    ) -> Update:
        """Take a further photograph into T: raw levels as those of the capture.

        The pattern, (rows, cols), is in [0, 1]; the exposure in the capture's unit (None: that of
        its first frame). An InputError refuses sizes and types other than the capture's.
        """
        first = self._capture.select([0])
        patterns: PatternSet = ImagePatterns(real_array("a pattern", pattern)[None])
        if first.bin_projector != (1, 1):
            patterns = patterns.coarse(first.bin_projector)
        decoder = first.decoder if exposure is None else replace(first.decoder, exposure=exposure)
        frames = ArrayStack(np.asarray(photograph)[None])
        one = replace(first, patterns=patterns, frames=frames, decoder=decoder)
        return next(self.follow(one))

    def follow(self, capture: Capture) -> Iterator[Update]:
        """Take the photographs of another capture into T one by one; refuse other sizes."""
        sizes, wanted = (
            f"{each.frames.shape} {each.frames.dtype}, binned {each.bin_camera}, of patterns "
            f"{each.projector_shape}"
            for each in (capture, self._capture)
        )
        if sizes != wanted:
            raise InputError(f"raw levels {sizes}", hint=f"give those of {wanted}")
        names = capture.frames.name
        return (self._add(capture.select([k]), names(k), k) for k in range(capture.count))

    def watch(
        self, folder: str | Path, capture: Capture, *, first: int | None = None
    ) -> Iterator[Update]:
        """Take the photographs in a folder into T, also those that another program leaves there.

        The last number in a file's name says which pattern of the `capture` it shows: that of the
        `first` one (None: of the capture's first photograph) shows pattern 0, and after the last
        pattern comes the first again. Files that no name pairs, and damaged ones, are left out with
        a warning. It ends when none has come for half a minute. An InputError refuses numbers of
        another count.
        """
        count, frames, last = capture.count, capture.frames, time.monotonic()
        like, form = Path(frames.name(0)), (frames.shape, frames.dtype, len(frames.shape) == 2)
        stack = ImageStack((like,), *form, mosaic=getattr(frames, "mosaic", False))
        # What is before and behind the last number in a name; the same in the names of all.
        numbered, around = re.compile("(.*?)([0-9]+)([^0-9]*)").fullmatch, None
        own = numbered(like.stem)
        begin = int(own[2]) if own and first is None else first or 0
        files = NewFiles(Path(folder), lambda item: natural_order(item[0]))
        while time.monotonic() < last + 30:
            found = files.next(lambda file: replace(stack, paths=(*stack.paths, file)).read(1))
            if found is None:
                # No program takes that long over the rest of a file.
                if files.failure is not None and files.failure[1] > 5:
                    warn(f"left out: {files.failure[0]}")
                    files.pass_over(first=True)
                time.sleep(0.05)
                continue
            file, levels, _ = found
            parts = numbered(file.stem)
            if parts is None or (around or parts.group(1, 3)) != parts.group(1, 3):
                place = "" if around is None else f" between {around[0]!r} and {around[1]!r}"
                warn(f"left out: {file}: no number{place} in its name says which pattern it shows")
                continue
            number = int(parts[2]) - begin
            # Numbers may go on from those of the capture. Any others are those of another count.
            if number < 0 or (around is None and number >= 2 * count):
                raise InputError(
                    f"{file}: is no number of a pattern, as that of the first one is {begin}",
                    hint=f"state the number of the first pattern: first={parts[2]}",
                )
            files.suffix, around = file.suffix.lower(), parts.group(1, 3)
            one = replace(capture.select([number % count]), frames=ArrayStack(levels[None]))
            yield self._add(one, str(file), number % count)
            last = time.monotonic()

    @property
    def transport(self) -> LightTransport:
        """T now.

        Its diagnostics have the photograph with which each row changed (`since`, 0: none) and
        whether it is `unknown`, with an estimated error and a prediction error of 1. Those of other
        rows that changed are what they missed the last photographs by.
        """
        changed, unknown, window = self.since > 0, self._unknown, [each for _, each in self._window]
        diagnostics = {name: values.copy() for name, values in self._given.diagnostics.items()}
        for name, values in diagnostics.items():
            # Rows that were solved again have converged.
            values[changed] = np.nan if values.dtype.kind == "f" else name == "converged"

        def state(name: str, values: NDArray[Any] | float) -> None:
            before = diagnostics.get(name, np.full(len(changed), np.nan))
            diagnostics[name] = np.where(changed, values, before).astype(np.float32)

        # At least a tenth of what they missed counts as error, as elsewhere.
        wrong = np.maximum(self._lately - self._noise, 0.1 * self._lately)
        state("estimated_error", np.where(unknown, 1, np.sqrt(wrong) / (self._length + 1e-12)))
        # Only some rows are looked at, evenly spread.
        looked_at = self._given.diagnostics.get("certain", np.nan)
        state("certain", np.where(unknown, 0 * looked_at, np.nan))
        if window:
            seen = np.mean([np.square(each.values[:, 0]) for each in window[-_JUDGED:]], axis=0)
            # Photographs without light show nothing but noise.
            missed = np.sqrt(self._lately / np.maximum(seen, self._noise + 1e-12))
            state("prediction_error", np.where(unknown, 1, missed))
            after, clipped = self._clipped
            state("clipped_share", clipped.sum(axis=0) / np.maximum(after.sum(axis=0), 1))
        diagnostics |= {"since": self.since.copy(), "unknown": unknown.astype(np.float32)}
        return replace(
            self._given, sparse=self._light.coefficients, background=self._light.background,
            diagnostics=diagnostics,
            provenance={**self._given.provenance, "tracked_photographs": self.photographs},
        )  # fmt: skip

    def _add(self, one: Capture, name: str, pattern: int) -> Update:
        """Take in a photograph, wholly or, if Ctrl-C comes meanwhile, not at all."""
        started = time.perf_counter()
        after = copy(self)
        arrays = {key: each for key, each in vars(self).items() if isinstance(each, np.ndarray)}
        vars(after).update({key: each.copy() for key, each in arrays.items()})
        maps, missed = after._take_in(one)
        vars(self).update(vars(after))
        seconds = time.perf_counter() - started
        update = Update(self.photographs, name, pattern, *maps, missed, seconds)
        lost = float(update.unknown.mean())
        if not self._doubted and lost > 0.5:
            self._doubted = True
            question = "are the photographs out of step with the patterns?"
            warn(f"photograph {self.photographs}: {percent(lost)} of the rows unknown; {question}")
        return update

    def _take_in(self, one: Capture) -> tuple[tuple[NDArray[np.bool_], NDArray[np.bool_]], float]:
        """The maps of what changed and is unknown, and what all other rows missed."""
        self.photographs += 1
        known, latest = ~self._unknown, one.samples()
        weights = frame_weights(np.array([self._longest, one.exposures[0]]))
        weights = latest.weights_of_all() * (1 if weights is None else weights[1])
        latest = replace(latest, weights=weights, clip_level=latest.clip_levels_of_all())
        shown = one.patterns.dense()
        self._window = (*self._window, (shown[0], latest))[-self._capture.count :]
        missed = _squares(latest, self._predicted(self._light, shown))[:, 0]
        # Rows that were never explained within the window may have changed again meanwhile.
        changed = self._changes(missed) & (known | ~self._learning)
        self.since[changed] = self._began[changed]
        self._own[changed] = 0
        self._missed = np.concatenate([self._missed[1:], missed[None]])
        self._missed[:, changed] = np.inf
        # Rows that were not solved since they changed have predicted nothing.
        self._missed[-1, self._learning & (self._seen_by <= _FIRST)] = np.inf
        # If no T explains the photographs since a change, there was another one meanwhile.
        misfit = np.maximum(self._misfit, self._around(self._misfit))
        lost = ~known & (self._seen_by > 2 * _SEARCHED) & (misfit > _RATIO * self._usual)
        # Nor does the window hold photographs of a row that it left unknown, so it begins anew.
        lost |= ~known & ~self._learning
        self.since[lost] = self.photographs + 1 - _SEARCHED
        self._solve()
        right = known & ~changed & latest.counted[:, 0]
        least = right.sum() * np.mean(self._noise) + 1e-12
        error = np.sqrt(missed[right].sum() / max(np.square(latest.values[right]).sum(), least))
        shape, unknown = self._given.camera_shape, self._unknown
        return (changed.reshape(shape), unknown.reshape(shape)), float(error)

    def _predicted(self, light: SparseRows, shown: NDArray[np.float32]) -> NDArray[np.float32]:
        """What rows of T show under patterns (k, N), (m, k)."""
        diffuse = light.background @ (self._given.pooling @ shown.T)
        return np.asarray(light.coefficients @ shown.T + diffuse, np.float32)

    def _around(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Means over squares of three camera pixels a side, (M,)."""
        image = values.reshape(self._camera).astype(np.float64)
        return np.asarray(scipy.ndimage.uniform_filter(image, (3, 3, 1), mode="nearest").ravel())

    def _changes(self, missed: NDArray[np.float32]) -> NDArray[np.bool_]:
        """The rows that have changed by now, (M,)."""
        self._began[self._region == 0] = self.photographs
        # Rows that are learned anew miss more at first.
        usual = np.where(self._learning, np.maximum(self._usual, self._lately), self._usual)
        # What is not known yet says nothing of the rows beside it.
        around = self._around(np.where(self._unknown, 0, missed))
        for sums, misses in ((self._own, missed), (self._region, around)):
            sums += ((1 - 1 / _RATIO) * misses / usual - np.log(_RATIO)) / 2
            # From the largest sum it falls to zero within a dozen photographs.
            np.clip(sums, 0, 2 * _REGION, out=sums)
        return (self._region > _REGION) & (self._own > _ROW)

    @property
    def _seen_by(self) -> NDArray[np.int64]:
        """How many photographs show each row as it is since it changed, (M,)."""
        return self.photographs + 1 - self.since

    @property
    def _learning(self) -> NDArray[np.bool_]:
        """Rows that changed within the window, (M,)."""
        return (self.since > 0) & (self._seen_by <= self._capture.count)

    @property
    def _lately(self) -> NDArray[np.float64]:
        """Mean squares by which rows, or the regions around them, missed the last photographs."""
        misses = self._missed.mean(axis=0)
        return np.maximum(misses, self._around(np.where(np.isfinite(misses), misses, 0)))

    @property
    def _unknown(self) -> NDArray[np.bool_]:
        # From an error of 0.2 on an estimate is called doubtful. Three standard deviations of the
        # camera's noise are no error.
        unknown = ~(self._lately <= (0.2 * self._length) ** 2 + 9 * self._noise)
        # Any light explains photographs that clip, even none.
        if self._window:
            after, clipped = self._clipped
            unknown |= (after & ~clipped).sum(axis=0) < _JUDGED
        return (self.since > 0) & unknown

    @property
    def _clipped(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which photographs show a row as it is now, and which of them clip, (k, M)."""
        after = np.arange(1 - len(self._window), 1)[:, None] + self.photographs >= self.since
        return after, np.array([each.clipped[:, 0] for _, each in self._window]) & after

    def _solve(self) -> None:
        """Solve the rows that changed with the photographs since then."""
        rows = np.flatnonzero(self._learning & (self._seen_by >= _FIRST))
        if not len(rows):
            return
        seen_by = self._seen_by[rows]
        most = int(seen_by.max())
        last, seen = zip(*self._window[-most:], strict=True)
        shown = np.stack(last)
        samples = Samples(
            *(
                np.concatenate([getattr(each, name)[rows] for each in seen], axis=1)
                for name in ("values", "clipped", "clip_level", "weights")
            )
        )
        weights = samples.weights_of_all() * (np.arange(most) >= most - seen_by[:, None])
        samples = replace(samples, weights=weights)
        # The part of the camera around them, where other rows stand as they are in T.
        row, col, _ = np.unravel_index(rows, self._camera)
        top, left = (max(0, int(each.min()) - 2 * REACH) for each in (row, col))
        part = np.arange(len(self.since)).reshape(self._camera)[
            top : row.max() + 2 * REACH + 1, left : col.max() + 2 * REACH + 1
        ]
        camera, part = part.shape, part.ravel()
        patterns = ImagePatterns(shown.reshape(most, *self._given.projector_shape))
        capture = capture_of_samples(patterns, samples, camera[:2], self._longest)
        first, solver = self._solver, replace(self._solver, capture=capture)
        # Atoms under unseen patterns are made once, since the gains stay those of the first atoms.
        atoms = AtomPatterns(patterns, first.atoms.sizes, first.atoms.gains)
        vars(solver).update(atoms=atoms, unseen=first.unseen)
        light = self._light.rows(part)
        matrix = light.coefficients
        usable = np.repeat(~self._learning[part], np.diff(matrix.indptr))
        data = (matrix.data * usable / atoms.gains[0]).astype(np.float32)
        shape = (len(part), atoms.pixels)
        matrix = scipy.sparse.csr_array((data, matrix.indices, matrix.indptr), shape=shape)
        matrix.eliminate_zeros()
        beside = SparseRows(matrix, light.background.sum(axis=1, keepdims=True))
        # Rows that are not known are searched; of others the last estimate is the start.
        search = (seen_by <= _SEARCHED) | self._unknown[rows]
        fresh, again = np.flatnonzero(search), np.flatnonzero(~search)
        found = self._search(solver, samples.rows(fresh), rows[fresh])
        before = self._atoms.rows(np.searchsorted(self._rows, rows[again]))
        order = np.argsort(np.concatenate([fresh, again]))
        now = (SparseRows.joined([found, before]) if len(again) else found).rows(order)
        places, known = np.searchsorted(part, rows), list[NDArray[np.float32]]()
        for this_round in _ROUNDS:
            due = np.arange(len(rows)) if this_round.last else fresh
            if len(due):
                around = beside.replaced(places, now)
                neighbours = Neighbourhood(around, camera, atoms, known_jacobians=known)
                known = [neighbours.jacobian]
                solved, _ = solver.near(samples.rows(due), places[due], this_round, neighbours)
                now = now.replaced(due, _lit(solved))
        shares = solver.backgrounds.spread(scipy.sparse.csr_array(neighbours.centres[places]))
        background = solved.background[:, None] * shares
        if solved.cells.shape[1]:
            background += solved.cells
        new = SparseRows(atoms.expand(now.coefficients), background.astype(np.float32))
        squares = _squares(samples, self._predicted(new, shown)).sum(axis=1)
        self._misfit[rows] = squares / np.maximum(weights.sum(axis=1), 1e-9)
        self._length[rows] = atoms.single_contrast * solver.backgrounds.lengths(new)
        self._light = self._light.replaced(rows, new)
        self._rows, self._atoms = rows, now

    def _search(self, solver: RowSolver, samples: Samples, rows: NDArray[np.int64]) -> SparseRows:
        """Rows by themselves, on the atoms where their light may be."""
        shape, planes = solver.capture.projector_shape, solver.atoms.planes
        plane = np.repeat(np.arange(planes) * (shape[0] * shape[1]), len(self._steps))
        # Indices of 64 MiB at a time.
        step, parts = max(1, (1 << 23) // len(plane)), []
        for start in range(0, max(1, len(rows)), step):
            some = slice(start, start + step)
            place = self._centres[rows[some] // self._camera[2], None] + self._steps
            inside = np.tile(((place >= 0) & (place < shape)).all(axis=2), planes)
            index = (np.tile(place @ (shape[1], 1), planes) + plane)[inside].astype(np.int32)
            ends = np.append(0, np.cumsum(inside.sum(axis=1)))
            atoms = Candidates(ends, index, np.ones(len(index), np.float32))
            problem = solver.first_problem(samples.rows(some))
            none = Cells.none(solver.capture.patterns)
            parts.append(_lit(solve_weighted(problem, atoms, none, solver.solver)))
        return SparseRows.joined(parts)


def _squares(samples: Samples, predicted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weighted squares of what predictions miss, (m, k); clipped samples are lower bounds."""
    off = samples.values - predicted
    off[samples.clipped & (off < 0)] = 0
    return np.asarray(np.square(off) * samples.weights_of_all())


def _lit(solved: Result) -> SparseRows:
    """Solved rows with one background each, as their neighbours see them."""
    rows = solved.rows.single()
    return SparseRows(rows.coefficients, rows.background[:, :1])


def _parallax(transport: LightTransport) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where light of camera pixels may lie in the projector, by what T knows of the scene.

    That of a plane lies where a homography says, (P, 2). Depth moves it from there along a line:
    (J, 2) are the steps that occur, and three pixels more.
    """
    matches = correspondence(transport)
    assert matches.light is not None
    lit = matches.light > 0.02 * np.quantile(matches.light, 0.99)
    if lit.sum() < 4:
        raise InputError("a matrix without light", hint="take photographs of a lit scene")
    camera = np.moveaxis(np.indices(lit.shape, np.float64), 0, -1)
    place = matches.place[lit].astype(np.float64)
    plane = fit_homography(camera[lit], place, np.ones(len(place)))
    off = place - moved(plane, camera[lit])
    _, axes = np.linalg.eigh(off.T @ off)
    # A hundredth of the rows on either side may be wrong.
    low, high = np.quantile(off @ axes, (0.01, 0.99), axis=0)
    reach = int(np.ceil(np.hypot(*np.maximum(-low, high)))) + 4
    steps = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1).T - reach
    inside = ((steps @ axes >= low - 3) & (steps @ axes <= high + 3)).all(axis=1)
    return np.rint(moved(plane, camera.reshape(-1, 2))).astype(np.int64), steps[inside]
