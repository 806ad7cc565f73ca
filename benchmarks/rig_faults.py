"""What a rig does wrong: whether an estimate names it, and how far T is off without and with it.

    python -m benchmarks.rig_faults [--quick] [--scenes metal,corner] [--faults shake,gain]
        [-k 16,32] [--groups faults,several,intact,fine,advice] [--again] [-o rig-faults-out]

Cases are captures of 64 x 64 pixels at the planned exposure, 8 bits, read noise 0.003 clip levels:

- faults: each fault of `lightmatrix simulate --fault` at three strengths, one at a time
- several: pairs, four and six of them at once
- intact: nothing wrong, under patterns of five kinds, sharp and blurred
- fine: a camera that moves on a grid four times as fine as its pixels (renders once, for minutes)
- advice: sharpening, crosstalk and tone mapping in other scenes, estimated also with a curve that
  is found in the photographs, as findings of `check` may advise

Each is estimated as it is, and with what `correct="auto"` takes out. Each result is a line of
OUT/cases.jsonl, and a later run goes on after the last; `--again` keeps only those of captures as
they are. Then come tables, and OUT/summary.json with the aims and whether they are reached. Where
the light of the frames differs, errors of T are up to a factor, because T has the exposure of one
of them; seconds are those of all cores together.
"""

from __future__ import annotations

import itertools
import json
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from benchmarks.synthetic_captures import SCENES as SYNTHETIC
from benchmarks.synthetic_captures import scene_matrix
from experiments.harness import Row, show, write_json
from experiments.harness import options as options_of
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence, parse_exposures
from lightmatrix.capture.sensor import Sensor
from lightmatrix.judgement.judgement import verdicts
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.rig_model.model import RigModel
from lightmatrix.simulation import library
from lightmatrix.simulation.realism import defocus, vignetting
from lightmatrix.simulation.truth import Truth, binned
from lightmatrix.transport.matrix import LightTransport

SHAPE, NOISE = (64, 64), 0.003
SCENES = ("l_objects", "gripper", "metal", "corner", "vase")
COUNTS = (16, 32, 64)
# The strengths of each fault; the pattern kind that shows it, where random ones do not; and the
# name that the rig model has for it.
FAULTS: dict[str, tuple[tuple[float, ...], str, str]] = {
    "gain": ((0.02, 0.05, 0.1), "random", "gain"),
    "ambient": ((0.02, 0.05, 0.1), "random", "ambient"),
    "shake": ((0.05, 0.1, 0.3), "random", "shift"),
    "creep": ((0.1, 0.3, 1.0), "random", "shift"),
    "breathing": ((0.1, 0.3, 1.0), "random", "shift"),
    "rows": ((0.05, 0.1, 0.15), "random", "rows"),
    "previous": ((0.05, 0.1, 0.15), "random", "previous"),
    "torn": ((0.05, 0.1, 0.2), "random", "previous"),
    "camera-curve": ((1.1, 1.4, 2.2), "random", "camera-curve"),
    "projector-curve": ((1.1, 1.4, 2.2), "grey", "projector-curve"),
    "crosstalk": ((0.1, 0.2, 0.3), "random", "crosstalk"),
    "sharpening": ((0.5, 1.0, 1.5), "grey", "sharpening"),
    "camera-sharpening": ((0.2, 0.5, 1.0), "random", "camera-sharpening"),
    "dynamic-contrast": ((0.1, 0.3, 0.6), "varied", "dynamic-contrast"),
    "exposure": ((0.02, 0.05, 0.2), "random", "exposure"),
    "black": ((0.2, 0.5, 1.0), "random", "black"),
    "tone-mapping": ((0.1, 0.2, 0.3), "random", "tone-mapping"),
}
FOUR = (("shake", 0.05), ("gain", 0.03), ("previous", 0.05), ("rows", 0.04))
SIX = (*FOUR, ("crosstalk", 0.1), ("camera-curve", 1.1))
# Faults that are combined two by two, at strengths that each cost T about 0.05 or more.
PAIRED = (
    ("gain", 0.05), ("ambient", 0.05), ("shake", 0.1), ("rows", 0.1), ("previous", 0.05),
    ("camera-curve", 1.1), ("crosstalk", 0.1),
)  # fmt: skip
# Faults that findings of `check` were once taken for a curve by, on scenes of other kinds.
ADVISED = (
    ("textured", "sharpening", 0.5), ("wall", "sharpening", 1.0), ("metal", "sharpening", 1.5),
    ("metal-keystoned", "sharpening", 1.0), ("textured", "crosstalk", 0.15),
    ("wall", "crosstalk", 0.3), ("metal-vignetted", "crosstalk", 0.2),
    ("l_objects-keystoned", "crosstalk", 0.3), ("textured", "tone-mapping", 0.1),
    ("wall", "tone-mapping", 0.3), ("metal-vignetted", "tone-mapping", 0.2),
    ("metal-keystoned", "tone-mapping", 0.3),
)  # fmt: skip
# T may err by this factor more than without the fault, once that is corrected.
LIMITS = {
    "gain=0.05": 1.25, "ambient=0.05": 1.25, "rows=0.05": 1.25, "previous=0.05": 1.25,
    "previous=0.15": 1.25, "camera-curve=1.1": 1.25, "crosstalk=0.1": 1.25, "rows=0.15": 1.5,
    "creep=0.3": 1.5, "crosstalk=0.3": 1.5, "shake=0.1": 2.0, "shake=0.3": 4.0,
    " ".join(f"{name}={amount:g}" for name, amount in SIX): 1.5,
}  # fmt: skip
# Only faults that cost T more than this must be named.
COSTLY = 0.05
FINE = 4


@dataclass(frozen=True)
class Case:
    """One capture: its group of cases, scene, patterns and what its rig does wrong."""

    group: str
    scene: str
    count: int
    faults: tuple[tuple[str, float], ...] = ()
    patterns: str = "random"
    blur: float = 0.0
    # Room light, without which no black frame is wrong.
    ambient: float = 0.0

    @property
    def fault(self) -> str:
        """The faults as `lightmatrix simulate` takes them."""
        return " ".join(f"{name}={amount:g}" for name, amount in self.faults)

    @property
    def expected(self) -> set[str]:
        """The names that the rig model has for the faults."""
        return {FAULTS[name][2] for name, _ in self.faults}

    @property
    def intact(self) -> Case:
        """The same capture without faults."""
        return replace(self, group="fine" if self.group == "fine" else "intact", faults=())

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Case:
        """The case of a line of results."""
        return cls(**{**values, "faults": tuple((n, a) for n, a in values["faults"])})


def cases(
    groups: Sequence[str],
    scenes: Sequence[str],
    counts: Sequence[int],
    faults: Sequence[str],
    quick: bool,
) -> Iterator[Case]:
    """The cases of the groups; a quick run takes the middle strength of each fault."""
    for group, scene, count in itertools.product(groups, scenes, counts):
        if group == "faults":
            for name in faults:
                strengths, patterns, _ = FAULTS[name]
                for amount in strengths[1:2] if quick else strengths:
                    room = 0.1 if name == "black" else 0.0
                    yield Case(group, scene, count, ((name, amount),), patterns, ambient=room)
        elif group == "several":
            pairs = itertools.combinations(PAIRED, 2)
            for several in [FOUR, SIX] if quick else [FOUR, SIX, *pairs]:
                if all(name in faults for name, _ in several):
                    yield Case(group, scene, count, several)
        elif group == "intact":
            for patterns in ("random", "mixed", "hadamard", "three-level", "pictures"):
                for blur in (0.0,) if quick else (0.0, 1.0):
                    yield Case(group, scene, count, (), patterns, blur)
        elif group == "fine":
            for name in ("shake", "creep"):
                for amount in FAULTS[name][0][1:2] if quick else FAULTS[name][0]:
                    if name in faults:
                        yield Case(group, scene, count, ((name, amount),))
    if "advice" in groups:
        for count, (scene, name, amount) in itertools.product(counts, ADVISED):
            if name in faults:
                yield Case("advice", scene, count, ((name, amount),), FAULTS[name][1])


def patterns_of(kind: str, count: int) -> lm.PatternSet:
    """Patterns of a kind, the same in every run."""
    generator = np.random.default_rng(1)
    if kind == "random":
        return lm.BernoulliPatterns(SHAPE, count, seed=1)
    if kind == "mixed":
        return lm.make_patterns("mix", SHAPE, count, mix="fine:0.75,32x32:0.125,8x8:0.125", seed=1)
    if kind == "hadamard":
        return lm.make_patterns("hadamard", SHAPE, count, order="random", permute=True, seed=1)
    if kind == "pictures":
        images = np.stack([_picture(generator) for _ in range(count)])
    elif kind == "three-level":
        images = generator.integers(0, 3, (count, *SHAPE)) / 2
    elif kind == "varied":
        shares = generator.uniform(0.2, 0.8, (count, 1, 1))
        images = (generator.random((count, *SHAPE)) < shares).astype(float)
    else:
        images = generator.random((count, *SHAPE))
    return lm.ImagePatterns((np.rint(255 * images) / 255).astype(np.float32))


def _picture(generator: np.random.Generator) -> NDArray[np.float64]:
    """Disks of all sizes before each other: edges and areas as in photographs of the world."""
    rows, cols = np.indices(SHAPE)
    picture = np.zeros(SHAPE)
    # The number of disks falls with the cube of their radius, from 1 to 32 pixels, which makes
    # pictures look alike at any distance (the dead leaves of Lee, Mumford and Huang, 2001).
    for _ in range(400):
        radius = 1 / np.sqrt(generator.uniform(1 / 32**2, 1))
        row, col = generator.uniform(-8, 72, 2)
        inside = (rows - row) ** 2 + (cols - col) ** 2 < radius**2
        picture[inside] = generator.random()
    return picture


@cache
def rig_of(scene: str, blur: float, fine: bool) -> tuple[Truth, Truth | None]:
    """The truth of a scene, and that of a camera four times as fine, where it is wanted."""
    if not fine:
        name, _, change = scene.partition("-")
        if name in SYNTHETIC and name not in {each.name for each in lm.scenes()}:
            matrix = scene_matrix(name, SHAPE[0], np.random.default_rng(1))
            known = Truth(matrix, np.zeros_like(matrix.data), SHAPE, SHAPE)
        else:
            known = library.truth(name, SHAPE)
        if change == "vignetted":
            known = vignetting(known, 0.6)
        elif change == "keystoned":
            matrix = csr_array(known.matrix @ _keystone())
            known = Truth(matrix, np.zeros_like(matrix.data), SHAPE, SHAPE)
        return defocus(known, blur), None
    file = library.cache_folder() / f"fine-{scene}.npz"
    if not file.exists():
        size = (FINE * SHAPE[0], FINE * SHAPE[1])
        lm.render(scene, size, projector_size=SHAPE, samples=2048).save(file)
    finer = Truth.load(file)
    return binned(finer, FINE, 1), finer


def _keystone() -> csr_array:
    """What a projector with keystone correction shows of a pattern, (N, N): narrower at the top."""
    rows, cols = np.indices(SHAPE)
    width = 0.8 + 0.2 * rows / (SHAPE[0] - 1)
    places = np.stack([rows, (cols - SHAPE[1] / 2) / width + SHAPE[1] / 2], -1).reshape(-1, 2)
    return bilinear(places, SHAPE)


def bilinear(places: NDArray[np.float64], shape: tuple[int, int]) -> csr_array:
    """The matrix that interpolates images at places (m, 2); beyond the border it is black."""
    first = np.floor(places).astype(np.int64)
    shares = places - first
    parts = []
    for down, right in itertools.product((0, 1), repeat=2):
        row, col = first[:, 0] + down, first[:, 1] + right
        weight = np.where(down, shares[:, 0], 1 - shares[:, 0])
        weight = weight * np.where(right, shares[:, 1], 1 - shares[:, 1])
        inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
        parts.append((weight * inside, np.where(inside, row * shape[1] + col, 0)))
    data, columns = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    owner = np.tile(np.arange(len(places)), 4)
    matrix = csr_array((data, (owner, columns)), shape=(len(places), shape[0] * shape[1]))
    return csr_array(matrix, dtype=np.float32)


@cache
def exposure_of(scene: str, count: int, blur: float, fine: bool) -> str:
    """The planned exposure, or several with their shares."""
    return str(lm.plan(rig_of(scene, blur, fine)[0], frames=count, noise=NOISE).exposure)


def capture_of(case: Case) -> Capture:
    """The photographs of a case."""
    fine = case.group == "fine"
    truth, finer = rig_of(case.scene, case.blur, fine)
    exposure = exposure_of(case.scene, case.count, case.blur, fine)
    patterns, faults = patterns_of(case.patterns, case.count), dict(case.faults)
    if finer is None:
        return lm.simulate(
            truth, patterns, exposure=exposure, noise=NOISE, ambient=case.ambient, faults=faults
        )
    moved = {name: FINE * amount for name, amount in faults.items()}
    # A thousandth of the clip level does not clip, so that the light itself is averaged.
    dim = 1e-3
    light = lm.simulate(finer, patterns, exposure=dim, bits=None, noise=0, faults=moved)
    frames = block_mean(np.stack([light.frame(k) for k in range(case.count)]), (FINE, FINE)) / dim
    sensor = Sensor(exposure_sequence(parse_exposures(exposure), patterns), read_noise=NOISE)
    raw = sensor.expose(frames.reshape(case.count, -1).T)
    return Capture.from_arrays(patterns, np.ascontiguousarray(raw.T).reshape(-1, *SHAPE), sensor)


def error_of(case: Case, estimate: LightTransport, truth: Truth) -> float:
    """The relative error of T; up to a factor where the frames' light differs."""
    known = truth.transport()
    if all(name != "gain" for name, _ in case.faults):
        return relative_error(estimate, known)
    both = (estimate, known)
    dense, wanted = (each.to_matrix(dense_background=True).toarray() for each in both)
    along = float((dense * wanted).sum() / max(float((dense**2).sum()), 1e-30))
    return float(np.linalg.norm(along * dense - wanted) / np.linalg.norm(wanted))


def ways_of(case: Case) -> dict[str, dict[str, Any]]:
    """How a case is estimated: the settings of `lm.estimate`."""
    ways: dict[str, dict[str, Any]] = {"without": {"correct": "none"}, "with": {"correct": "auto"}}
    if case.group == "advice":
        curve = "projector_response" if case.patterns == "grey" else "response"
        ways["advised"] = {"correct": "auto", curve: "auto"}
    return ways


def measure(case: Case, way: str) -> Row:
    """T's error, what is named, the verdict and the seconds of one way to estimate a case."""
    truth = rig_of(case.scene, case.blur, case.group == "fine")[0]
    capture = capture_of(case)
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            estimate = lm.estimate(capture, progress=False, **ways_of(case)[way])
        except lm.InputError as error:
            nothing = {"error": None, "verdict": "refused", "sentence": error.message}
            return {**nothing, "names": [], "findings": [], "seconds": 0.0}
    seconds = time.process_time() - started
    judged = verdicts(estimate).transport
    return {
        "error": error_of(case, estimate, truth),
        "verdict": judged.level,
        "sentence": judged.sentence,
        "findings": sorted({each["kind"] for each in estimate.provenance["findings"]}),
        "names": names_of(estimate),
        "seconds": round(seconds, 3),
    }


def names_of(estimate: LightTransport) -> list[str]:
    """What the estimate names as wrong with the rig."""
    return sorted(RigModel.of(estimate).names)


def results_of(wanted: Iterable[Case], file: Path, *, again: bool) -> dict[Case, Row]:
    """The results of some cases: those that the file has, and the others, which it gets.

    With `again`, only the estimates without correction are taken from the file.
    """
    known: dict[Case, Row] = {}
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    for line in lines:
        if not again or line["way"] == "without":
            known.setdefault(Case.from_json(line["case"]), {})[line["way"]] = line["result"]
    # The intact capture of each case is its measure.
    asked = list(dict.fromkeys(each for case in wanted for each in (case.intact, case)))
    with file.open("a") as opened:
        for number, case in enumerate(asked, start=1):
            row = known.setdefault(case, {})
            for way in [way for way in ways_of(case) if way not in row]:
                row[way] = measure(case, way)
                line = {"case": asdict(case), "way": way, "result": row[way]}
                opened.write(json.dumps(line) + "\n")
                opened.flush()
            print(f"{number}/{len(asked)} {_told(case, known)}", flush=True)
    return {case: known[case] for case in asked}


def _told(case: Case, known: dict[Case, Row]) -> str:
    row, clean = known[case], known[case.intact]["without"]["error"]
    return (
        f"{case.group} {case.scene} K={case.count} {case.patterns} {case.fault or 'intact'}: "
        f"clean {_text(clean)}, {_text(row['without']['error'])} -> {_text(row['with']['error'])} "
        f"{row['with']['names']} {row['with']['verdict']} {row['with']['seconds']:.1f} s"
    )


def _text(error: float | None) -> str:
    return "refused" if error is None else f"{error:.4f}"


def ratio(case: Case, results: dict[Case, Row]) -> float:
    """The error with correction over that of the capture without faults; infinite if refused."""
    error = results[case]["with"]["error"]
    return np.inf if error is None else float(error / results[case.intact]["without"]["error"])


def table(results: dict[Case, Row]) -> list[Row]:
    """One row for each fault and strength: over all scenes and numbers of patterns."""
    groups: dict[tuple[str, str], list[Case]] = {}
    for case in results:
        if case.faults:
            groups.setdefault((case.group, case.fault), []).append(case)
    rows = []
    for (group, fault), members in groups.items():
        found = [set(results[case]["with"]["names"]) for case in members]
        ratios = [ratio(case, results) for case in members]
        clean = [results[case.intact]["without"]["error"] for case in members]
        without = [results[case]["without"]["error"] for case in members]
        corrected = [results[case]["with"]["error"] for case in members]
        rows.append(
            {
                "group": group,
                "fault": fault,
                "cases": len(members),
                "clean": _median(clean),
                "without": _median(without),
                "with": _median(corrected),
                "ratio": float(np.median(ratios)),
                "worst": float(max(ratios)),
                "limit": LIMITS.get(fault),
                "named": _share(c.expected <= f for c, f in zip(members, found, strict=True)),
                "no other": _share(f <= c.expected for c, f in zip(members, found, strict=True)),
                "trusted though wrong": sum(_misleads(case, results) for case in members),
                "seconds": _median(
                    [
                        results[case]["with"]["seconds"]
                        / max(results[case]["without"]["seconds"], 1e-9)
                        for case in members
                    ]
                ),
            }
        )
    return rows


def _median(values: Iterable[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else np.nan


def _share(values: Iterable[bool]) -> float | None:
    listed = list(values)
    return float(np.mean(listed)) if listed else None


def _misleads(case: Case, results: dict[Case, Row]) -> bool:
    """Whether the corrected T errs beyond its limit and above 0.05, and the verdict trusts it."""
    row = results[case]["with"]
    limit = LIMITS.get(case.fault, 1.5)
    wrong = row["error"] is not None and row["error"] > COSTLY and ratio(case, results) > limit
    return wrong and row["verdict"] in ("good", "fair")


def aims(results: dict[Case, Row]) -> list[Row]:
    """What the correction must reach, and what it reaches in these results."""
    single = [c for c in results if c.group == "faults"]
    costly = [
        c for c in single
        if (results[c]["without"]["error"] or 1.0) > COSTLY
    ]  # fmt: skip
    intact = [c for c in results if not c.faults]
    wronged = [c for c in results if c.faults]
    rows: list[Row] = []

    def aim(name: str, reached: float | None, limit: float, *, least: bool = False) -> None:
        if reached is not None:
            holds = reached >= limit if least else reached <= limit
            rows.append({"aim": name, "reached": reached, "limit": limit, "holds": holds})

    def names(case: Case) -> set[str]:
        return set(results[case]["with"]["names"])

    aim("costly faults named", _share(c.expected <= names(c) for c in costly), 0.95, least=True)
    aim(
        "no other name beside them", _share(names(c) <= c.expected for c in costly), 0.95,
        least=True,
    )  # fmt: skip
    aim("intact captures with a name", sum(bool(names(c)) for c in intact), 0)
    if intact:
        aim("intact, worst ratio of errors", max(ratio(c, results) for c in intact), 1.01)
        aim("intact, times as long", _times(intact, results), 1.25)
    if wronged:
        aim("faulty, times as long", _times(wronged, results), 3.0)
        aim("wrong, yet trusted", sum(_misleads(c, results) for c in wronged), 0)
    for fault, limit in LIMITS.items():
        members = [c for c in wronged if c.fault == fault and c.group != "advice"]
        if members:
            aim(f"{fault}: worst ratio", max(ratio(c, results) for c in members), limit)
    advised = [c for c in results if c.group == "advice"]
    aim(
        "advice followed: wrong, yet trusted",
        sum(
            results[c]["advised"]["verdict"] in ("good", "fair")
            and results[c]["advised"]["error"] > max(COSTLY, 1.5 * _clean(c, results))
            for c in advised
        ) if advised else None,
        0,
    )  # fmt: skip
    return rows


def _clean(case: Case, results: dict[Case, Row]) -> float:
    return float(results[case.intact]["without"]["error"])


def _times(members: Sequence[Case], results: dict[Case, Row]) -> float:
    seconds = [
        sum(results[case][way]["seconds"] for case in members) for way in ("without", "with")
    ]
    return seconds[1] / max(seconds[0], 1e-9)


def main(arguments: list[str] | None = None) -> None:
    parser = options_of("benchmarks.rig_faults", __doc__)
    parser.add_argument("--quick", action="store_true", help="one scene, K = 32, one strength")
    parser.add_argument("--scenes", default=None, help=f"such as {','.join(SCENES)}")
    parser.add_argument("--faults", default=",".join(FAULTS), help="such as shake,gain")
    parser.add_argument("-k", "--counts", default=None, help="such as 16,32,64")
    parser.add_argument("--groups", default=None, help="faults,several,intact,fine,advice")
    parser.add_argument("-o", "--out", type=Path, default=Path("rig-faults-out"))
    parser.add_argument("--again", action="store_true", help="measure corrected estimates anew")
    options = parser.parse_args(arguments)
    quick = options.quick
    scenes = options.scenes or ("l_objects" if quick else ",".join(SCENES))
    counts = options.counts or ("32" if quick else ",".join(map(str, COUNTS)))
    groups = options.groups or f"faults,several,intact{'' if quick else ',fine,advice'}"
    wanted = cases(
        groups.split(","), scenes.split(","), [int(k) for k in counts.split(",")],
        options.faults.split(","), quick,
    )  # fmt: skip
    options.out.mkdir(parents=True, exist_ok=True)
    results = results_of(wanted, options.out / "cases.jsonl", again=options.again)
    rows, reached = table(results), aims(results)
    show("Faults: medians and worst, over scenes and numbers of patterns", rows)
    show("Aims", reached)
    write_json(options.out / "summary.json", {"faults": rows, "aims": reached})


if __name__ == "__main__":
    main()
