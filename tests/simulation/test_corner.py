"""The corner scene is what it is for: the sum clips although no single response does."""

from __future__ import annotations

from lightmatrix.simulation import library
from lightmatrix.simulation.scene_statistics import clipped_share


def test_global_light_clips_where_no_single_response_does() -> None:
    truth = library.truth("corner")
    exposure = 0.99 / float(truth.matrix.max())
    (clipped,) = clipped_share(truth, (exposure,), count=8)
    assert clipped > 0.1
    assert (exposure * truth.matrix.sum(axis=1) >= 1).mean() > 0.9
    # Direct light alone never clips there.
    assert exposure * truth.direct.max() < 1
