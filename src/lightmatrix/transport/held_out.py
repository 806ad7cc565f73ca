"""How well a matrix predicts photographs that were held out of its estimate."""

from __future__ import annotations

import numpy as np

from lightmatrix.transport.matrix import LightTransport


def prediction_error(transport: LightTransport) -> float | None:
    """The relative error of photographs held out, over all rows; None if none was predicted."""
    errors = np.asarray(transport.diagnostics.get("prediction_error", np.zeros(0)), float)
    known = np.isfinite(errors)
    return float(np.sqrt(np.mean(errors[known] ** 2))) if known.any() else None
