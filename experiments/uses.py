"""What T is for: how well the uses of an estimate work on the bundled scenes, with their peers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from experiments.harness import Experiment, Measured, Row, all_rows, means
from lightmatrix.estimators.estimate import estimate
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.pictures.style import COLOURS, figure, save
from lightmatrix.planning.plan import plan
from lightmatrix.simulation import library
from lightmatrix.simulation.realism import defocus
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.correspondence import REACH, correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.compensation import cancel_global, compensate, compensator
from lightmatrix.uses.separation import Separation, entries_of, separate

# The wanted picture is a white photograph of another scene; its brightest hundredth is white.
_PICTURE, _OTHER_PICTURE, _WHITE = "gripper", "l_objects", 0.99
# A pixel is reachable if more than this share of its white light is direct, and if what it wants is
# between the global light that it gets anyway and its light under white.
_DIRECT = 0.3


def wanted_picture(scene: str, side: int) -> NDArray[np.float32]:
    """A picture, (side, side) in [0, 1], that has nothing to do with the scene."""
    other = library.truth(_OTHER_PICTURE if scene == _PICTURE else _PICTURE, (side, side))
    image = np.asarray(other.matrix.sum(axis=1), np.float32).reshape(side, side)
    return np.clip(image / np.quantile(image, _WHITE), 0, 1)


def compensation_rows(estimate: LightTransport, truth: Truth, scene: str) -> list[Row]:
    """PSNR in dB of the true photographs under patterns by gains, by the estimate and by T.

    The error is relative to wanted white, over pixels that can be reached.
    """
    side = truth.camera_shape[0]
    wanted, known = wanted_picture(scene, side), truth.transport()
    found = compensate(estimate, wanted)
    shared = compensator(estimate)
    best = compensate(known, wanted, brightness=found.scale / _white_level(known))
    # All three are asked for the same light.
    target = found.target.ravel()
    gains = shared.light.split(np.clip(shared.start(target), 0, 1))[0]
    reachable = _reachable(truth, best.pattern, target) & shared.lit
    rows = [
        _row(scene, side, "compensate", "reachable share", float(reachable.mean())),
        _row(scene, side, "compensate", "brightness", found.brightness),
    ]
    shown = {"pixel gains": gains, "estimate": found.pattern, "true T": best.pattern}
    for method, pattern in shown.items():
        missed = (known.relight(pattern).ravel() - target)[reachable] / found.scale
        psnr = float(-10 * np.log10(np.mean(missed**2)))
        rows.append(_row(scene, side, "compensate", "PSNR", psnr, method))
    return rows


def inverse_light_rows(estimate: LightTransport, truth: Truth, scene: str) -> list[Row]:
    """Relative L2 distances to direct light alone, before and after global light is cancelled."""
    side = truth.camera_shape[0]
    white = np.ones(truth.projector_shape, np.float32)
    direct = truth.direct @ white.ravel()
    rows = []
    shown = {"white pattern": white, "estimate": cancel_global(estimate).pattern}
    for method, pattern in shown.items():
        missed = truth.matrix @ pattern.ravel() - direct
        residue = float(np.linalg.norm(missed) / np.linalg.norm(direct))
        rows.append(_row(scene, side, "cancel global", "residue", residue, method))
    return rows


def _white_level(transport: LightTransport) -> float:
    shared = compensator(transport)
    return float(np.median(shared.light.white[shared.lit]))


def _reachable(
    truth: Truth, pattern: NDArray[np.float32], target: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Camera pixels of which the true T says that the picture can be reached, (M,)."""
    white = np.ones(pattern.size, np.float32)
    direct, total = truth.direct @ white, truth.matrix @ white
    others = truth.indirect @ pattern.ravel()
    return np.asarray((direct > _DIRECT * total) & (others <= target) & (target <= others + direct))


def _row(
    scene: str, side: int, use: str, metric: str, value: float, method: str = "estimate"
) -> Row:
    names = {"use": use, "scene": scene, "size": side, "method": method, "metric": metric}
    return {**names, "value": value}


# Blurs of the projector in pixels, each with the name of its rig.
_BLURS = {"separate": 0.0, "separate, blur 1": 1.0}
# Nayar et al. 2006 shift a checkerboard by a third of its square's period, five times five ways.
_SHIFTS = 5
# Sides of the checkerboards' squares in projector pixels, of which the best one counts.
_SQUARES = (2, 3, 4, 6, 8)
# A row has direct light above this share of a bright row's (the 0.9 quantile), and none below the
# second one; rows darker than the first one in all do not count. A row without direct light is
# called direct above the third; a direct row is lost below the last share of its direct light.
_HAS, _HAS_NONE, _CALLED, _LOST = 0.02, 0.002, 0.05, 0.1
_BRIGHT = 0.9


def separation_rows(estimated: LightTransport, truth: Truth, scene: str, seed: int) -> list[Row]:
    """Errors of the direct and the global image, and of which rows are called direct."""
    rows = []
    for use, blur in _BLURS.items():
        known = defocus(truth, blur) if blur else truth
        found = _estimate(known, seed) if blur else estimated
        direct, others = _white_images(known)
        parts = separate(found)
        images = {
            "T, separated": _images(parts),
            "T, window 5 x 5": _window(found),
            "Nayar, best square": _best_checkerboards(known, seed, direct, others),
        }
        for method, (own_direct, own_others) in images.items():
            row = {"use": use, "scene": scene, "size": truth.camera_shape[0], "method": method}
            errors = {
                "direct error": _relative(own_direct, direct),
                "global error": _relative(own_others, others),
                **_counts(own_direct, direct, direct + others),
            }
            if method == "T, separated":
                errors["epipolar direction off"] = _turned(parts, known)
            rows += [{**row, "metric": name, "value": value} for name, value in errors.items()]
    return rows


def _estimate(truth: Truth, seed: int, count: int = 32, noise: float = 0.003) -> LightTransport:
    """The estimate from few Bernoulli patterns with the planner's exposure."""
    exposure = plan(truth, frames=count, noise=noise).exposure
    patterns = BernoulliPatterns(truth.projector_shape, count, seed=seed)
    return estimate(simulate(truth, patterns, exposure=exposure, noise=noise, seed=seed))


def _white_images(truth: Truth) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    direct, others = (
        np.asarray(part.sum(axis=1), np.float64).ravel() for part in (truth.direct, truth.indirect)
    )
    return direct, others


def _images(parts: Separation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    white = np.ones(parts.direct.shape[1])
    return parts.direct @ white, parts.global_ @ white


def _window(transport: LightTransport) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What lies in 5 x 5 projector pixels around the strongest one counts as direct."""
    strongest = correspondence(transport).pixel.reshape(-1, 2)
    matrix = transport.sparse
    owner, row, col = entries_of(matrix, transport.projector_shape[1])
    near = (np.abs(row - strongest[owner, 0]) <= REACH) & (
        np.abs(col - strongest[owner, 1]) <= REACH
    )
    kept = csr_array((np.where(near, matrix.data, 0), matrix.indices, matrix.indptr), matrix.shape)
    white = np.ones(matrix.shape[1])
    direct = kept @ white
    return direct, transport @ white - direct


def _best_checkerboards(
    truth: Truth, seed: int, direct: NDArray[np.float64], others: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Max-min of 25 shifted checkerboards, of the square size that suits the scene best."""
    found = [_checkerboards(truth, seed, square) for square in _SQUARES]
    errors = [_relative(one, direct) + _relative(other, others) for one, other in found]
    return found[int(np.argmin(errors))]


def _checkerboards(
    truth: Truth, seed: int, square: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nayar et al. 2006, Eq. 5 and 6, with patterns that light half of the projector."""
    row, col = np.indices(truth.projector_shape)
    shifts = [round(2 * square * number / _SHIFTS) for number in range(_SHIFTS)]
    boards = [
        ((row + down) // square + (col + right) // square) % 2
        for down in shifts
        for right in shifts
    ]
    patterns = ImagePatterns(np.stack(boards).astype(np.float32))
    # The photographs must not clip.
    exposure = 0.95 / float((truth.matrix @ patterns.images().reshape(len(boards), -1).T).max())
    capture = simulate(truth, patterns, exposure=exposure, noise=0.003, seed=seed)
    values = np.asarray(capture.samples().values, np.float64)
    high, low = values.max(axis=1), values.min(axis=1)
    return high - low, 2 * low


def _relative(found: NDArray[np.float64], known: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))


def _counts(
    found: NDArray[np.float64], direct: NDArray[np.float64], total: NDArray[np.float64]
) -> dict[str, float]:
    """Shares of rows without direct light that are called direct, and of direct rows lost."""
    bright = np.quantile(direct, _BRIGHT)
    lit = total > _HAS * np.quantile(total, _BRIGHT)
    none, has = lit & (direct < _HAS_NONE * bright), direct > _HAS * bright
    called = float((found[none] > _CALLED * bright).mean()) if none.any() else 0.0
    return {"called direct": called, "direct lost": float((found < _LOST * direct)[has].mean())}


def _turned(parts: Separation, truth: Truth) -> float:
    """Degrees between the estimate's epipolar lines and those of the true direct light."""
    known = LightTransport.from_matrix(truth.direct, truth.camera_shape, truth.projector_shape)
    # The line of the camera's middle.
    middle = np.array([*(side / 2 for side in truth.camera_shape[:2]), 1])
    lines = [each.geometry.fundamental @ middle for each in (parts, separate(known))]
    one, other = (np.degrees(np.arctan2(-right, down)) for down, right, _ in lines)
    return float(min((one - other) % 180, (other - one) % 180))


SCENES = ("l_objects", "gripper", "metal", "corner")
SIDES = (64, 128)
SEEDS = (0, 1, 2)
PATTERNS, NOISE = 32, 0.003
# Each use judges an estimate by the truth of a scene, with a seed for photographs of its own: rows
# with use, scene, size, method, metric, value.
USES: tuple[Callable[[LightTransport, Truth, str, int], list[Row]], ...] = (
    lambda transport, truth, scene, _: compensation_rows(transport, truth, scene),
    lambda transport, truth, scene, _: inverse_light_rows(transport, truth, scene),
    separation_rows,
)
# The metrics that the figure shows, with the title of their panels and the label of their axis.
_DRAWN = {
    ("compensate", "PSNR"): ("compensation", "PSNR of the photograph (dB)"),
    ("cancel global", "residue"): ("global light cancelled", "global / direct light"),
    ("separate", "global error"): ("separation", "error of the global image"),
    ("separate, blur 1", "global error"): (
        "separation, blur of 1 pixel",
        "error of the global image",
    ),
}
# The methods of the table, each with its words and its colour in the figure: ours are blue, what
# only a simulation knows is grey.
_METHODS = {
    "pixel gains": ("gain of each pixel", COLOURS[4]),
    "white pattern": ("under white", COLOURS[4]),
    "T, window 5 x 5": ("T, window of 5 x 5", COLOURS[4]),
    "Nayar, best square": ("Nayar et al., best square", COLOURS[1]),
    "estimate": ("T from 32 photographs", COLOURS[0]),
    "T, separated": ("T from 32 photographs", COLOURS[0]),
    "true T": ("true T", "0.6"),
}


@dataclass(frozen=True)
class Case:
    """One estimate of one scene."""

    scene: str
    side: int
    seed: int

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.scene}-{self.side}-s{self.seed}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run measures each scene once at 64 x 64."""
    for side in SIDES[:1] if quick else SIDES:
        for seed in SEEDS[:1] if quick else SEEDS:
            for scene in SCENES:
                yield Case(scene, side, seed)


def measure(case: Case) -> Measured:
    """The rows of all uses for one case."""
    truth = library.truth(case.scene, (case.side, case.side))
    exposure = plan(truth, frames=PATTERNS, noise=NOISE).exposure
    patterns = BernoulliPatterns(truth.projector_shape, PATTERNS, seed=case.seed)
    capture = simulate(truth, patterns, exposure=exposure, noise=NOISE, seed=case.seed)
    transport = estimate(capture)
    rows = [row for use in USES for row in use(transport, truth, case.scene, case.seed)]
    return Measured([{**row, "seed": case.seed} for row in rows])


def _summary(rows: list[Row]) -> list[Row]:
    """The means over the seeds."""
    return means(rows, ("use", "scene", "size", "method", "metric"), ("value",))


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """One panel for each metric and size: bars by scene and method."""
    rows = all_rows(results)
    sizes = sorted({row["size"] for row in rows})
    drawn = [metric for metric in _DRAWN if any(_of(row) == metric for row in rows)]
    with figure(3.4 * len(sizes) + 1.6, 1.9 * len(drawn)) as drawing:
        panels = drawing.subplots(len(drawn), len(sizes), squeeze=False, sharey="row")
        for line, metric in zip(panels, drawn, strict=True):
            title, label = _DRAWN[metric]
            for axes, size in zip(line, sizes, strict=True):
                own = [row for row in rows if _of(row) == metric and row["size"] == size]
                _draw_bars(axes, own)
                axes.set_title(f"{title}, {size} x {size}")
            line[0].set_ylabel(label)
            line[-1].legend(loc="upper left", bbox_to_anchor=(1, 1))
        save(drawing, out, "uses", ("png", "svg"))


def _of(row: Row) -> tuple[str, str]:
    return row["use"], row["metric"]


def _draw_bars(axes: Any, rows: list[Row]) -> None:
    """Means over the seeds, with a line from the least to the largest value."""
    scenes = [scene for scene in SCENES if any(row["scene"] == scene for row in rows)]
    methods = [name for name in _METHODS if any(row["method"] == name for row in rows)]
    width = 0.8 / max(1, len(methods))
    for number, method in enumerate(methods):
        words, colour = _METHODS[method]
        for place, scene in enumerate(scenes):
            values = [
                row["value"] for row in rows if (row["method"], row["scene"]) == (method, scene)
            ]
            x = place + (number - (len(methods) - 1) / 2) * width
            axes.bar(x, np.mean(values), width, color=colour, label=None if place else words)
            axes.vlines(x, min(values), max(values), color="black", linewidth=0.8)
    axes.set_xticks(range(len(scenes)), scenes)


USES_EXPERIMENT = Experiment("uses", cases, measure, _draw, summary=_summary)
