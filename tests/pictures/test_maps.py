"""The maps of diagnostics over the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.pictures import maps
from tests.helpers.transports import random_transport


@pytest.fixture
def transport() -> lm.LightTransport:
    return random_transport()


def test_maps_are_read_without_colour(transport: lm.LightTransport) -> None:
    """Lightness always rises or always falls, for black-and-white prints and the colour-blind."""
    matches = lm.correspondence(transport)
    rows = np.arange(30, dtype=np.float32)
    estimate = replace(
        transport,
        diagnostics={
            "clipped_share": rows / 30, "gap": 1e-5 * rows, "footprint": rows,
            "estimated_error": rows / 30,
        },
    )  # fmt: skip
    drawn = [
        maps.clipping_map(estimate), maps.gap_map(estimate), maps.footprint_map(estimate),
        maps.estimated_error_map(estimate), maps.error_map(rows.reshape(5, 6)),
        *maps.correspondence_maps(matches),
    ]  # fmt: skip
    for one in drawn:
        colours = one.colour_map(np.linspace(0, 1, 64))[:, :3] ** 2.2
        steps = np.diff(colours @ (0.2126, 0.7152, 0.0722))
        assert (steps > 0).all() or (steps < 0).all(), one.title
        pixels = one.pixels()
        assert pixels.shape == (5, 6, 3)
        assert pixels.dtype == np.uint8
    # Unknown values do not look like the smallest value.
    assert (drawn[5].pixels()[np.isnan(drawn[5].values)] == 178).all()


def test_maps_of_missing_diagnostics_are_refused(transport: lm.LightTransport) -> None:
    for view in ("clipping", "gap", "footprint", "estimated-error"):
        with pytest.raises(lm.InputError, match="this matrix has no"):
            lm.show(transport, view)
