"""The default estimate on other rigs: out of focus, turned, coarser, noisier, coded, in colour."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from experiments.harness import Experiment, Measured, Row, all_rows, means
from experiments.measured_scene import SCENES
from experiments.other_cameras import depth_blur, mapped, seen, varying_defocus
from experiments.responses import S_CURVE, camera_of, photographed
from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.found_response import with_response
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.errors import InputError
from lightmatrix.estimators.colour import estimate_colour
from lightmatrix.estimators.estimate import estimate
from lightmatrix.files.colours import COLOURS as PRIMARIES
from lightmatrix.judgement.judgement import OwnError
from lightmatrix.judgement.metrics import relighting_error, squared_errors, unseen_patterns
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.colour import ColourPatterns, colour_bernoulli
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, save
from lightmatrix.planning.plan import plan
from lightmatrix.simulation import library
from lightmatrix.simulation.realism import camera_defocus, defocus, in_all_primaries, of_primary
from lightmatrix.simulation.simulate import SimulatedCapture, simulate
from lightmatrix.simulation.truth import Truth, binned
from lightmatrix.transport.matrix import LightTransport

# "Tinted" surfaces have a random colour in each square of this many camera pixels.
SQUARE = 8
# How much of red, green and blue light the surface passes on that tints global light.
OTHER_SURFACE = (0.3, 1.0, 0.6)


def tinted(truth: Truth, other: bool = False) -> Truth:
    """T of a colour projector, with surfaces of random colours.

    With `other`, all global light is tinted once more, by a colour that direct light never has.
    """
    wide = in_all_primaries(truth)
    rows, cols, channels = wide.camera_shape
    squares = np.random.default_rng(5).uniform(
        0.25, 1, (-(-rows // SQUARE), -(-cols // SQUARE), channels)
    )
    surface = np.kron(squares, np.ones((SQUARE, SQUARE, 1)))[:rows, :cols].reshape(-1)
    of_global = np.tile(OTHER_SURFACE if other else np.ones(channels), rows * cols)
    entries = np.diff(wide.matrix.indptr)
    direct = wide.direct_data * np.repeat(surface, entries)
    rest = (wide.matrix.data - wide.direct_data) * np.repeat(surface * of_global, entries)
    data = (direct + rest).astype(np.float32)
    return replace(wide, matrix=wide.with_data(data), direct_data=direct.astype(np.float32))


# From T of a grey scene to that of a colour projector and camera, and whether some photographs are
# grey: half of them, at most 16.
COLOUR_RIGS: dict[str, tuple[Callable[[Truth], Truth], bool]] = {
    "colour": (in_all_primaries, True),
    "colour, none grey": (in_all_primaries, False),
    "colour, tinted surfaces": (tinted, True),
    "colour, tinted global light": (lambda truth: tinted(truth, other=True), True),
}


def colour_capture(
    truth: Truth, count: int, exposure: float | str, *, grey: bool = True, seed: int = 0
) -> SimulatedCapture:
    """`count` photographs of a colour projector, some of them under grey patterns."""
    rows, wide = truth.projector_shape
    patterns = colour_bernoulli((rows, wide // 3), count, grey=None if grey else 0, seed=seed)
    return simulate(truth, patterns, exposure=exposure, seed=seed)


SIDE = 128
COUNTS = (16, 32, 64)
# Photographs of colour rigs, the grey ones included. Each takes three estimates, so fewer counts.
COLOUR_COUNTS = (32, 64)
SEEDS = (0, 1, 2)
# These rigs are measured with all seeds, the others with the first one.
SEVERAL = ("sharp", "blur 1", "blur 2", "blur 0 to 2", "camera 2x coarser", "camera 4x coarser")
# The error axis of the figure.
ERRORS = (0.005, 2.0)
ERROR_TICKS = (0.01, 0.1, 1)
# Rows darker than this share of the brightest row (in norm) are left out of the comparison of
# estimated and true errors.
LEAST_LIGHT = 1e-3
# What is measured of a case.
KEPT = (
    "relative_error",
    "relighting_error",
    "estimated_error",
    "footprint",
    "seconds",
    "full_frame",
)
NOTHING = np.empty(0, np.float32)
# A wrong response bends the samples by at most this share of the clip level.
RESPONSE_ERROR = 0.05


Shape = tuple[int, int]


def _places(shape: Shape) -> NDArray[np.int64]:
    return np.arange(shape[0] * shape[1]).reshape(shape)


def _sides(truth: Truth) -> Shape:
    return truth.camera_shape[0], truth.camera_shape[1]


def _cut_out(shape: Shape) -> NDArray[np.int64]:
    rows, cols = (slice(side // 4, 3 * side // 4) for side in shape)
    return _places(shape)[rows, cols]


def _turned(shape: Shape, degrees: float) -> NDArray[np.int64]:
    angle = np.deg2rad(degrees)
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return mapped(shape, turn)


# Cameras that see the scene differently: the camera pixel of the scene's T that each pixel is.
VIEWS: dict[str, Callable[[Shape], NDArray[np.int64]]] = {
    "cut-out": _cut_out,
    "quarter turn": lambda shape: np.rot90(_places(shape)),
    "mirrored": lambda shape: _places(shape)[:, ::-1],
    "10 degrees": lambda shape: _turned(shape, 10),
    "keystone": lambda shape: mapped(shape, np.array([[1, 0, 0], [0, 1, 0], [0.2, 0.1, 1]])),
}
# Changes of the scene's T.
CHANGED: dict[str, Callable[[Truth], Truth]] = {
    "sharp": lambda truth: truth,
    "blur 0.7": lambda truth: defocus(truth, 0.7),
    "blur 1": lambda truth: defocus(truth, 1.0),
    "blur 2": lambda truth: defocus(truth, 2.0),
    "blur 4": lambda truth: defocus(truth, 4.0),
    "camera blur 0.7": lambda truth: camera_defocus(truth, 0.7),
    "camera blur 1": lambda truth: camera_defocus(truth, 1.0),
    "camera blur 2": lambda truth: camera_defocus(truth, 2.0),
    "blur 0 to 2": lambda truth: varying_defocus(truth, depth_blur(truth, 2.0)),
    "camera 2x coarser": lambda truth: binned(truth, 2, 1),
    "camera 4x coarser": lambda truth: binned(truth, 4, 1),
    "camera 2x finer": lambda truth: binned(truth, 1, 2),
}
# Changes of the photographs, as arguments of `simulate`.
PHOTOGRAPHED: dict[str, dict[str, Any]] = {
    "room light 0.2": {"ambient": 0.2},
    "leak 0.005": {"leak": 0.005},
    "noise 0.01": {"noise": 0.01},
    "noise 0.03": {"noise": 0.03},
    "12 bits, shot noise": {"bits": 12, "noise": 0.001, "full_well": 40_000},
    "full well of 10,500": {"full_well": 10_500},
    "full well of 2,000": {"full_well": 2_000},
    "response off by 5 %": {},
}
# Cameras, and projectors of random grey patterns, that are not linear: the camera's response, and
# the projector's gamma (0 for black and white patterns). `estimate` finds them in the photographs.
UNKNOWN: dict[str, tuple[str, float]] = {
    "gamma 2.2, found": ("gamma:2.2", 0.0),
    "sRGB, found": ("srgb", 0.0),
    "S-curve, found": (S_CURVE, 0.0),
    "projector of gamma 2.2, found": ("linear", 2.2),
    "both of gamma 2.2, found": ("gamma:2.2", 2.2),
}
RIGS = (*CHANGED, *VIEWS, *PHOTOGRAPHED, *UNKNOWN, *COLOUR_RIGS)


@dataclass(frozen=True)
class Case:
    """One estimate of one capture of one rig."""

    scene: str
    rig: str
    patterns: int
    seed: int = 0
    side: int = SIDE

    @property
    def name(self) -> str:
        """A file name."""
        rig = "".join(c if c.isalnum() else "-" for c in self.rig)
        return f"{self.scene}-{self.side}-{rig}-k{self.patterns}-s{self.seed}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases, the first seed of all of them first."""
    if quick:
        for rig in ("sharp", "blur 1", "colour"):
            yield Case("l_objects", rig, 32, side=64)
        return
    for rig in RIGS:
        for scene in SCENES:
            for count in COLOUR_COUNTS if rig in COLOUR_RIGS else COUNTS:
                yield Case(scene, rig, count)
    for seed in SEEDS[1:]:
        for rig in SEVERAL:
            for scene in SCENES:
                for count in COUNTS:
                    yield Case(scene, rig, count, seed)


def measure(case: Case) -> Measured:
    """Errors of one case, and the estimated ones."""
    truth = rig_truth(case.scene, case.rig, case.side)
    capture = rig_capture(case, truth)
    started = time.perf_counter()
    try:
        matrices = _estimated(capture)
    except InputError:
        if case.rig in UNKNOWN:
            return _undetermined(case)
        raise
    seconds = time.perf_counter() - started
    known = [truth.transport()]
    if case.rig in COLOUR_RIGS:
        known = [of_primary(known[0], primary) for primary in PRIMARIES]
    pairs = zip(matrices, known, strict=True)
    # The light of the primaries adds up, so a row has the squared errors of all matrices.
    wrong, total = np.sum([squared_errors(*pair) for pair in pairs], axis=0)
    patterns = np.stack(list(unseen_patterns(known[0].projector_shape).values()))
    # The matrices of a colour projector state the errors of one geometry.
    first = matrices[0]
    row = {
        **asdict(case),
        "relative_error": float(np.sqrt(wrong.sum() / total.sum())),
        "relighting_error": relighting_error(matrices, known, patterns),
        "estimated_error": OwnError(first).estimated,
        "footprint": float(np.median(first.diagnostics["footprint"])),
        "seconds": seconds,
        "full_frame": float("nan"),
    }
    if case.rig in VIEWS:
        row["full_frame"] = _same_rows(case)
    lit = total > LEAST_LIGHT**2 * total.max()
    errors = np.sqrt(wrong[lit] / total[lit])
    arrays = {"errors": errors, "stated": first.diagnostics["estimated_error"][lit]}
    return Measured([row], {name: values.astype(np.float32) for name, values in arrays.items()})


def _undetermined(case: Case) -> Measured:
    """The row of photographs that do not determine the responses, which `estimate` refuses."""
    unknown = dict.fromkeys(KEPT, float("nan"))
    return Measured([{**asdict(case), **unknown}], dict.fromkeys(("errors", "stated"), NOTHING))


def _estimated(capture: Capture) -> list[LightTransport]:
    """The matrix of a capture, or those of a colour projector."""
    if isinstance(capture.patterns, ColourPatterns):
        return list(estimate_colour(capture))
    return [estimate(capture)]


@lru_cache(maxsize=2)
def rig_truth(scene: str, rig: str, side: int) -> Truth:
    """T of a scene as a rig sees it."""
    truth = library.truth(scene, (side, side))
    if rig in VIEWS:
        return seen(truth, VIEWS[rig](_sides(truth)))
    if rig in COLOUR_RIGS:
        of_projector, _ = COLOUR_RIGS[rig]
        return of_projector(truth)
    return CHANGED[rig](truth) if rig in CHANGED else truth


def rig_capture(case: Case, truth: Truth) -> Capture:
    """The capture of a case, exposed as the planner advises."""
    options = dict(PHOTOGRAPHED.get(case.rig, {}))
    noise = options.get("noise", 0.003)
    # The planner knows grey rigs only. At its exposure a channel of the colour camera gets up to
    # 1.3 times the light that the grey one gets.
    planned = rig_truth(case.scene, "sharp", case.side) if case.rig in COLOUR_RIGS else truth
    exposure = plan(planned, frames=case.patterns, noise=noise).exposure
    if case.rig in COLOUR_RIGS:
        _, grey = COLOUR_RIGS[case.rig]
        return colour_capture(truth, case.patterns, exposure, grey=grey, seed=case.seed)
    if case.rig in UNKNOWN:
        return _with_unknown_response(case, truth, exposure)
    patterns = BernoulliPatterns(truth.projector_shape, case.patterns, seed=case.seed)
    capture = simulate(truth, patterns, exposure=exposure, seed=case.seed, **options)
    if case.rig != "response off by 5 %":
        return capture
    level = capture.sensor.clip_level
    frames = np.stack([capture.frames.read(k) for k in range(capture.count)]) / level
    bent = frames + 4 * RESPONSE_ERROR * frames * (1 - frames)
    stack = np.rint(np.minimum(bent, 1) * level).astype(np.uint8)
    return replace(capture, frames=ArrayStack(stack))


def _with_unknown_response(case: Case, truth: Truth, exposure: float | str) -> Capture:
    """Photographs that are not linear, in which `estimate` is to find the responses."""
    camera, projector = UNKNOWN[case.rig]
    capture, _ = photographed(
        truth, case.patterns, exposure, camera_of(camera), projector, case.seed
    )
    if camera != "linear":
        capture = with_response(capture, Response.parse("auto"))
    return replace(capture, projector_unknown=bool(projector))


def _same_rows(case: Case) -> float:
    """Relative error of the rows that a view shows, estimated in the full frame."""
    sharp = replace(case, rig="sharp")
    wrong, total = _full_frame(sharp)
    place = VIEWS[case.rig](_sides(rig_truth(sharp.scene, sharp.rig, sharp.side)))
    # Each row counts as often as the view shows it.
    rows = place[place >= 0]
    return float(np.sqrt(wrong[rows].sum() / total[rows].sum()))


# The cache serves all views, which are compared with the same full frames.
@lru_cache(maxsize=len(SCENES) * len(COUNTS))
def _full_frame(case: Case) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared errors and energies of all rows of the unchanged rig."""
    truth = rig_truth(case.scene, case.rig, case.side)
    return squared_errors(estimate(rig_capture(case, truth)), truth.transport())


def _summary(rows: list[Row]) -> list[Row]:
    """The means over the seeds."""
    return means(rows, ("rig", "scene", "patterns"), KEPT)


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """Draw the errors of all rigs, and the estimated against the true errors of rows."""
    _draw_errors(out, _summary(all_rows(results)))
    true, estimated = (
        np.concatenate([measured.arrays[name] for _, measured in results])
        for name in ("errors", "stated")
    )
    _draw_confidence(out, true, estimated)


def _draw_errors(out: Path, rows: list[dict[str, Any]]) -> None:
    rigs = list(dict.fromkeys(row["rig"] for row in rows))
    with figure(7.2, 0.24 * len(rigs) + 1.6) as drawing:
        panels = np.atleast_1d(drawing.subplots(1, len(SCENES), sharex=True, sharey=True))
        for axes, (scene, title) in zip(panels, SCENES.items(), strict=True):
            for number, count in enumerate(COUNTS):
                points = [r for r in rows if r["scene"] == scene and r["patterns"] == count]
                errors = [r["relative_error"] for r in points]
                places = [rigs.index(r["rig"]) for r in points]
                style = {"color": COLOURS[number], "markersize": 4, "label": f"K = {count}"}
                axes.plot(errors, places, "os^"[number], **style)
            axes.set_xscale("log")
            axes.set_xlim(*ERRORS)
            fix_ticks(axes.xaxis, ERROR_TICKS)
            axes.grid(axis="both", color="0.92", linewidth=0.6)
            axes.set_title(title)
            axes.set_xlabel("relative error of T")
        panels[0].set_yticks(range(len(rigs)), rigs)
        panels[0].invert_yaxis()
        handles, labels = panels[0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=len(COUNTS))
        save(drawing, out, "rigs", ("png", "svg"))


def _draw_confidence(out: Path, true: NDArray[np.float32], estimated: NDArray[np.float32]) -> None:
    with figure(3.6, 3.4) as drawing:
        axes = drawing.subplots()
        known = np.isfinite(estimated) & (estimated > 0) & (true > 0)
        correlation = spearmanr(true[known], estimated[known]).statistic
        axes.set_title(f"rank correlation {correlation:.2f}")
        limits = (-3.0, 1.0)
        counts = axes.hexbin(
            np.log10(true[known]), np.log10(estimated[known]), gridsize=50, bins="log",
            extent=(*limits, *limits), cmap="viridis", linewidths=0,
        )  # fmt: skip
        axes.plot(limits, limits, color="0.5", linewidth=0.8)
        ticks = range(-3, 2)
        axes.set_xticks(ticks, [f"{10.0**t:g}" for t in ticks])
        axes.set_yticks(ticks, [f"{10.0**t:g}" for t in ticks])
        axes.set_xlabel("relative error of a row")
        axes.set_ylabel("estimated error of the row")
        drawing.colorbar(counts, label="rows")
        save(drawing, out, "confidence", ("png", "svg"))


RIGS_EXPERIMENT = Experiment("rigs", cases, measure, _draw, summary=_summary)
