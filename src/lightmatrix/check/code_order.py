"""Whether the frames of a code of stripes are in order, and which one is missing.

The frames of a code predict nothing of each other: each bit of a Gray code is needed. But scenes
consist of surfaces, so neighbouring camera pixels see neighbouring projector pixels. Decoded in a
wrong order, they see distant ones, and phases that do not belong together fit no place. Each likely
order is judged by how much nearer neighbours then see to each other.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.finding import WRONG_ORDER, Finding, join_names, order_findings
from lightmatrix.check.relation import frames_of, likely_orders
from lightmatrix.check.survey import Survey
from lightmatrix.errors import InputError
from lightmatrix.patterns.codes import Code, Codes, correlate, find_codes
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import COLUMNS, ROWS

FrameOrder = NDArray[np.int64]
Name = Callable[[int], str]
# Another order explains more if what it gains exceeds this many standard errors. Chosen by hand:
# chance reaches 4 among a thousand orders.
CERTAIN = 8.0


@dataclass(frozen=True, eq=False)
class CodeLattice:
    """Camera pixels on a lattice over the image, in triples: a pixel, one below, one to the right.

    `samples` (K, 3 n) are those of the n pixels, then of their neighbours; `pairs` (2, p) lead from
    one to another, and the first `neighbours` of them to the next pixel. Codes of stripes and their
    patterns stand beside them.
    """

    patterns: PatternSet
    codes: Codes
    samples: NDArray[np.float32]
    pairs: NDArray[np.int64]
    neighbours: int

    @classmethod
    def of(cls, survey: Survey, most: int = 1500) -> "CodeLattice | None":
        """The lattice of a survey; None if its patterns are no code, or too few pixels vary."""
        try:
            codes = find_codes(survey.patterns)
        except InputError:
            return None
        tiles, rows, cols, channels = survey.grid
        step = int(np.ceil(np.sqrt(tiles * rows * cols / most)))
        # Each cell has one pixel at random, since stripes and a regular lattice interfere.
        down, right = np.maximum(np.array([rows - 1, cols - 1]) // step, 1)
        row, col = np.random.default_rng(0).integers(step, size=(2, tiles, down, right))
        row = np.minimum(row + step * np.arange(down)[:, None], rows - 2)
        col = np.minimum(col + step * np.arange(right), cols - 2)
        tile = np.arange(tiles)[:, None, None]
        grid = ((tile * rows + row) * cols + col) * channels + channels // 2
        known = survey.statistics
        usable = survey.valid & (known.highest > known.lowest)
        if not usable.any() or min(rows, cols) < 2:
            return None
        usable &= known.spread > 0.15 * np.quantile(known.spread[usable], 0.9)
        number = np.where(usable[grid], np.cumsum(usable[grid]).reshape(grid.shape) - 1, -1)
        first = grid[number >= 0]
        count = len(first)
        if count < 40:
            return None
        # Neighbours of the lattice tell of the coarsest bits, and those in the image of the finest.
        own = np.arange(count)
        steps = (cols * channels, channels)
        lit = [usable[first + step] for step in steps]
        near = [(own[also], own[also] + k * count) for k, also in enumerate(lit, 1)]
        far = [(number[:, 1:], number[:, :-1]), (number[:, :, 1:], number[:, :, :-1])]
        far = [(a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]) for a, b in far]
        chosen = np.concatenate([first, *(first + step for step in steps)])
        samples = np.ascontiguousarray(survey.samples(chosen).values.T)
        return cls(
            survey.patterns, codes, samples, np.hstack([*near, *far]), int(sum(map(np.sum, lit)))
        )

    def lines(
        self, code: Code, frames: FrameOrder
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The lines that each camera pixel may see, (1 or 2, m), and what is not explained, (m,).

        Frame `frames[p]` shows pattern p; -1 for a pattern whose frame is missing, whose bit is
        then 0 or 1.
        """
        missing = frames[code.frames] < 0
        if not code.bits:
            shown = frames[code.frames[~missing]]
            rest = Code(code.axis, shown, code.values[:, ~missing], code.starts, ())
            line, share = correlate(rest, np.ascontiguousarray(self.samples[shown].T))
            return line[:1], 1 - share[0]
        both = []
        for value in (-1e9, 1e9):
            # A missing frame is dark or bright, and both are possible.
            samples = np.vstack([self.samples, np.full((1, self.samples.shape[1]), value)])
            ends = {name: getattr(self.codes, name) for name in ("white", "black")}
            known = {k: None if p is None or frames[p] < 0 else p for k, p in ends.items()}
            both.append(Codes((code,), **known).lines(code, samples, frames))
            if not missing.any():
                break
        pairs = np.array([pair for pair in code.bits if pair[1] >= 0], np.int64).reshape(-1, 2)
        paired = frames[code.frames[pairs]]
        paired = paired[(paired >= 0).all(axis=1)]
        left = np.zeros(len(both[0]))
        if len(paired):
            # A pattern and its inverse add up to white.
            sums = self.samples[paired].sum(axis=1)
            whole = sums.mean(axis=0)
            left = np.abs(sums - whole).mean(axis=0) / np.maximum(whole, 1e-6)
        return np.stack(both), left

    def apart(
        self, code: Code, frames: FrameOrder
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How many lines apart pairs see, (p,), and the share not explained of each pixel, (m,).

        Infinity where the bits of one are no word of the code.
        """
        lines, left = self.lines(code, frames)
        a, b = lines[:, self.pairs[0]], lines[:, self.pairs[1]]
        apart = np.full(a.shape[1], np.inf)
        for one in a:
            for other in b:
                known = np.where((one < 0) | (other < 0), np.inf, np.abs(one - other))
                apart = np.minimum(apart, known)
        return apart, left

    @cached_property
    def usual(self) -> dict[int, NDArray[np.float64]]:
        """How many lines apart pairs usually see in the order as it is, by axis, (p,)."""
        result = {}
        for code in self.codes.codes:
            apart = self.apart(code, np.arange(self.patterns.count) % len(self.samples))[0]
            parts = apart[: self.neighbours], apart[self.neighbours :]
            medians = [
                np.median(part[np.isfinite(part)]) if np.isfinite(part).any() else 0.0
                for part in parts
            ]
            result[code.axis] = np.repeat(medians, [len(part) for part in parts])
        return result

    @property
    def invisible(self) -> NDArray[np.bool_]:
        """Which frames show stripes too fine to be seen, (K,): like their inverses, to 2 %."""
        result = np.zeros(len(self.samples), bool)
        for code in self.codes.codes:
            pairs = np.array([code.frames[[a, b]] for a, b in code.bits if b >= 0], np.int64)
            if len(pairs):
                one, other = self.samples[pairs.T]
                differ = np.median(np.abs(one - other), axis=1)
                result[pairs[differ < 0.02 * differ.max()]] = True
        return result

    @cached_property
    def shares(self) -> NDArray[np.float64]:
        """Samples between the lowest of their pixel, 0, and the highest one, 1."""
        low, high = self.samples.min(axis=0), self.samples.max(axis=0)
        return np.asarray((self.samples - low) / np.maximum(high - low, 1e-9))

    def possible(self, order: FrameOrder) -> NDArray[np.bool_]:
        """Which patterns their frames can show: white is bright, and black dark, in most pixels."""
        result = np.ones(len(order), bool)
        for k, bright in ((self.codes.white, True), (self.codes.black, False)):
            if k is not None and order[k] >= 0:
                mean = self.shares[order[k]].mean()
                result[k] = mean > 0.75 if bright else mean < 0.25
        return result

    @cached_property
    def twins(self) -> list[tuple[int, int]]:
        """Pairs of frames that show the same, although their patterns differ."""
        # Stripes that are too fine to be seen, or that lie beside what the camera sees, are alike.
        dark, bright = (self.shares < 0.25).mean(axis=1), (self.shares > 0.75).mean(axis=1)
        seen = (np.minimum(dark, bright) > 0.1) & ~self.invisible
        both = seen & seen[:, None]
        ends = self.codes.white, self.codes.black
        if ends[0] is not None and ends[1] is not None:
            both[ends] = both[ends[::-1]] = True
        pixels = np.random.default_rng(0).integers(self.patterns.pixels, size=1000)
        frames, patterns = (
            np.array([np.abs(each - all_).mean(axis=1) for each in all_])
            for all_ in (self.shares, self.patterns.at(pixels))
        )
        # Patterns count as different if their mean difference is a twentieth of white. Photographs
        # of different patterns differ by 0.4 of what the patterns do, or more; those of one pattern
        # differ by their noise, which is 0.03 to 0.07 of it where the noise is 1.5 % of the light.
        alike = both & (patterns > 0.05) & (frames < 0.2 * patterns)
        return [(int(a), int(b)) for a, b in np.argwhere(alike) if a < b]

    def cost(self, code: Code, frames: FrameOrder) -> NDArray[np.float64]:
        """How far apart pairs see, from 0 to 1, and how badly the code fits each pixel."""
        apart, left = self.apart(code, frames)
        # Up to the limit the cost is linear, so that nothing is gained by coarser lines.
        limit = np.maximum(8, 4 * self.usual[code.axis])
        return np.concatenate([np.minimum(apart / limit, 1), 0.3 * np.log(left + 0.03)])

    def costs(
        self, frames: FrameOrder, known: dict[bytes, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """The costs by all codes under an order; `known` keeps those of orders seen before."""
        parts = []
        for code in self.codes.codes:
            ends = [k for k in (self.codes.white, self.codes.black) if k is not None]
            used = frames[np.append(code.frames, ends).astype(np.int64)]
            key = bytes([code.axis]) + used.tobytes()
            if key not in known:
                known[key] = self.cost(code, frames)
            parts.append(known[key])
        return np.concatenate(parts)

    def unrelated(self, frames: FrameOrder) -> bool:
        """Whether neighbours in the image see no nearer to each other than any two pixels."""
        if self.neighbours < 40:
            return False
        shuffled = np.random.default_rng(0).permutation(self.samples.shape[1] // 3)
        near = []
        for code in self.codes.codes:
            lines, left = self.lines(code, frames)
            # Scrambled fibres have no neighbours, but each pattern and its inverse add up.
            if any(inverse >= 0 for _, inverse in code.bits) and np.median(left) < 0.1:
                return False
            line = lines[0]
            a, b = line[self.pairs[:, : self.neighbours]]
            quarter = np.quantile(np.abs(line[: len(shuffled)] - line[shuffled]), 0.25)
            near.append(float((np.abs(a - b) <= max(quarter, 1)).mean()))
        return max(near) < 0.4


def check_code_order(lattice: CodeLattice, name: Name) -> list[Finding]:
    """Whether another order of the frames fits better, or none does."""
    count = lattice.patterns.count
    frames = np.arange(count)
    known: dict[bytes, NDArray[np.float64]] = {}
    # Which costs in the order as it is come from words of the code.
    parts = [part for code in lattice.codes.codes for part in lattice.apart(code, frames)]
    read, invisible = np.isfinite(np.concatenate(parts)), lattice.invisible
    own = np.where(lattice.possible(frames), frames, -1)
    # The later of two that are the same may have the other's image; nothing is read from it then.
    own[[later for _, later in lattice.twins]] = -1
    best, best_order, found = 0.0, frames, list[Finding]()
    if lattice.twins:
        # One of the two is certainly wrong; nobody knows which, unless another order explains more.
        best_order = np.where(frames == lattice.twins[0][1], -1, frames)
        message = (
            f"{join_names([name(k) for k in lattice.twins[0]])} show the same, although their "
            "patterns differ"
        )
        advice = "take again the one that does not show its pattern"
        found = [Finding("order", lattice.twins[0], message, advice)]
    for shown, findings in _orders(lattice, name):
        order = frames_of(shown)
        # Any frames of coarser stripes fit better in the place of those that nobody can see.
        moved = order != frames
        if 2 * invisible[moved].sum() >= max(moved.sum(), 1):
            continue
        if not lattice.possible(order).all():
            continue
        # Pixels that cannot be read may lie beside the projector's image: they tell nothing.
        # A pattern that no frame shows is not read from its own frame either, for comparison.
        plain = lattice.costs(np.where(order < 0, -1, own), known)
        gain = np.where(read, plain - lattice.costs(order, known), 0)
        # Stray light differs a little from frame to frame, which many pixels show alike.
        gain[np.abs(gain) < 0.05] = 0
        total = float(gain.sum())
        certain = CERTAIN * float(np.sqrt((gain**2).sum()))
        if total > max(best, certain):
            best, best_order, found = total, order, findings
    if lattice.unrelated(best_order):
        message = (
            "the photographs do not follow the patterns: neighbouring camera pixels see places of "
            "the projector that have nothing to do with each other"
        )
        return [Finding("unrelated", (), message, WRONG_ORDER)]
    return found


def check_mirrored(lattice: CodeLattice) -> list[Finding]:
    """Whether most pixels see the projector turn to the other side than the camera's image."""
    if len(lattice.codes.codes) < 2:
        return []
    frames = np.arange(lattice.patterns.count)
    lines = {code.axis: lattice.lines(code, frames)[0][0] for code in lattice.codes.codes}
    # Those of a pixel, of the one below it and of the one to its right.
    row, col = (lines[axis].reshape(3, -1) for axis in (ROWS, COLUMNS))
    known = ((row >= 0) & (col >= 0)).all(axis=0)
    (down, right), (row_down, row_right) = (each[1:, known] - each[0, known] for each in (col, row))
    turns = np.sign(row_down * right - row_right * down)
    # Noise and edges of objects turn some the other way. A lattice has 40 pixels at least.
    if (turns < 0).sum() < max(40, 3 * (turns > 0).sum()):
        return []
    message = "the camera sees the projector's image mirrored"
    advice = (
        "fine behind a screen and in a mirror; otherwise patterns or photographs are flipped, or "
        "one of the coarsest patterns and its inverse are exchanged"
    )
    return [Finding("mirrored", (), message, advice)]


def _orders(lattice: CodeLattice, name: Name) -> Iterator[tuple[FrameOrder, list[Finding]]]:
    """The pattern that each frame shows, in likely wrong orders, and the findings of each."""
    count = lattice.patterns.count
    frames = np.arange(count)

    def displaced(first: int, last: int, step: int) -> tuple[FrameOrder, list[Finding]]:
        shown = frames + step * ((frames >= first) & (frames <= last))
        if first == last:
            return shown, order_findings({first: first + step}, name)
        message = (
            f"from {name(first)} to {name(last)}, each image shows the pattern "
            f"{'after' if step > 0 else 'before'} its own"
        )
        return shown, [Finding("order", tuple(range(first, last + 1)), message, WRONG_ORDER)]

    if repeated := [first for first, second in lattice.twins if second == first + 1]:
        # The first of the two is wrong if a frame before it was lost, else the second.
        for start in range(repeated[0] + 1):
            yield displaced(start, repeated[0], 1)
        yield displaced(repeated[0] + 1, count - 1, -1)
        return
    for message, shown in likely_orders(count):
        yield shown, [Finding("order", (), message, WRONG_ORDER)]
    for a, b in itertools.combinations(range(count), 2):
        shown = frames.copy()
        shown[[a, b]] = b, a
        yield shown, order_findings({a: b, b: a}, name)
    for start in range(1, count - 2):
        yield displaced(start, count - 1, 1)
        yield displaced(start + 1, count - 1, -1)


def missing_of_code(lattice: CodeLattice) -> tuple[int, ...]:
    """Which of K patterns has no frame among K - 1; several where nothing tells them apart."""
    frames = np.arange(lattice.patterns.count)
    known: dict[bytes, NDArray[np.float64]] = {}
    orders = [np.where(frames == place, -1, frames - (frames > place)) for place in frames]
    # A dark photograph in place of the white one would place all pixels at one line.
    possible = [lattice.possible(order).all() for order in orders]
    costs = [lattice.costs(order, known) for order in orders]
    sums = [cost.sum() for cost in costs]
    best = int(np.where(possible, sums, np.inf).argmin())
    likely = []
    for place in np.flatnonzero(possible):
        more = costs[place] - costs[best]
        if more.sum() <= 3 * np.sqrt((more**2).sum()):
            likely.append(int(place))
    for code in lattice.codes.codes if len(likely) == 1 else ():
        # Without its finest bit, a code is that without its coarsest one, of half the size.
        changes = code.changes
        if code.bits and likely[0] == code.frames[changes > 0][changes[changes > 0].argmin()]:
            likely.append(int(code.frames[changes.argmax()]))
    return tuple(likely) if len(likely) <= 4 else ()
