"""What every back end does alike. A new one is a file and a subclass of one of these."""

from __future__ import annotations

import json
import time
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.rig.devices.base import Camera, Projector


class ProjectorContract:
    """Subclasses give the fixture `projector`, and say what it shows now."""

    def shown(self, projector: Projector) -> NDArray[np.uint8]:
        """What can be seen, (rows, cols, 3)."""
        raise NotImplementedError

    def test_info_is_ready_for_json(self, projector: Projector) -> None:
        info = json.loads(json.dumps(projector.info()))
        assert info["name"]
        assert info["shape"] == list(projector.shape)

    def test_64_patterns_are_shown_exact_to_the_bit(self, projector: Projector) -> None:
        random = np.random.default_rng(1)
        for k in range(64):
            # Binary, grey and colour in turn.
            shape = projector.shape if k % 4 else (*projector.shape, 3)
            image = random.integers(0, 256, shape, np.uint8)
            if k % 2:
                image = np.where(image > 127, 255, 0).astype(np.uint8)
            projector.show(image)
            seen = self.shown(projector)
            wanted = image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)
            np.testing.assert_array_equal(seen, wanted)

    def test_it_says_when(self, projector: Projector) -> None:
        before = time.monotonic()
        shown = projector.show(np.full(projector.shape, 7, np.uint8))
        black = projector.black()
        assert before <= shown <= black <= time.monotonic()
        assert not self.shown(projector).any()

    @pytest.mark.parametrize("wrong", ["shape", "channels", "type"])
    def test_what_it_cannot_show_pixel_by_pixel_is_refused(
        self, projector: Projector, wrong: str
    ) -> None:
        rows, cols = projector.shape
        images: dict[str, Any] = {
            "shape": np.zeros((rows, cols + 1), np.uint8),
            "channels": np.zeros((rows, cols, 2), np.uint8),
            "type": np.zeros((rows, cols), np.float32),
        }
        with pytest.raises(InputError, match="projector"):
            projector.show(images[wrong])

    def test_closing_twice(self, projector: Projector) -> None:
        projector.close()
        projector.close()
        with pytest.raises(DeviceError, match="closed"):
            projector.black()


class CameraContract:
    """Subclasses give the fixture `camera`, and have it take frames."""

    # Whether the exposure can be set, and the camera waits to be asked for each frame.
    exposes: ClassVar[bool] = True
    triggered: ClassVar[bool] = True

    def take(self, camera: Camera) -> None:
        """Have a frame taken that `get_image` will find; nothing where frames come on their own."""
        camera.trigger()

    def test_info_is_ready_for_json(self, camera: Camera) -> None:
        assert json.dumps(camera.info())
        self.take(camera)
        frame = camera.get_image(60)
        # What comes as files is known from the first one on.
        info = json.loads(json.dumps(camera.info()))
        assert info["name"]
        assert info["bits"] in (8, 10, 12, 14, 16)
        assert list(frame.data.shape) == info["shape"]
        assert frame.data.dtype == (np.uint8 if info["bits"] == 8 else np.uint16)
        assert frame.clip_level == 2 ** info["bits"] - 1

    def test_the_exposure_is_in_seconds_and_read_back(self, camera: Camera) -> None:
        if not self.exposes:
            with pytest.raises(DeviceError, match="exposure"):
                camera.exposure = 0.01
            return
        for seconds in (0.005, 0.01):
            camera.exposure = seconds
            assert camera.exposure == pytest.approx(seconds, rel=0.2)
        camera.exposure = 0.01
        for impossible in (0.0, -1.0, 1e6, float("nan")):
            with pytest.raises(InputError, match="exposure"):
                camera.exposure = impossible
        assert camera.exposure == pytest.approx(0.01, rel=0.2)

    def test_frames_are_dated(self, camera: Camera) -> None:
        frames, copies, asked = [], [], []
        for _ in range(5):
            asked.append(time.monotonic())
            self.take(camera)
            frames.append(camera.get_image(60))
            copies.append(frames[-1].data.copy())
        times = [frame.timestamp for frame in frames]
        assert len(set(times)) == len(times)
        assert times[-1] <= time.monotonic()
        if self.triggered:
            assert times == sorted(times)
            assert all(when < taken for when, taken in zip(asked, times, strict=True))
        else:
            assert asked[0] - 1 < times[0]
            # On a busy machine the first frames may arrive late, and only later ones tell.
            assert all(later > earlier - 0.5 for earlier, later in pairwise(times))
        for frame, copy in zip(frames, copies, strict=True):
            np.testing.assert_array_equal(frame.data, copy)

    def test_flush_throws_old_frames_away(self, camera: Camera) -> None:
        self.take(camera)
        time.sleep(0.3)
        flushed = time.monotonic()
        camera.flush()
        self.take(camera)
        # A frame that was on its way when the others were thrown away may be a little older.
        assert camera.get_image(60).timestamp > flushed - 0.1
        if self.triggered:
            with pytest.raises(FrameTimeoutError):
                camera.get_image(0.1)

    def test_no_frame_in_time(self, camera: Camera) -> None:
        # One that never stops has no frame at once.
        timeout = 0.2 if self.triggered else 0.0
        camera.flush()
        before = time.monotonic()
        with pytest.raises(FrameTimeoutError, match=f"no frame within {timeout:g} s") as caught:
            camera.get_image(timeout)
        assert timeout * 0.7 <= time.monotonic() - before < 60
        assert caught.value.hint
        # And goes on as if nothing had been.
        self.take(camera)
        camera.get_image(60)

    def test_closing_twice(self, camera: Camera) -> None:
        camera.close()
        camera.close()
        for use in (lambda: camera.get_image(0.1), camera.flush, camera.trigger):
            with pytest.raises(DeviceError, match="closed"):
                use()
