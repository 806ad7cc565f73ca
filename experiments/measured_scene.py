"""`MeasuredScene`: captures of a rendered scene at its benchmark exposure, and errors by rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness import benchmark_exposure
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.exposures import exposure_sequence
from lightmatrix.capture.sensor import Sensor
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.judgement.metrics import (
    UNCLIPPED_RESPONSE,
    diffuse_rows,
    relighting_error,
    row_maximum,
    squared_errors,
    unseen_patterns,
)
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport

BITS = 8
# Neighbouring camera pixels lie on two sides of a depth edge if their strongest projector pixels
# are further apart than this many pixels. Chosen by hand.
EDGE_STEP = 3
# A camera that does not clip reaches this power of two beyond the clip level.
HEADROOM_BITS = 8

# The scenes of the paper's figures, with the titles of their panels.
SCENES = {"l_objects": "L objects", "gripper": "gripper", "metal": "metallic objects"}
LETTERED = {name: f"({'abc'[k]}) {title}" for k, (name, title) in enumerate(SCENES.items())}

Exposures = tuple[tuple[float, float], ...]
ONE_EXPOSURE: Exposures = ((1.0, 1.0),)
THREE_EXPOSURES: Exposures = ((1.0, 0.5), (0.25, 0.25), (0.0625, 0.25))


@dataclass(frozen=True, eq=False)
class _UnclippedCapture(Capture):
    """A capture that never clips, but whose regularization follows the usual clip level."""

    nominal_level: float = 1.0

    @property
    def reference_level(self) -> float:
        return self.nominal_level


@dataclass(frozen=True)
class MeasuredScene:
    """A scene with known T (at exposure 1), seen by an 8-bit camera with noise of 0.003."""

    truth: Truth

    @cached_property
    def known(self) -> LightTransport:
        """T at exposure 1."""
        return self.truth.transport()

    @cached_property
    def exposure(self) -> float:
        """The exposure at which a fifth of the rows have a single response that clips."""
        return benchmark_exposure(self.known)

    def capture(
        self,
        patterns: PatternSet,
        seed: int,
        exposures: Exposures = ONE_EXPOSURE,
        *,
        clipping: bool = True,
    ) -> Capture:
        """Photograph the scene; exposures are multiples of the benchmark exposure, with shares.

        Without `clipping` the camera has the same noise and steps, but a much higher clip level.
        """
        reach = 1 if clipping else 2**HEADROOM_BITS
        bits = BITS if clipping else BITS + HEADROOM_BITS
        exposure = exposure_sequence(exposures, patterns)
        sensor = Sensor(
            np.multiply(exposure, self.exposure / reach), 0.0, USUAL_NOISE / reach, 0.0, bits
        )
        frames = sensor.expose(irradiance(self.truth.matrix, patterns), seed=seed)
        stack = np.ascontiguousarray(frames.T).reshape(patterns.count, *self.truth.camera_shape)
        capture = Capture.from_arrays(patterns, stack, sensor)
        if clipping:
            return capture
        level = 1 / (self.exposure * np.max(exposure))
        return _UnclippedCapture(
            patterns, capture.frames, capture.decoder, nominal_level=float(level)
        )

    @cached_property
    def unclipped_responses(self) -> NDArray[np.bool_]:
        """Rows whose single responses do not clip, (M,)."""
        return row_maximum(self.known) * self.exposure <= UNCLIPPED_RESPONSE

    @cached_property
    def diffuse(self) -> NDArray[np.bool_]:
        """Rows without a dominant 3 x 3 window, (M,)."""
        return diffuse_rows(self.truth.matrix, self.truth.projector_shape)

    @cached_property
    def mostly_global(self) -> NDArray[np.bool_]:
        """Rows with less direct than global light, (M,)."""
        whole = np.asarray(self.truth.matrix.sum(axis=1)).ravel()
        return np.asarray(self.truth.direct.sum(axis=1)).ravel() < 0.5 * whole

    @cached_property
    def edges(self) -> NDArray[np.bool_]:
        """Rows at depth edges, (M,)."""
        rows, cols = self.truth.camera_shape[:2]
        strongest = np.asarray(self.truth.matrix.argmax(axis=1)).reshape(rows, cols)
        place = np.stack(np.divmod(strongest, self.truth.projector_shape[1]))
        edge = np.zeros((rows, cols), bool)
        for axis in (0, 1):
            step = np.abs(np.diff(place, axis=1 + axis)).max(axis=0) > EDGE_STEP
            edge |= np.pad(step, [(0, int(a == axis)) for a in (0, 1)])
            edge |= np.pad(step, [(int(a == axis), 0) for a in (0, 1)])
        return edge.ravel()

    def errors(self, estimate: LightTransport, capture: Capture) -> dict[str, float]:
        """Relative error of each group of rows, and relighting error of the well-exposed ones.

        A row is well exposed if its single responses do not clip at the benchmark exposure, and at
        most half of its samples clip.
        """
        wrong, total = squared_errors(estimate, self.known)
        half = capture.samples().clipped.mean(axis=1) <= 0.5
        exposed = self.unclipped_responses & half
        tests = unseen_patterns(self.known.projector_shape)
        white = np.ones((1, *self.known.projector_shape), np.float32)

        def relative(rows: NDArray[np.bool_]) -> float:
            energy = total[rows].sum()
            return float(np.sqrt(wrong[rows].sum() / energy)) if energy else float("nan")

        def relit(patterns: NDArray[Any], rows: NDArray[np.bool_]) -> float:
            return relighting_error([estimate], [self.known], patterns, np.flatnonzero(rows))

        every = np.ones(len(wrong), bool)
        return {
            "relative_error": relative(exposed),
            "relighting_error": relit(np.stack(list(tests.values())), exposed),
            "white_error": relit(white, exposed),
            "all_rows": relative(every),
            "all_rows_relighting": relit(np.stack(list(tests.values())), every),
            "diffuse_rows": relative(self.diffuse & exposed),
            "diffuse_all_rows": relative(self.diffuse),
            "mostly_global_rows": relative(self.mostly_global),
            "edge_rows": relative(self.edges & exposed),
            "edge_all_rows": relative(self.edges),
            "rows": int(exposed.sum()),
        }


@lru_cache(maxsize=3)
def measured_scene(name: str, size: int) -> MeasuredScene:
    """A scene with as many camera as projector pixels per side."""
    return MeasuredScene(library.truth(name, (size, size)))


@lru_cache(maxsize=1)
def bernoulli_capture(name: str, size: int, count: int) -> Capture:
    """A capture of a scene under `count` Bernoulli patterns, at the benchmark exposure."""
    return measured_scene(name, size).capture(BernoulliPatterns((size, size), count), 0)
