"""T that follows a scene: the error of what moved, photograph by photograph.

python -m benchmarks.track                 a block of `l_objects` is turned, 128 x 128
python -m benchmarks.track --side 64 -o out/

Writes track.json, and track.png for docs/tracking.md. The scene with the turned block is rendered
once, which takes Mitsuba ten minutes at 128 x 128, and kept in the output folder.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm
from experiments.harness import Row, options, show, write_json
from lightmatrix.judgement.metrics import squared_errors
from lightmatrix.pictures.maps import display, white_level
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, panel, save
from lightmatrix.simulation import scenes
from lightmatrix.simulation.renderer import render
from lightmatrix.simulation.shapes import turn
from lightmatrix.simulation.truth import Truth, binned

# Photographs of the window, and further ones before the block is turned.
WINDOW, QUIET = 32, 4
# Numbers of new photographs from which T is also estimated afresh.
ALONE = (8, 12, 16, 24, 32)
# A row moved if it changed by more than a tenth; light that the block reflects changes most rows.
MOVED = 0.1
KINDS: dict[str, dict[str, Any]] = {"bernoulli": {}, "random": {"levels": 3}}


def turned_block() -> scenes.Scene:
    """`l_objects` with its last block turned by 50 degrees about the vertical."""
    scene = scenes.scene("l_objects")
    mesh = scene.parts[-1].mesh
    middle = mesh.vertices.mean(axis=0)
    corners = (mesh.vertices - middle) @ np.asarray(turn("z", 50)).T + middle
    block = replace(scene.parts[-1], mesh=replace(mesh, vertices=corners))
    return replace(scene, name="l_objects_turned", parts=(*scene.parts[:-1], block))


def truths(side: int, folder: Path) -> tuple[Truth, Truth]:
    """T before and after, of the same random paths; smaller ones are binned from 128 x 128."""
    file = folder / "turned.npz"
    if not file.exists():
        scenes.BUILDERS["l_objects_turned"] = turned_block
        render("l_objects_turned", (128, 128), samples=16384, seed=0).save(file)
    both = lm.truth("l_objects", (128, 128)), Truth.load(file)
    return both if side == 128 else tuple(binned(one, 128 // side) for one in both)  # type: ignore[return-value]


def moved_rows(before: Truth, after: Truth) -> NDArray[np.bool_]:
    """Which rows changed by more than `MOVED` of their length, (M,)."""
    squares = [
        np.asarray(matrix.power(2).sum(axis=1)).ravel()
        for matrix in (abs(before.matrix - after.matrix), before.matrix)
    ]
    least = 1e-4 * np.quantile(squares[1], 0.9)
    return np.asarray(np.sqrt(squares[0] / np.maximum(squares[1], least)) > MOVED)


def follow(kind: str, side: int, folder: Path) -> tuple[list[Row], lm.LightTransport]:
    """The errors after each photograph, and T in the end."""
    before, after = truths(side, folder)
    moved, known = moved_rows(before, after), after.transport()
    patterns = lm.make_patterns(kind, (side, side), QUIET + 2 * WINDOW, seed=1, **KINDS[kind])
    first = lm.simulate(before, patterns.subset(np.arange(WINDOW + QUIET)), exposure=0.5, seed=0)
    later = patterns.subset(np.arange(WINDOW + QUIET, 2 * WINDOW + QUIET))
    second = lm.simulate(after, later, exposure=0.5, seed=1)
    given, *alone = (
        lm.estimate(capture.select(range(count)), check=False, correct="none", progress=False)
        for capture, count in ((first, WINDOW), *((second, count) for count in ALONE))
    )
    wrong_alone = [squared_errors(one, known)[0] for one in alone]
    fresh, light = wrong_alone[-1], squared_errors(given, known)[1]
    tracker, rows = lm.Tracker(first.select(range(WINDOW)), given), list[Row]()

    def error(wrong: NDArray[np.floating], which: NDArray[np.bool_]) -> float:
        return float(np.sqrt(wrong[which].sum() / max(light[which].sum(), 1e-30)))

    by_count = {n: error(wrong, moved) for n, wrong in zip(ALONE, wrong_alone, strict=True)}
    for capture in (first.select(range(WINDOW, WINDOW + QUIET)), second):
        for step in tracker.follow(capture):
            transport, count = tracker.transport, step.photograph - QUIET
            changed, unknown = (transport.diagnostics[n] > 0 for n in ("since", "unknown"))
            wrong, fine = squared_errors(transport, known)[0], moved & ~unknown
            stated = (transport.diagnostics["estimated_error"] ** 2) * light
            rows.append(
                {
                    "patterns": kind,
                    "since the change": count,
                    "missed": step.missed,
                    "found": float(changed[moved].mean()),
                    "others found": int(changed[~moved].sum()),
                    "unknown": float(unknown[moved].mean()),
                    "error": error(wrong, moved),
                    "error of known": error(wrong, fine),
                    "stated": error(stated, fine),
                    "of 32 alone": error(fresh, moved),
                    "of as many alone": by_count.get(count, np.nan),
                    "others / of 32 alone": error(wrong, ~moved) / error(fresh, ~moved),
                    "seconds": step.seconds,
                }
            )
    return rows, transport


def draw(rows: list[Row], before: Truth, transport: lm.LightTransport, folder: Path) -> None:
    """Errors and what is unknown against the photographs since the change, and the scene."""
    names = {"bernoulli": "black and white", "random": "three grey levels"}
    with figure(11, 2.9) as drawing:
        errors, unknown, *pictures = drawing.subplots(1, 4, width_ratios=(4.2, 3, 2.9, 2.9))
        for kind, colour in zip(KINDS, COLOURS, strict=False):
            some = [r for r in rows if r["patterns"] == kind and r["since the change"] > 0]
            count, every, alone, lost = (
                np.array([row[key] for row in some], float)
                for key in ("since the change", "error", "of as many alone", "unknown")
            )
            errors.semilogy(count, every, color=colour, label=f"tracked, {names[kind]}")
            known = np.isfinite(alone)
            errors.semilogy(count[known], alone[known], "o", color=colour, markerfacecolor="white")
            unknown.plot(count, 100 * lost, color=colour)
        label = "estimated from these alone"
        errors.plot([], [], "o", color="0.4", markerfacecolor="white", label=label)
        errors.set(ylabel="relative error of what moved", ylim=(0.008, 2))
        fix_ticks(errors.yaxis, (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1))
        errors.legend(loc="upper right")
        unknown.set(ylabel="unknown share of what moved, %", ylim=(0, 103))
        for axes in (errors, unknown):
            axes.set(xlabel="photographs since the change", xlim=(0, 32.5), xticks=range(0, 33, 8))
        white = np.ones(transport.projector_shape)
        images = [one.relight(white) for one in (before.transport(), transport)]
        bright = white_level(images[0])
        panel(pictures[0], display(images[0], bright), "before")
        shown = np.repeat(display(images[1], bright)[..., None], 3, axis=2)
        changed = transport.diagnostics["since"].reshape(transport.camera_shape) > 0
        # The orange of the palette, over what was found to have changed.
        shown[changed] = 0.5 * shown[changed] + 0.5 * np.array((0.90, 0.62, 0))
        panel(pictures[1], shown, "after, with what changed")
        for letter, axes in zip("abcd", (errors, unknown, *pictures), strict=True):
            title = axes.get_title()
            axes.set_title("")
            axes.set_title(f"({letter}) {title}", loc="left")
        save(drawing, folder, "track")


def main() -> None:
    """Measure, print and draw."""
    parser = options("benchmarks.track", __doc__)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("-o", "--out", type=Path, default=Path("track-out"))
    arguments = parser.parse_args()
    arguments.out.mkdir(exist_ok=True)
    rows: list[Row] = []
    for kind in KINDS:
        measured, transport = follow(kind, arguments.side, arguments.out)
        rows += measured
        show(f"A block of l_objects is turned, {kind}", measured)
    write_json(arguments.out / "track.json", rows)
    draw(rows, truths(arguments.side, arguments.out)[0], transport, arguments.out)


if __name__ == "__main__":
    main()
