"""What each part of the coherent estimate is worth: errors without it, on sharp and blurred rigs.

python -m benchmarks.ablation                 128 x 128, 32 patterns, one seed
python -m benchmarks.ablation --side 64 --rigs sharp "blur 2"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from experiments.harness import Row, show
from experiments.harness import options as options_of
from experiments.measured_scene import SCENES
from experiments.rigs import RIGS, Case, rig_capture, rig_truth
from lightmatrix.estimators.coherent import neighbourhood, schedule
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.coherent.row_solver import Backgrounds
from lightmatrix.judgement.metrics import relative_error

# In each of these rigs another part of the estimate matters.
USUAL_RIGS = ("sharp", "blur 1", "camera 4x coarser")


def _evenly(backgrounds: Backgrounds, rows: csr_array) -> NDArray[np.float32]:
    cells = backgrounds.grid[0] * backgrounds.grid[1]
    return np.full((rows.shape[0], cells), 1 / cells, np.float32)


def _zero_jacobian(rows: csr_array, *_: Any) -> NDArray[np.float32]:
    return np.zeros((rows.shape[0], 4), np.float32)


def _likely_atoms(**values: float) -> AbstractContextManager[Any]:
    constants = replace(neighbourhood.LIKELY_ATOMS, **values)  # type: ignore[arg-type]
    return patch.object(neighbourhood, "LIKELY_ATOMS", constants)


Change = Callable[[], AbstractContextManager[Any]]

# How each part is left out, and with which parameters of the estimator.
WITHOUT: dict[str, tuple[Change, dict[str, Any]]] = {
    "all of it": (nullcontext, {}),
    "without neighbours (windows of one camera pixel)": (
        nullcontext,
        {"windows": ((0, 1),) * 8},
    ),
    "without spots (single pixels only)": (nullcontext, {"sizes": (0.0,)}),
    "without single pixels within spots": (
        partial(_likely_atoms, within_at_first=1e-9, within=1e-9),
        {},
    ),
    "without wider spots in the place of narrow ones": (
        partial(_likely_atoms, wider_pixel=0.0, wider_spot=0.0),
        {},
    ),
    "with single pixels believed in everywhere": (
        partial(_likely_atoms, pixels_least=1.0),
        {},
    ),
    "without the Jacobian (votes where neighbours see them)": (
        partial(patch.object, neighbourhood, "measure_jacobian", _zero_jacobian),
        {},
    ),
    "without pseudo-samples": (partial(patch.object, schedule, "PSEUDO_SAMPLES_FROM", 99), {}),
    "without halos (an even background)": (
        partial(patch.object, Backgrounds, "spread", _evenly),
        {},
    ),
    "without cells": (nullcontext, {"background_grid": (1, 1)}),
}


def errors(case: Case) -> Iterator[tuple[str, float]]:
    """Relative errors of a case with each part left out."""
    truth = rig_truth(case.scene, case.rig, case.side)
    capture = rig_capture(case, truth)
    for name, (change, parameters) in WITHOUT.items():
        with change():
            estimate = CoherentEstimator(**parameters).estimate(capture)
        yield name, relative_error(estimate, truth.transport())


def main() -> None:
    """Measure and print the table."""
    parser = options_of("benchmarks.ablation", __doc__)
    parser.add_argument("--patterns", type=int, default=32)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=USUAL_RIGS)
    arguments = parser.parse_args()
    columns = [(scene, rig) for rig in arguments.rigs for scene in SCENES]
    rows: list[Row] = [{"": name} for name in WITHOUT]
    for scene, rig in columns:
        case = Case(scene, rig, arguments.patterns, side=arguments.side)
        for row, (_, error) in zip(rows, errors(case), strict=True):
            row[f"{scene}\n{rig}"] = error
    show(f"Relative error of T, {arguments.patterns} patterns", rows)


if __name__ == "__main__":
    main()
