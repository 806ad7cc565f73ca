"""How honest an estimate is: the error that it states, and its verdict, against the truth.

    python -m benchmarks.honesty [--quick] [--cases 320] [--seed 0] [--processes 2] [-o honesty-out]

Cases are drawn at random from scenes, patterns, damages and sizes (`synthetic_captures`): half of
them intact, the others with one damage. With --hidden they are of the kinds in `HIDDEN`. Each is
checked and estimated as `lightmatrix estimate` does it. Results go to OUT/cases.jsonl, one line a
case, and a later run goes on after the last. Then come a table, OUT/summary.json and
OUT/honesty.png. Thresholds of the package were chosen on cases with odd numbers, so that only those
with even numbers test them.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import lightmatrix as lm
from benchmarks.synthetic_captures import (
    CLIPPING,
    DAMAGES,
    PATTERNS,
    SCENES,
    SyntheticCapture,
    draw,
)
from experiments.harness import Row, show, write_json
from experiments.harness import options as options_of
from lightmatrix.check.finding import NOTES
from lightmatrix.judgement.judgement import verdicts
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, save
from lightmatrix.rig_model.model import RigModel
from lightmatrix.rig_model.terms import TERMS
from lightmatrix.simulation import library

INTACT = "intact"
# Sizes of camera and projector, with the share of the cases that have them.
SIZES = {16: 0.48, 32: 0.38, 64: 0.12, 128: 0.02}
QUICK_CASES, QUICK_SIZE = 24, 16
# Errors of T that the verdict must not miss, must not doubt, and what "good" must not exceed.
WRONG, RIGHT, GOOD_AT_MOST = 0.3, 0.05, 0.1
# What the model holds for: intact captures of scenes with small footprints and faint light beside
# them, under patterns that tell projector pixels apart.
PLAIN_SCENES = ("wall", "textured", "translucent", "broad", *library.BUNDLED)
PLAIN_PATTERNS = ("random", "many", "few", "mixed", "hadamard")
TRUSTED = ("good", "fair")
# Scenes, patterns and damages that hide what is wrong, or make intact captures look wrong: camera
# pixels that see one projector pixel, clip levels that are not stated, parts of a projector under
# few patterns, and patterns of varying density.
_FEW = ("few", "some", "random")
HIDDEN = (
    (("own pixels", "permutation", "fibres"), _FEW, (INTACT, "curve", "clips at 128")),
    (("textured", "own pixels"), _FEW, ("video range", *CLIPPING)),
    (("half lit",), ("few", "some"), (INTACT,)),
    (("wall", "textured", "half lit"), ("16 of any density", "46 of any density"), (INTACT,)),
)
# The error axes of the figure.
_ERRORS, _TICKS = (0.0015, 2.5), (0.003, 0.01, 0.03, 0.1, 0.3, 1)


@dataclass(frozen=True)
class Case:
    """One capture, by its number and its seed."""

    number: int
    seed: int
    scene: str
    patterns: str
    damage: str
    size: int

    @classmethod
    def drawn(cls, number: int, seed: int) -> Case:
        """The case of a number among those of a seed."""
        generator = np.random.default_rng((seed, number))
        scene = str(generator.choice([*SCENES, *library.BUNDLED]))
        # Those that are meant for this, and used most, come twice as often.
        patterns = str(generator.choice([*PATTERNS, *PLAIN_PATTERNS]))
        damage = INTACT if generator.random() < 0.5 else str(generator.choice(DAMAGES))
        size = int(generator.choice([*SIZES], p=[*SIZES.values()]))
        # Larger diffuse scenes would take gigabytes, and bundled scenes must be rendered.
        size = min(size, 64) if scene in ("diffuse", *library.BUNDLED) else size
        return cls(number, seed, scene, patterns, damage, size)

    @classmethod
    def hidden(cls, number: int, seed: int) -> Case:
        """The case of a number among those of `HIDDEN`."""
        generator = np.random.default_rng((seed, number, 1))
        choices = HIDDEN[number // 2 % len(HIDDEN)]
        scene, patterns, damage = (str(generator.choice(choice)) for choice in choices)
        return cls(number, seed, scene, patterns, damage, int(generator.choice((16, 32))))

    def capture(self) -> SyntheticCapture:
        """The capture, and its truth."""
        return draw(
            self.scene, self.patterns, self.damage, self.size, 1000 * self.seed + self.number
        )


@dataclass(frozen=True)
class Outcome:
    """What became of a case; `level` is "refused" where `estimate` refuses the capture.

    `true` is the relative error of T, `stated` the error that the estimate states of itself.
    """

    case: Case
    level: str
    sentence: str
    findings: tuple[str, ...] = ()
    true: float | None = None
    stated: float | None = None
    seconds: float = 0.0

    @property
    def ratio(self) -> float:
        """Stated over true error; NaN where one of them is not known."""
        if self.true is None or self.stated is None:
            return np.nan
        return self.stated / max(self.true, 1e-9)

    @property
    def words(self) -> tuple[str, ...]:
        """Kinds of findings that say that something is wrong, not only that codes have limits."""
        return tuple(kind for kind in self.findings if kind not in NOTES)

    @property
    def plain(self) -> bool:
        """Whether the model of the estimate holds for the case."""
        case = self.case
        suits = case.scene in PLAIN_SCENES and case.patterns in PLAIN_PATTERNS
        return suits and case.damage == INTACT

    @classmethod
    def from_line(cls, line: str) -> Outcome:
        """The outcome of a line of JSON."""
        values = json.loads(line)
        values |= {"case": Case(**values["case"]), "findings": tuple(values["findings"])}
        return cls(**values)


def measure(case: Case) -> Outcome:
    """Check and estimate a case as `lightmatrix estimate` does, and compare with the truth."""
    started = time.perf_counter()
    drawn = case.capture()

    def seconds() -> float:
        return round(time.perf_counter() - started, 2)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            estimate = lm.estimate(drawn.capture)
        except lm.InputError as error:
            return Outcome(case, "refused", error.message, seconds=seconds())
    said = {each["kind"] for each in estimate.provenance["findings"]}
    # What the rig did is said, too: T is then that of the camera's mean place, for one.
    kinds = tuple(sorted(said.union(RigModel.of(estimate).names)))
    judged = verdicts(estimate).transport
    true = relative_error(estimate, drawn.truth)
    return Outcome(case, judged.level, judged.sentence, kinds, true, judged.error, seconds())


def outcomes(cases: Sequence[Case], file: Path, processes: int) -> list[Outcome]:
    """The outcomes of some cases: those that the file has, and the others, which it gets."""
    known: dict[Case, Outcome] = {}
    if file.exists():
        lines = file.read_text().splitlines()
        known = {each.case: each for each in map(Outcome.from_line, lines)}
    missing = [case for case in cases if case not in known]
    with file.open("a") as opened, ProcessPoolExecutor(processes) as pool:
        for outcome in pool.map(measure, missing):
            opened.write(json.dumps(asdict(outcome)) + "\n")
            opened.flush()
            known[outcome.case] = outcome
    return [known[case] for case in cases]


def summary(results: Sequence[Outcome]) -> dict[str, float]:
    """Shares and numbers of cases that say how honest the estimates are."""
    tested = [each for each in results if each.true is not None]
    stated = [each for each in tested if each.stated is not None and np.isfinite(each.ratio)]
    wrong = [each for each in tested if _true(each) > WRONG]
    plain = [each for each in stated if each.plain]
    intact = [each for each in results if each.case.damage == INTACT]

    def share(cases: Sequence[Outcome], holds: Callable[[Outcome], bool]) -> float:
        return round(float(np.mean([holds(each) for each in cases])), 3) if cases else np.nan

    return {
        "cases": len(results),
        "refused": sum(each.level == "refused" for each in results),
        "not tested": sum(each.level == "not tested" for each in results),
        "with a stated error": len(stated),
        "stated within 1.5 of true": share(stated, lambda each: within(each, 1.5)),
        "stated within 2 of true": share(stated, lambda each: within(each, 2)),
        "stated below half of true": share(stated, lambda each: each.ratio < 0.5),
        "where the model holds": len(plain),
        "there within 1.5": share(plain, lambda each: within(each, 1.5)),
        "wrong (above 0.3)": len(wrong),
        "wrong, yet good or fair without a finding": sum(map(misleading, wrong)),
        "good, yet above 0.1": sum(_true(each) > GOOD_AT_MOST for each in tested if _good(each)),
        "right (up to 0.05), yet doubtful": sum(
            _true(each) <= RIGHT and each.level == "doubtful" for each in tested
        ),
        "intact": len(intact),
        "intact, yet accused": sum(bool(_accused(each)) for each in intact),
    }


def within(outcome: Outcome, factor: float) -> bool:
    """Whether the stated error is within a factor of the true one."""
    return 1 / factor <= outcome.ratio <= factor


def misleading(outcome: Outcome) -> bool:
    """Whether a wrong estimate is trusted, and nothing says why it should not be."""
    return _true(outcome) > WRONG and outcome.level in TRUSTED and not outcome.words


def _true(outcome: Outcome) -> float:
    return 0.0 if outcome.true is None else outcome.true


def _good(outcome: Outcome) -> bool:
    return outcome.level == "good"


def _accused(outcome: Outcome) -> bool:
    """Whether an intact capture is refused, or found to be out of order or moved or bent."""
    kinds = {"order", "unrelated", "motion", "frame", *TERMS}
    return outcome.level == "refused" or bool(kinds & set(outcome.findings))


def worst(results: Sequence[Outcome], most: int = 20) -> list[Outcome]:
    """The cases that mislead most: trusted and wrong, then by how far the stated error is off."""

    def badness(outcome: Outcome) -> float:
        trusted = outcome.level in TRUSTED
        missed = 100 * misleading(outcome) + 50 * (_good(outcome) and _true(outcome) > GOOD_AT_MOST)
        doubted = 25 * (outcome.level == "doubtful" and _true(outcome) <= RIGHT)
        off = abs(np.log(outcome.ratio)) if np.isfinite(outcome.ratio) else 0.0
        return float(missed + doubted + off * (1 + trusted))

    tested = [each for each in results if each.true is not None]
    return sorted(tested, key=badness, reverse=True)[:most]


def described(outcome: Outcome) -> Row:
    """An outcome as a row of a table."""
    case = outcome.case
    return {
        "no.": case.number,
        **{name: getattr(case, name) for name in ("scene", "patterns", "damage", "size")},
        "true": outcome.true,
        "stated": outcome.stated,
        "verdict": outcome.level,
        "findings": ", ".join(outcome.findings),
    }


def draw_figure(results: Sequence[Outcome], folder: Path) -> None:
    """Stated against true errors, coloured by the verdict."""
    colours = dict(
        zip(("good", "fair", "doubtful"), (COLOURS[2], COLOURS[4], COLOURS[1]), strict=True)
    )
    with figure(5.6, 4.6) as drawing:
        axes = drawing.subplots()
        line = np.array(_ERRORS)
        axes.fill_between(line, line / 2, line * 2, color="0.92", lw=0, label="within a factor 2")
        axes.plot(line, line, color="0.6", lw=0.8)
        for level, colour in colours.items():
            for intact, marker in ((True, "o"), (False, "x")):
                points = np.array(list(_points(results, level, intact=intact))).reshape(-1, 2)
                if not len(points):
                    continue
                axes.scatter(
                    points[:, 0],
                    points[:, 1],
                    s=16,
                    marker=marker,
                    color=colour,
                    linewidths=0.9,
                    alpha=0.8,
                    label=f"{level}, {'intact' if intact else 'damaged'}",
                )
        axes.set(xscale="log", yscale="log", xlim=_ERRORS, ylim=_ERRORS)
        axes.set(xlabel="true relative error of T", ylabel="stated error")
        for axis in (axes.xaxis, axes.yaxis):
            fix_ticks(axis, _TICKS)
        axes.legend(loc="upper left")
        save(drawing, folder, "honesty")


def _points(
    results: Sequence[Outcome], level: str, *, intact: bool
) -> Iterator[tuple[float, float]]:
    """True and stated errors of the cases of a level."""
    for each in results:
        chosen = each.level == level and (each.case.damage == INTACT) == intact
        if chosen and each.true is not None and each.stated is not None:
            yield tuple(np.clip((each.true, each.stated), *_ERRORS))


def chosen_cases(options: argparse.Namespace) -> list[Case]:
    """The cases of the options."""
    drawn = Case.hidden if options.hidden else Case.drawn
    cases = [drawn(number, options.seed) for number in range(options.cases)]
    if options.quick:
        cases = [case for case in cases if case.size == QUICK_SIZE][:QUICK_CASES]
    if options.sizes is not None:
        sizes = {int(size) for size in options.sizes.split(",")}
        cases = [case for case in cases if case.size in sizes]
    if options.half is not None:
        cases = [case for case in cases if case.number % 2 == (options.half == "odd")]
    return cases


def main(arguments: list[str] | None = None) -> None:
    parser = options_of("benchmarks.honesty", __doc__)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_CASES} small cases")
    parser.add_argument("--hidden", action="store_true", help="kinds whose faults hide")
    parser.add_argument("--cases", type=int, default=320)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", choices=("odd", "even"), help="only these numbers")
    parser.add_argument("--sizes", help="only these sizes, such as 16,32")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("-o", "--out", type=Path, default=Path("honesty-out"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    results = outcomes(chosen_cases(options), options.out / "cases.jsonl", options.processes)
    numbers = summary(results)
    for name, value in numbers.items():
        print(f"{name:45} {value:g}")
    show("The worst cases", [described(each) for each in worst(results)])
    write_json(options.out / "summary.json", numbers)
    draw_figure(results, options.out)


if __name__ == "__main__":
    main()
