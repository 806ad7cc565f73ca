"""The camera's response, found in coded photographs: how near the curve and T come to the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.harness import Experiment, Measured, Row, all_rows
from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.found_response import (
    FoundResponse,
    exponent,
    largest_difference,
    with_response,
)
from lightmatrix.errors import InputError
from lightmatrix.estimators.estimate import estimate
from lightmatrix.estimators.unknown_response import find_response
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.pictures.style import COLOURS, figure, fix_ticks, save
from lightmatrix.planning.plan import plan
from lightmatrix.simulation import library
from lightmatrix.simulation.realism import defocus
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth

SIDE, NOISE, BITS = 64, 0.003, 8
SCENES = ("l_objects", "gripper", "metal", "corner", "translucent")
# Standard deviation of the projector's blur, in projector pixels.
BLURS = (0.0, 1.0)
COUNTS = (32, 16)
S_CURVE = "s-curve"
RESPONSES = ("linear", "gamma:2.2", "srgb", S_CURVE, "gamma:0.8", "gamma:1.4", "gamma:3")
# The projector shows random grey values with a gamma of its own: camera, then projector.
GREYS = (("linear", 2.2), ("gamma:2.2", 2.2))
# What an estimate reads the photographs by.
READ_AS = ("known", "auto", "linear")
# The error axis of the figure.
_ERRORS, _TICKS = (0.005, 1.0), (0.01, 0.03, 0.1, 0.3, 1)
# Points of the S-curve, a straight line between any two of which is exact to 16 bits.
_POINTS = 4097


@dataclass(frozen=True)
class Case:
    """Photographs of one rig by a camera of one response."""

    scene: str
    blur: float
    response: str
    patterns: int
    # The projector's gamma under random grey patterns; 0: patterns are black and white.
    projector: float = 0.0

    @property
    def name(self) -> str:
        """A file name."""
        response = self.response.replace(":", "-")
        greys = f"-greys{self.projector:g}" if self.projector else ""
        return f"{self.scene}-b{self.blur:g}-{response}-k{self.patterns}{greys}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run takes one sharp scene and two responses."""
    if quick:
        for response in ("linear", "gamma:2.2"):
            yield Case("l_objects", 0.0, response, 32)
        return
    for count in COUNTS:
        for response in RESPONSES:
            for blur in BLURS:
                for scene in SCENES:
                    yield Case(scene, blur, response, count)
    for response, projector in GREYS:
        for blur in BLURS:
            for scene in SCENES:
                yield Case(scene, blur, response, COUNTS[0], projector)


def camera_of(name: str) -> Response:
    """A response by name, such as gamma:2.2; the S-curve is half a smooth step, half straight."""
    if name != S_CURVE:
        return Response.parse(name)
    levels = np.linspace(0, 1, _POINTS)
    return Response(levels, 0.5 * levels + 0.5 * (3 * levels**2 - 2 * levels**3), name)


def coded(capture: Capture, response: Response, bits: int = BITS) -> Capture:
    """Photographs of float levels as a camera of some response and bit depth stores them."""
    top = 2**bits - 1
    shares = np.stack([capture.frames.read(k) for k in range(capture.count)]).clip(0, 1)
    if response.levels is not None and response.light is not None:
        shares = np.interp(shares, response.light, response.levels)
    frames = np.rint(shares * top).astype(np.uint8 if bits == 8 else np.uint16)
    decoder = replace(capture.decoder, clip=float(top), full_scale=float(top))
    return Capture.from_arrays(capture.patterns, frames, decoder)


def grey_patterns(
    shape: tuple[int, int], count: int, gamma: float
) -> tuple[PatternSet, PatternSet]:
    """Random grey values, of 8 bits and evenly distributed; and their light."""
    random = np.random.default_rng(0).random((count, *shape))
    greys = ImagePatterns((np.rint(255 * random) / 255).astype(np.float32))
    return greys, ProjectorResponse.of_gamma(gamma).light_of_patterns(greys)


def photographed(
    truth: Truth,
    count: int,
    exposure: float | str,
    camera: Response,
    projector: float = 0.0,
    seed: int = 0,
) -> tuple[Capture, PatternSet]:
    """Photographs that a camera codes, read as linear, and the light of the patterns.

    With a `projector` gamma the patterns are random grey values, else black and white.
    """
    greys: PatternSet = BernoulliPatterns(truth.projector_shape, count, seed=seed)
    patterns = greys
    if projector:
        greys, patterns = grey_patterns(truth.projector_shape, count, projector)
    light = simulate(truth, patterns, exposure=exposure, bits=None, noise=NOISE, seed=seed)
    return replace(coded(light, camera), patterns=greys), patterns


def measure(case: Case) -> Measured:
    """The curve that is found, and errors of T by the known curve, by this one, and by none."""
    truth = library.truth(case.scene, (SIDE, SIDE))
    if case.blur:
        truth = defocus(truth, case.blur)
    exposure = plan(truth, frames=case.patterns, noise=NOISE).exposure
    response = camera_of(case.response)
    capture, patterns = photographed(truth, case.patterns, exposure, response, case.projector)
    try:
        unknown = with_response(capture, Response.parse("auto"))
        found = find_response(unknown, projector=bool(case.projector))
    except InputError:
        # The photographs do not determine a curve, which `estimate` would refuse alike.
        found = FoundResponse(Response(), np.nan, np.nan, np.nan, 0)
    known = truth.transport()
    read = {
        "known": replace(with_response(capture, response), patterns=patterns),
        "auto": found.applied_to(capture),
        "linear": capture,
    }
    errors = {
        f"error_{name}": relative_error(estimate(each, check=False), known)
        for name, each in read.items()
    }
    if not found.estimates:
        errors["error_auto"] = np.nan
    row = {
        **asdict(case),
        "gamma": exponent(response),
        "gamma_found": found.gamma,
        "projector_found": found.projector.gamma if found.projector else 0.0,
        "uncertainty": found.uncertainty,
        "found": bool(found.estimates),
        "curve_difference": largest_difference(found.response, response),
        "estimates": found.estimates,
        **errors,
        "ratio": errors["error_auto"] / errors["error_known"],
    }
    return Measured([row])


def _summary(rows: list[Row]) -> list[Row]:
    """Means and worst cases over the scenes in which a curve was found."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(
            (row["response"], row["projector"], row["blur"], row["patterns"]), []
        ).append(row)
    summary: list[Row] = []
    for (response, projector, blur, count), group in groups.items():
        found = [row for row in group if row["found"]]
        line: Row = {
            "response": response,
            "projector": projector,
            "blur": blur,
            "patterns": count,
            "scenes": len(group),
            "found": len(found),
        }
        if found:
            line |= {
                "gamma_off_most": max(abs(r["gamma_found"] / r["gamma"] - 1) for r in found),
                "projector_off_most": max(abs(r["projector_found"] - projector) for r in found),
                "curve_difference_most": max(r["curve_difference"] for r in found),
                "estimates_mean": float(np.mean([r["estimates"] for r in found])),
                **{
                    f"error_{name}": float(np.mean([r[f"error_{name}"] for r in found]))
                    for name in READ_AS
                },
                "ratio_most": max(r["ratio"] for r in found),
            }
        summary.append(line)
    return summary


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """One panel for each blur: errors of T of all scenes by response, read in three ways."""
    rows = [row for row in all_rows(results) if row["patterns"] == COUNTS[0]]
    rows = [row for row in rows if not row["projector"]]
    names = [name for name in RESPONSES if any(row["response"] == name for row in rows)]
    blurs = sorted({row["blur"] for row in rows})
    with figure(3.4 * len(blurs) + 0.6, 0.4 * len(names) + 1.6) as drawing:
        panels = drawing.subplots(1, len(blurs), squeeze=False, sharex=True, sharey=True)[0]
        for axes, blur in zip(panels, blurs, strict=True):
            for number, name in enumerate(READ_AS):
                own = [row for row in rows if row["blur"] == blur]
                places = [names.index(row["response"]) + 0.2 * (number - 1) for row in own]
                errors = [row[f"error_{name}"] for row in own]
                label = {"known": "known curve", "auto": "found", "linear": "read as linear"}[name]
                axes.plot(errors, places, "os^"[number], color=COLOURS[number], markersize=4,
                          label=label)  # fmt: skip
            axes.set_xscale("log")
            axes.set_xlim(*_ERRORS)
            fix_ticks(axes.xaxis, _TICKS)
            axes.set_title(f"blur {blur:g} pixel" if blur else "sharp")
            axes.set_xlabel("relative error of T")
        panels[0].set_yticks(range(len(names)), names)
        panels[0].invert_yaxis()
        handles, labels = panels[0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=len(READ_AS))
        save(drawing, out, "responses", ("png", "svg"))


RESPONSES_EXPERIMENT = Experiment("responses", cases, measure, _draw, summary=_summary)
