"""Error against the number of photographs, from 6 to 4,096, by patterns, with peers.

Scenes have 32 x 32 pixels of camera and projector, so that 1,024 photographs determine T. They are
exposed as `plan` advises for the number of frames (one-pixel patterns so that no entry clips), with
8 bits and noise of 0.003 of the clip level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from experiments.harness import Experiment, Measured, all_rows
from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.estimators.estimate import estimate
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, save
from lightmatrix.planning.plan import plan
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport

SCENES = ("l_objects", "gripper", "metal", "corner")
SIZE = (32, 32)
# The estimates of this package by pattern kind, and the numbers of patterns of each.
RANDOM = (16, 24, 32, 64, 128, 256, 512, 1024, 2048, 4096)
KINDS = {
    "grey": (6, 7, 8, 10, 12, 14),
    "black and white": (8, 12, *RANDOM),
    "mix": (64, 128, 256, 512, 1024),
    "hadamard": (256, 512, 1024),
    "onepixel": (1024,),
}
# Peers, under random patterns and one pixel at a time.
PEERS = {
    "oracle": (6, 8, 10, 12, *RANDOM[:-1]),
    "least squares": (16, 64, 256, 512, 1024, 2048, 4096),
    "read directly": (1024,),
}
ERROR_TICKS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1)


@dataclass(frozen=True)
class Case:
    """One estimate of one capture."""

    scene: str
    kind: str
    patterns: int

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.scene}-{self.kind.replace(' ', '-')}-k{self.patterns}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run has few."""
    for scene in SCENES[:1] if quick else SCENES:
        for kind, counts in {**KINDS, **PEERS}.items():
            yield from (Case(scene, kind, k) for k in ((8,) if quick else counts) if k in counts)


@cache
def _truth(scene: str) -> Truth:
    return library.truth(scene, SIZE)


def measure(case: Case) -> Measured:
    """The error of one case, and the one that it states."""
    truth = _truth(case.scene)
    capture = _photographed(truth, case)
    if case.kind in KINDS:
        made = estimate(capture, check=False, correct="none", progress=False)
        stated = OwnError(made).stated
    else:
        made, stated = _PEERS[case.kind](truth, capture), None
    error = relative_error(made, truth.transport())
    return Measured([{**asdict(case), "relative_error": error, "stated": stated}])


def _patterns(case: Case) -> PatternSet:
    kind = {"grey": "random", "black and white": "bernoulli", "least squares": "bernoulli"}
    kind |= {"oracle": "random", "read directly": "onepixel"}
    levels = 4 if case.kind in ("grey", "oracle") and case.patterns < 16 else None
    return make_patterns(kind.get(case.kind, case.kind), SIZE, case.patterns, levels=levels)


def _photographed(truth: Truth, case: Case) -> Capture:
    patterns = _patterns(case)
    if case.kind in ("onepixel", "read directly"):
        # Dark rows are many times darker than the brightest entry, so that glints may clip.
        exposure: float | str = float(0.9 / np.quantile(truth.matrix.max(axis=1).toarray(), 0.999))
    else:
        exposure = plan(truth, frames=max(8, case.patterns)).exposure
    return simulate(truth, patterns, exposure=exposure, noise=USUAL_NOISE)


def _oracle(truth: Truth, capture: Capture) -> LightTransport:
    """Least squares on the strongest entries of each row of the truth, the best number of them."""
    columns, samples = capture.patterns.dense(), capture.samples()
    rows = truth.matrix.toarray()
    result = np.zeros_like(rows)
    for row, out, values, clipped in zip(
        rows, result, samples.values, samples.clipped, strict=True
    ):
        order, seen, best = np.argsort(-row)[:48], ~clipped, math.inf
        matrix = np.column_stack([capture.patterns.means, columns[:, order]])[seen]
        gram, along = matrix.T @ matrix, matrix.T @ values[seen]
        for number in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48):
            if number + 1 >= seen.sum():
                break
            used = slice(0, number + 1)
            found = np.linalg.lstsq(gram[used, used], along[used], rcond=1e-9)[0]
            guess = np.full_like(row, found[0] / row.size)
            guess[order[:number]] += found[1:]
            missed = float(np.linalg.norm(guess - row))
            if missed < best:
                best, out[:] = missed, guess
    return _transport(result, capture)


def _least_squares(truth: Truth, capture: Capture) -> LightTransport:
    """The shortest rows that explain the samples but for noise."""
    matrix = capture.patterns.dense().astype(np.float64)
    gram = matrix.T @ matrix
    gram.flat[:: len(gram) + 1] += 1.0
    return _transport(np.linalg.solve(gram, matrix.T @ capture.samples().values.T).T, capture)


def _read_directly(truth: Truth, capture: Capture) -> LightTransport:
    """Each photograph as a column of T."""
    return _transport(capture.samples().values, capture)


_PEERS = {"oracle": _oracle, "least squares": _least_squares, "read directly": _read_directly}


def _transport(rows: np.ndarray, capture: Capture) -> LightTransport:
    return LightTransport(
        csr_array(rows.astype(np.float32)),
        np.zeros((len(rows), 1), np.float32),
        capture.camera_shape,
        capture.projector_shape,
    )


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    rows = all_rows(results)
    styles = {
        "grey": (COLOURS[2], "-", "three or four grey levels"),
        "black and white": (COLOURS[0], "-", "black and white"),
        "mix": (COLOURS[4], "-", "fine and coarse mixed"),
        "hadamard": (COLOURS[3], "-", "Hadamard"),
        "onepixel": (COLOURS[5], "-", "one pixel at a time"),
        "oracle": ("0.4", ":", "oracle: places known"),
        "least squares": (COLOURS[6], "--", "least squares"),
        "read directly": (COLOURS[1], "--", "one pixel, read directly"),
    }
    with figure(7.2, 5.6) as drawing:
        panels = drawing.subplots(2, 2, sharex=True, sharey=True).ravel()
        for axes, scene in zip(panels, SCENES, strict=True):
            for kind, (colour, line, label) in styles.items():
                points = [
                    (row["patterns"], min(row["relative_error"], 1.5))
                    for row in rows
                    if row["scene"] == scene and row["kind"] == kind
                ]
                if points:
                    k, error = zip(*sorted(points), strict=True)
                    axes.plot(k, error, line, color=colour, marker="o", markersize=3, label=label)
            axes.set_xscale("log", base=2)
            axes.set_yscale("log")
            fix_ticks(axes.yaxis, ERROR_TICKS)
            axes.grid(axis="y", color="0.92", linewidth=0.6)
            axes.set_xticks([8, 16, 64, 256, 1024, 4096], ["8", "16", "64", "256", "1024", "4096"])
            axes.set_title(scene)
        for axes in panels[2:]:
            axes.set_xlabel("photographs K")
        for axes in panels[::2]:
            axes.set_ylabel("relative error of T")
        handles, labels = panels[0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=3)
        save(drawing, out, "numbers", ("png", "svg"))


NUMBERS = Experiment("numbers", cases, measure, _draw)
