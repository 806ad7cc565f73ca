"""What all cameras do alike: exposures within limits, facts, and errors once they are closed."""

from __future__ import annotations

from typing import Any

import pytest

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.addresses import Address
from lightmatrix.live.devices.cameras.base import BaseCamera, stated_exposure
from lightmatrix.live.devices.protocols import Frame


class Still(BaseCamera):
    """A camera that takes no pictures."""

    kind = "still"

    def __init__(self, address: str = "still:1", stated: float | None = None) -> None:
        super().__init__(Address.parse(address))
        self._name, self._shape, self._bits, self._stated = "Still 7", (3, 4), 12, stated
        self.seconds = 0.01

    def get_image(self, timeout: float) -> Frame:
        raise self._timeout(timeout, "take off the cap", ": it is dark")

    def flush(self) -> None:
        return

    def _exposure_range(self) -> tuple[float, float]:
        return 0.001, 3.0

    def _read_exposure(self) -> float:
        return self.seconds

    def _write_exposure(self, seconds: float) -> None:
        self.seconds = seconds


@pytest.mark.parametrize("seconds", [0.001, 0.001 * (1 - 5e-10), 0.5, 3.0, 3.0 * (1 + 5e-10)])
def test_exposures_within_the_limits_are_set(seconds: float) -> None:
    camera = Still()
    assert camera.exposure == 0.01
    camera.exposure = seconds
    assert camera.exposure == seconds


@pytest.mark.parametrize("seconds", [0.00099, 0.001 * (1 - 2e-9), 3.0 * (1 + 2e-9), 3.01])
def test_other_exposures_are_refused(seconds: float) -> None:
    camera = Still()
    with pytest.raises(InputError, match=r"still:1: an exposure of .* s") as refused:
        camera.exposure = seconds
    assert refused.value.hint == "the camera can do 0.001 to 3 s"
    assert camera.seconds == 0.01


def test_a_stated_exposure_stays() -> None:
    camera = Still(stated=0.2)
    assert camera.exposure == 0.2
    with pytest.raises(DeviceError, match="cannot be set from here"):
        camera.exposure = 0.2
    facts = camera.info()
    assert (facts["shortest_exposure"], facts["longest_exposure"]) == (0.2, 0.2)


def test_facts_of_a_camera() -> None:
    expected: dict[str, Any] = {
        "name": "Still 7",
        "kind": "still",
        "address": "still:1",
        "shape": (3, 4),
        "bits": 12,
        "trigger": "free",
        "shortest_exposure": 0.001,
        "longest_exposure": 3.0,
    }
    assert Still().info() == expected


def test_a_closed_camera_does_nothing() -> None:
    camera = Still()
    camera.trigger()
    camera.close()
    camera.close()
    for use in (camera.trigger, lambda: setattr(camera, "exposure", 0.1)):
        with pytest.raises(DeviceError, match="still:1: is closed"):
            use()


def test_a_frame_that_does_not_come_is_named() -> None:
    with pytest.raises(FrameTimeoutError, match=r"still:1: no frame within 0\.5 s: it is dark"):
        Still().get_image(0.5)


def test_the_user_states_an_exposure() -> None:
    assert stated_exposure(Address.parse("video:0,exposure=0.25")) == 0.25
    with pytest.raises(InputError, match="nothing says how long") as refused:
        stated_exposure(Address.parse("video:0"))
    assert "video:0,exposure=SECONDS" in (refused.value.hint or "")
