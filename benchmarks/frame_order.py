"""How often frames out of order are noticed, and how often good captures are accused.

    python benchmarks/frame_order.py [--draws 50] [--seeds 2] [--intact 200] [-o order.json]

Captures are drawn at random: one of the bundled 64 x 64 scenes, photographed (8 bits, noise 0.003)
at the exposure of the benchmark or that of `plan`, with one exposure or several, under 32 to 128
Bernoulli patterns or the default mix. Each is checked with four of the faults below, at random
places. The files are renamed, which carries each file's exposure along, or, where exposures differ,
the projector is at fault in one half of the cases and the camera keeps to its list of exposures.
`--intact` draws captures in order, of all kinds of patterns, 12 to 256 frames, grey and in colour.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposure_sequence import exposure_sequence, parse_exposures
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.refusals import refuse_unordered
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.mix import MixedPatterns, default_mix
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.truth import Truth

SIZE = library.BUNDLED_SIZE
COUNTS = (32, 48, 64, 128)
EXPOSURES = {"one": "1", "two": "1:0.75,0.25:0.25", "three": "1:0.5,0.25:0.25,0.0625:0.25"}
PATTERNS = ("Bernoulli 0.5", "Bernoulli 0.1", "mix", "Hadamard, random", "Hadamard, sequency")
NOISE = 0.003

Order = NDArray[np.int64]


def pattern_set(kind: str, count: int, seed: int) -> PatternSet:
    if kind == "mix":
        return MixedPatterns(SIZE, count, default_mix(SIZE, max(64, count)), seed=seed)
    if kind.startswith("Bernoulli"):
        return BernoulliPatterns(SIZE, count, float(kind.split()[1]), seed)
    if kind == "Hadamard, random":
        return HadamardPatterns(SIZE, count, "random", True, seed)
    return HadamardPatterns(SIZE, count, "sequency")


def cameras(truth: Truth) -> dict[str, float]:
    """The exposure at which a fifth of the rows clip singly, and that at which white does not."""
    strongest = truth.matrix.max(axis=1).toarray().ravel()
    white = truth.matrix.sum(axis=1)
    return {
        "benchmark": float(1 / np.quantile(strongest, 0.8)),
        "planned": float(1 / np.quantile(white, 0.999)),
    }


def exposure_list(name: str, unit: float, patterns: PatternSet) -> NDArray[np.float64]:
    relative = exposure_sequence(parse_exposures(EXPOSURES[name]), patterns)
    return np.asarray(unit * np.broadcast_to(relative, (patterns.count,)))


def faults(count: int, generator: np.random.Generator) -> Iterator[tuple[str, Order]]:
    """Name of a fault, and which frame stands in each place."""
    frames = np.arange(count)
    a, b = generator.choice(count, 2, replace=False)
    swapped = frames.copy()
    swapped[[a, b]] = b, a
    yield "swapped", swapped
    repeated = frames.copy()
    place = int(generator.integers(1, count))
    repeated[place] = place - 1
    yield "repeated", repeated
    place = int(generator.integers(1, count - 2))
    yield "lost, last repeated", np.append(np.delete(frames, place), count - 1)
    first = int(generator.integers(0, count - 8))
    last = int(generator.integers(first + 8, count))
    filled = frames.copy()
    filled[first:last] = frames[first + 1 : last + 1]
    yield "lost, another repeated", filled
    place = int(generator.integers(1, count - 2))
    yield "late from one on", np.insert(frames, place, place - 1)[:count]
    yield "all early", np.append(frames[1:], count - 1)
    yield "all late", np.append(0, frames[:-1])
    yield "backwards", frames[::-1].copy()


def complaint(
    patterns: PatternSet,
    light: NDArray[np.float32],
    exposure: NDArray[np.float64],
    order: Order,
    *,
    renamed: bool,
    shape: tuple[int, ...],
    seed: int,
) -> str | None:
    camera = Sensor(exposure[order] if renamed else exposure, read_noise=NOISE)
    raw = camera.expose(np.ascontiguousarray(light[:, order]), seed=seed)
    frames = np.ascontiguousarray(raw.T).reshape(len(order), *shape)
    sensor = Sensor(exposure, read_noise=NOISE)
    try:
        findings = refuse_unordered(Capture.from_arrays(patterns, frames, sensor))
    except InputError as error:
        return error.message
    return next((found.message for found in findings if found.kind == "unrelated"), None)


def right(fault: str, order: Order, message: str) -> bool:
    """Whether the message names what is wrong."""
    wrong = np.flatnonzero(order != np.arange(len(order)))
    if fault == "swapped":
        return f"frame {wrong[0]} and frame {wrong[1]} " in message
    if fault == "repeated":
        return f"frame {wrong[0]} shows the pattern of frame {order[wrong[0]]}:" in message
    if fault == "backwards":
        # Only a few kinds of disorder have names.
        return "do not follow the patterns" in message
    return ("after its own" if order[wrong[0]] > wrong[0] else "before its own") in message


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=50, help="captures with faults, for each seed")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--intact", type=int, default=200, help="captures in order")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows = [row for seed in range(options.seeds) for row in faulty_captures(options.draws, seed)]
    print(table(rows))
    messages = [each for each in intact_captures(options.intact) if each is not None]
    print(f"{len(messages)} of {options.intact} captures in order were accused")
    for message in messages:
        print(f"  {message}")
    if options.output:
        options.output.write_text(json.dumps({"rows": rows, "accused": messages}, indent=2) + "\n")


def faulty_captures(number: int, seed: int) -> Iterator[dict[str, object]]:
    """What the check states of captures out of order, drawn at random."""
    generator = np.random.default_rng(1001 + seed)
    for _ in range(number):
        name = str(generator.choice(library.BUNDLED))
        count = int(generator.choice(COUNTS))
        exposures = str(generator.choice(list(EXPOSURES)))
        camera = str(generator.choice(["benchmark", "planned"]))
        draw = int(generator.integers(1000))
        wrong = list(faults(count, generator))
        for index in generator.permutation(len(wrong))[:4]:
            fault, order = wrong[index]
            renamed = exposures == "one" or bool(generator.integers(2))
            mixed = count >= 64 and bool(generator.integers(2))
            truth = library.truth(name)
            patterns = pattern_set("mix" if mixed else "Bernoulli 0.5", count, draw)
            message = complaint(
                patterns,
                irradiance(truth.matrix, patterns),
                exposure_list(exposures, cameras(truth)[camera], patterns),
                order,
                renamed=renamed,
                shape=truth.camera_shape,
                seed=draw,
            )
            yield {
                "scene": name,
                "camera": camera,
                "count": count,
                "exposures": exposures,
                "fault": fault,
                "renamed": renamed,
                "noticed": message is not None,
                "right": message is not None and right(fault, order, message),
                "message": message,
            }


def intact_captures(number: int) -> Iterator[str | None]:
    """What the check states of captures in order, drawn at random."""
    generator = np.random.default_rng(1)
    for seed in range(number):
        name = str(generator.choice(library.BUNDLED))
        kind = str(generator.choice(PATTERNS))
        count = int(np.exp(generator.uniform(np.log(12), np.log(257))))
        exposures = str(generator.choice(list(EXPOSURES)))
        truth = library.truth(name)
        unit = float(generator.choice(list(cameras(truth).values())))
        patterns = pattern_set(kind, count, seed)
        exposure = exposure_list(exposures, unit, patterns)
        light, shape = irradiance(truth.matrix, patterns), truth.camera_shape
        if generator.random() < 0.25:
            # Three channels of one surface, coloured at random.
            colour = generator.uniform(0.1, 1, (len(light), 3, 1)).astype(np.float32)
            light, shape = (light[:, None] * colour).reshape(-1, count), (*shape, 3)
        message = complaint(
            patterns, light, exposure, np.arange(count), renamed=True, shape=shape, seed=seed
        )
        yield message and f"{name}, {kind}, {count} frames, {exposures}, {shape}: {message}"


def table(rows: list[dict[str, object]]) -> str:
    """Noticed (and named rightly) of all, by fault, exposures and number of frames."""
    columns = [(several, count) for several in (False, True) for count in COUNTS]
    lines = [
        "| fault | " + " | ".join(f"{'several' if s else 'one'}, {k}" for s, k in columns) + " |",
        "|" + "---|" * (len(columns) + 1),
    ]
    for fault in dict.fromkeys(str(row["fault"]) for row in rows):
        cells = []
        for column in columns:
            some = [
                row
                for row in rows
                if row["fault"] == fault and (row["exposures"] != "one", row["count"]) == column
            ]
            noticed = sum(bool(row["noticed"]) for row in some)
            named = sum(bool(row["right"]) for row in some)
            cells.append(f"{noticed} ({named}) of {len(some)}")
        lines.append(f"| {fault} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
