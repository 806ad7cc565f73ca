"""The whole way over real components: window, virtual screen, GigE Vision, capture, estimate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.rig.devices.aravis import open_aravis
from lightmatrix.rig.devices.base import Address
from lightmatrix.rig.devices.window import open_window
from lightmatrix.rig.rig import Rig
from lightmatrix.simulation.procedural import ProceduralScene

from .conftest import SCREEN
from .gige import UNIT_EXPOSURE, GigECamera, ScreenRig, needs_aravis

pytestmark = needs_aravis
_SHAPE, _NOISE = (32, 32), 0.003


def test_a_capture_over_gige_vision_is_as_good_as_a_simulated_one(
    screen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    known = ProceduralScene(_SHAPE, _SHAPE, 0).truth()
    cell = min(SCREEN) // _SHAPE[0]
    side = _SHAPE[0] * cell
    left, top = (SCREEN[1] - side) // 2, (SCREEN[0] - side) // 2
    scene = ScreenRig(
        known.matrix, _SHAPE, _SHAPE, noise=_NOISE, left=left, top=top, size=(side, side)
    )
    served = GigECamera(scene, _SHAPE)
    address = Address.parse(served.address)
    try:
        window = open_window(Address("window"))
        # The simulated camera misses one trigger in 20.
        with Rig(window, open_aravis(address), lambda: open_aravis(address), patience=0.5) as rig:
            capture = lm.take_capture(
                "capture",
                rig,
                lm.make_patterns("mix", _SHAPE, 64),
                settings=lm.CaptureSettings(cell=cell),
            )
    finally:
        served.close()
    assert not served.errors
    provenance = capture.provenance
    assert (capture.count, provenance["left_out"]) == (64, {})
    # Kept with the rig; a virtual screen has none, or one that changes nothing.
    assert lm.RigMeasurements.load("rig.json").projector["gamma_ramp"] in (None, {"linear": True})
    # A few, near chance, by a second photograph.
    assert set(provenance["checks"]) <= {"matched", "confirmed"}
    assert provenance["checks"]["matched"] >= 40
    scale = np.float32(provenance["exposure_1_in_seconds"] / UNIT_EXPOSURE)
    truth = replace(
        known,
        matrix=known.with_data(scale * known.matrix.data),
        direct_data=scale * known.direct_data,
    )
    simulated = lm.simulate(truth, capture.patterns, exposure=1.0, bits=16, noise=_NOISE)
    error = lm.evaluate(lm.estimate(capture), truth).relighting_error
    expected = lm.evaluate(lm.estimate(simulated), truth).relighting_error
    assert error < 1.05 * expected
