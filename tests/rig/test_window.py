"""The window shows images exact to the bit, on the monitor that was asked for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Address, Projector
from lightmatrix.rig.devices.window import WindowProjector, find_windows, open_window

from .conftest import SCREEN, SECOND
from .contract import ProjectorContract

pytest.importorskip("glfw", reason="glfw is missing: make test-install")
pytest.importorskip("moderngl", reason="moderngl is missing: make test-install")
mss = pytest.importorskip("mss", reason="mss is missing: make test-install")


class TestWindow(ProjectorContract):
    """On a single screen, and on the second of two."""

    @pytest.fixture(params=["screen", "two_screens"])
    def projector(self, request: pytest.FixtureRequest) -> Iterator[WindowProjector]:
        request.getfixturevalue(request.param)
        alone = request.param == "screen"
        self._left, self._size = (0, SCREEN) if alone else (SCREEN[1], SECOND)
        window = open_window(Address("window", "" if alone else "1"))
        assert window.shape == self._size
        with mss.MSS() as self._grabber:
            yield window
        window.close()

    def shown(self, projector: Projector) -> NDArray[np.uint8]:
        rows, cols = self._size
        area = {"left": self._left, "top": 0, "width": cols, "height": rows}
        return np.asarray(self._grabber.grab(area))[..., 2::-1]


def test_the_second_monitor_is_taken_where_there_is_one(two_screens: str) -> None:
    devices = find_windows()
    assert [device.address for device in devices] == ["window:0", "window:1"]
    assert "DUMMY1, 600 x 800 at" in devices[1].description
    for address in (Address("window"), Address("window", "DUMMY1")):
        window = open_window(address)
        assert (window.info()["monitor"], window.info()["name"]) == (1, "DUMMY1")
        assert window.info()["refresh"] > 0
        window.close()


def test_a_key_asks_to_end(two_screens: str) -> None:
    window = open_window(Address("window", "0"))
    assert not window.asked_to_end()
    window._pressed(None, 65)
    assert window.asked_to_end()
    window.close()


def test_windows_on_both_monitors(two_screens: str) -> None:
    first, second = open_window(Address("window", "0")), open_window(Address("window", "1"))
    for _ in range(3):
        first.black()
        second.black()
    first.close()
    # The other one stays.
    second.black()
    second.close()


def test_gamma_ramps_are_made_straight(two_screens: str) -> None:
    import glfw

    def middle() -> float:
        red = np.array(glfw.get_gamma_ramp(monitor).red)
        return float(red[len(red) // 2] / red[-1])

    shown = open_window(Address("window", "0"))
    monitor = glfw.get_monitors()[1]
    try:
        # Another program bends it, such as one that spares the eyes at night.
        glfw.set_gamma(monitor, 2.2)
        assert middle() == pytest.approx(0.5 ** (1 / 2.2), abs=0.01)
        straight = open_window(Address("window", "1", {"gamma": "linear"}))
        assert middle() == pytest.approx(0.5, abs=0.01)
        straight.close()
    finally:
        shown.close()


def test_a_closed_window_is_noticed(screen: str) -> None:
    import glfw

    window = open_window(Address("window"))
    glfw.set_window_should_close(window._window, True)
    with pytest.raises(DeviceError, match="was closed"):
        window.black()
    window.close()


@pytest.mark.parametrize(
    ("address", "kind", "words"),
    [
        (Address("window", "2"), DeviceError, r"no such monitor; there are: 0 \(screen\)"),
        (Address("window", "HDMI-9"), DeviceError, "no such monitor"),
        (Address("window", "0", {"gama": "linear"}), InputError, "no option 'gama'"),
        (Address("window", "0", {"gamma": "2"}), InputError, "gamma is '2'"),
    ],
)
def test_what_cannot_be_opened(
    screen: str, address: Address, kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words):
        open_window(address)


def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(DeviceError, match=r"no display.*\(X11: .*; neither DISPLAY nor") as caught:
        open_window(Address("window"))
    assert "DISPLAY=:0" in str(caught.value.hint)
