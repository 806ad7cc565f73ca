"""Picture of the singular values of T: how low the rank of the light is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from lightmatrix.pictures.style import COLOURS, STYLE
from lightmatrix.pictures.transport import Picture
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import singular_values

# Singular values that are drawn, if T has so many.
_VALUES = 50


def spectrum(transport: LightTransport) -> Mapping[str, NDArray[Any]]:
    """The largest singular values of T, ``values``."""
    return {"values": singular_values(transport, min(_VALUES, *transport.shape))}


def show_spectrum(transport: LightTransport) -> Picture:
    """Picture of the largest singular values of T, as shares of the largest."""
    values = spectrum(transport)["values"]
    shares = values / max(float(values[0]), np.finfo(float).tiny)
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(4.2, 2.8), layout="constrained")
        axes = drawing.subplots()
        axes.plot(np.arange(1, len(shares) + 1), shares, "o-", color=COLOURS[0], markersize=3)
        axes.set_ylim(0, 1.05)
        axes.set_title(f"Singular values of T: the {len(shares)} largest")
        axes.set_xlabel("number")
        axes.set_ylabel("share of the largest")
        axes.grid(axis="y", color="0.92", linewidth=0.6)
    return drawing
