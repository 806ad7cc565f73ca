"""Valid arguments for every function of the compiled core, with changes on request."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.patterns.bits import BernoulliPatterns

# The exceptions that a caller can expect. PyO3's PanicException is none of them.
ORDINARY = (ValueError, TypeError, MemoryError)

ROWS, PATTERNS, UNSEEN, SHAPE, CAMERA = 12, 9, 5, (4, 6), (3, 4, 1)
PIXELS = SHAPE[0] * SHAPE[1]
SHOWN_SET = BernoulliPatterns(SHAPE, PATTERNS)
SHOWN, UNSHOWN = SHOWN_SET.prepared, BernoulliPatterns(SHAPE, UNSEEN, seed=7).prepared
BITS, MEANS = SHOWN_SET.bits, np.asarray(SHOWN_SET.means, np.float64)
RNG = np.random.default_rng(0)
VALUES = RNG.random((ROWS, PATTERNS)).astype(np.float32)
CLIPPED = VALUES > 0.8
MATRIX = csr_array(np.where(RNG.random((ROWS, PIXELS)) < 0.2, 0.5, 0).astype(np.float32))
# Values of all rows under all patterns.
ALL = np.ones((ROWS, PATTERNS + UNSEEN), np.float32)


def samples(**changes: Any) -> Any:
    return SimpleNamespace(**{"values": VALUES, "clipped": CLIPPED, "weights": None} | changes)


def settings(**changes: Any) -> _core.Settings:
    valid: dict[str, Any] = {
        "regularization": 0.05,
        "fidelity": "one-sided",
        "nonnegative": True,
        "background": True,
        "tolerance": 1e-4,
        "max_passes": 50,
        "threads": 1,
    }
    return _core.Settings(**valid | changes)


def sparse_rows(**changes: Any) -> Any:
    parts = {"indptr": MATRIX.indptr, "indices": MATRIX.indices, "data": MATRIX.data}
    return SimpleNamespace(**parts | changes)


def start(**changes: Any) -> Any:
    valid = {"coefficients": MATRIX, "background": np.zeros((ROWS, 3))}
    return SimpleNamespace(**valid | changes)


def cells(**changes: Any) -> Any:
    valid = {"means": np.full((2, PATTERNS), 0.5, np.float32), "penalties": np.ones(2, np.float32)}
    return SimpleNamespace(**valid | changes)


def pseudo_samples(**changes: Any) -> Any:
    return SimpleNamespace(**{"values": ALL, "weights": ALL} | changes)


def neighbourhood(**changes: Any) -> Any:
    valid = {
        "rows": start(),
        "camera": CAMERA,
        "projector": (1, *SHAPE),
        "jacobian": np.zeros((ROWS, 4), np.float32),
    }
    return SimpleNamespace(**valid | changes)


def solve(**changes: Any) -> Any:
    valid: dict[str, Any] = {"samples": samples(), "settings": settings()}
    return SHOWN.solve(**valid | changes)


def weighted(**changes: Any) -> Any:
    valid: dict[str, Any] = {
        "prepared": SHOWN,
        "samples": samples(),
        "settings": settings(),
        "candidates": sparse_rows(),
    }
    return _core.solve_weighted(**valid | changes)


def expected(**changes: Any) -> Any:
    valid: dict[str, Any] = {
        "shown": SHOWN,
        "unseen": UNSHOWN,
        "samples": samples(),
        "neighbourhood": neighbourhood(),
        "background": np.zeros_like(ALL),
        "reach": 9,
        "start": 0,
        "level": 1.0,
    }
    return _core.expected_samples(**valid | changes)


def likely(**changes: Any) -> Any:
    valid: dict[str, Any] = {
        "rows": sparse_rows(),
        "camera": CAMERA,
        "projector": (1, *SHAPE),
        "jacobian": np.zeros((ROWS, 4), np.float32),
        "spots": [np.ones(1, np.float32)],
        "within": 0.1,
        "wider": np.ones(1, np.float32),
        "singles": np.ones(ROWS, np.float32),
        "reach": (1, 1),
        "most": 5,
        "doubts": np.full(ROWS, 0.01),
        "range": (0, ROWS),
    }
    return _core.likely_pixels(**valid | changes)


def forward(**changes: Any) -> Any:
    valid: dict[str, Any] = {"packed": BITS, "pixels": PIXELS, "x": np.ones((2, PIXELS))}
    return _core.bits_forward(**valid | changes)


def adjoint(**changes: Any) -> Any:
    valid: dict[str, Any] = {"packed": BITS, "pixels": PIXELS, "e": np.ones((2, PATTERNS))}
    return _core.bits_adjoint(**valid | changes)


def columns_of_bits(**changes: Any) -> Any:
    valid: dict[str, Any] = {"packed": BITS, "pixels": PIXELS, "index": np.arange(3)}
    return _core.bits_columns(**valid | changes)


def moments(**changes: Any) -> Any:
    valid: dict[str, Any] = {"images": np.ones((2, 6), np.float32), "shape": (2, 3)}
    valid["kernel"] = np.array([0.5, 0.25], np.float32)
    return _core.blurred_moments(**valid | changes)


def rows_times(**changes: Any) -> Any:
    valid = {"rows": np.ones((2, 3), np.float32), "matrix": np.ones((3, 4), np.float32)}
    return _core.rows_times(**valid | changes)


def hadamard(**changes: Any) -> Any:
    return _core.hadamard(**{"x": np.ones((2, 8))} | changes)


def from_bits(**changes: Any) -> Any:
    valid: dict[str, Any] = {"packed": BITS, "pixels": PIXELS, "means": MEANS}
    return _core.PreparedPatterns.from_bits(**valid | changes)


def from_dense(**changes: Any) -> Any:
    valid: dict[str, Any] = {"matrix": SHOWN_SET.dense(), "means": MEANS}
    return _core.PreparedPatterns.from_dense(**valid | changes)


def atoms(**changes: Any) -> Any:
    valid: dict[str, Any] = {"shape": SHAPE, "planes": [(np.ones(1, np.float32), 1.0)]}
    return SHOWN.atoms(**valid | changes)


def scores(**changes: Any) -> Any:
    return SHOWN.scores(**{"e": np.ones((2, PATTERNS))} | changes)


def pass_only(**changes: Any) -> Any:
    return SHOWN.pass_only(**{"e": np.ones((2, PATTERNS))} | changes)


def columns(**changes: Any) -> Any:
    return SHOWN.columns(**{"index": np.arange(3)} | changes)


def frames(**changes: Any) -> Any:
    ones = np.ones(ROWS, np.float32)
    valid: dict[str, Any] = {
        "rows": MATRIX,
        "columns": csr_array(MATRIX.T),
        "background": np.ones((ROWS, 2), np.float32),
        "cells": np.arange(PIXELS) % 2,
        "samples": np.ones((ROWS, 4), np.float32),
        "pixels": np.ones((PIXELS, 3), np.float32),
        "wanted": [ones, ones],
        "last_pattern": np.zeros(PIXELS, np.float32),
        "last_wanted": 0 * ones,
        "out": np.zeros((2, PIXELS), np.float32),
        "room": np.zeros(32 * (ROWS + PIXELS) + 16, np.float32),
        "ridge": 0.1,
        "tolerance": 0.05,
        "steps": 2,
    }
    return _core.frame_patterns(**valid | changes)
