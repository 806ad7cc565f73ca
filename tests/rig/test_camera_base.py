"""What cameras do alike: exposures within limits, frame numbers, timestamps and pixel formats."""

from __future__ import annotations

import numpy as np
import pytest

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.rig.devices.base import Address, Camera, Frame, FrameStamps
from lightmatrix.rig.devices.genicam import FORMATS, PixelFormat, choose_format


class Still(Camera):
    """A camera that takes no pictures."""

    kind = "still"

    def __init__(self, stated: float | None = None) -> None:
        super().__init__(Address.parse("still:1"))
        self._stated, self.seconds = stated, 0.01

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


@pytest.mark.parametrize("seconds", [0.001, 0.001 * (1 - 5e-10), 0.5, 3.0 * (1 + 5e-10)])
def test_exposures_within_the_limits_are_set(seconds: float) -> None:
    camera = Still()
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
    with pytest.raises(DeviceError, match="cannot be set from here"):
        camera.exposure = 0.2
    facts = camera.info()
    assert camera.exposure == facts["shortest_exposure"] == facts["longest_exposure"] == 0.2
    assert Address.parse("video:0,exposure=0.25").stated_exposure == 0.25
    with pytest.raises(InputError, match="nothing says how long") as refused:
        _ = Address.parse("video:0").stated_exposure
    assert "video:0,exposure=SECONDS" in (refused.value.hint or "")


def test_a_frame_that_does_not_come_is_named() -> None:
    with pytest.raises(FrameTimeoutError, match=r"still:1: no frame within 0\.5 s: it is dark"):
        Still().get_image(0.5)


def test_a_frame_that_lay_in_a_queue_keeps_its_time() -> None:
    stamps = FrameStamps()
    random = np.random.default_rng(0)
    offset = 1234.5
    for k in range(200):
        exposed = 10 + k / 50
        # 1 ms on the way at least, and now and then half a second in a queue.
        arrival = exposed + 0.001 + random.exponential(0.002) + 0.5 * (k % 7 == 6)
        timestamp = stamps.time(exposed + offset, arrival)
        assert timestamp <= arrival
        if k > 20:
            assert timestamp == pytest.approx(exposed + 0.001, abs=0.001)


def test_a_camera_whose_clock_begins_again() -> None:
    stamps = FrameStamps()
    assert stamps.time(1000.0, 5.0) == 5.0
    assert stamps.time(0.5, 6.0) == 6.0
    assert stamps.time(1.5, 7.2) == pytest.approx(7.0)
    # And one that has none.
    assert stamps.time(None, 8.0) == 8.0


@pytest.mark.parametrize(
    ("offered", "best"),
    [
        (("Mono8", "Mono12", "Mono12Packed"), "Mono12"),
        (("RGB8", "BayerRG12", "BayerRG8"), "BayerRG12"),
        (("BGR8", "Mono8"), "Mono8"),
    ],
)
def test_the_best_format_that_can_be_read_is_taken(offered: tuple[str, ...], best: str) -> None:
    assert choose_format("camera", offered).name == best


def test_formats_that_cannot_be_read_are_named() -> None:
    with pytest.raises(DeviceError, match="none of its pixel formats can be read: Mono10p, YUV"):
        choose_format("camera", ("Mono10p", "YUV422_8"))
    with pytest.raises(DeviceError, match="Mono10p is not unpacked") as caught:
        choose_format("camera", ("Mono10p", "Mono8"), "Mono10p")
    assert "Mono8" in str(caught.value.hint)


@pytest.mark.parametrize("known", FORMATS, ids=lambda known: known.name)
def test_bytes_become_images(known: PixelFormat) -> None:
    shape = (3, 5) if known.channels == 1 else (3, 5, known.channels)
    image = np.random.default_rng(0).integers(0, 2**known.bits, shape).astype(known.dtype)
    sent = image[..., ::-1] if known.reverse else image
    # With a tail, as buffers have.
    data = sent.tobytes() + b"tail"
    np.testing.assert_array_equal(known.image(data, 3, 5), image)
    assert known.clip_level == 2**known.bits - 1
    with pytest.raises(DeviceError, match="delivered"):
        known.image(data[:10], 3, 5)
