"""`project` shows pictures pixel by pixel, as long as it should, and what the camera sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.errors import DeviceError
from lightmatrix.rig.devices.base import Projector
from lightmatrix.rig.devices.virtual import SimulatedClock
from lightmatrix.rig.rig import ProjectedPatterns

RIG = "virtual:procedural,size=16,real=0"


class _Screen(Projector):
    """Keeps what it was asked to show; its user presses a key at the fourth picture."""

    def __init__(self, *, closes: bool = False) -> None:
        self._shape, self._closes = (6, 8), closes
        self.images: list[NDArray[np.uint8]] = []

    def info(self) -> dict[str, Any]:
        return {"name": "screen", "shape": self._shape}

    def show(self, image: NDArray[np.uint8]) -> float:
        self.images.append(image)
        if self._closes and self.asked_to_end():
            raise DeviceError("the window was closed")
        return 0.0

    def asked_to_end(self) -> bool:
        return len(self.images) >= 4

    def close(self) -> None:
        pass


@pytest.mark.parametrize("closes", [False, True])
def test_a_picture_stays_until_a_key_is_pressed(closes: bool) -> None:
    """Unscaled in the middle, whether the key ends it or closes the window."""
    screen = _Screen(closes=closes)
    picture = np.arange(12).reshape(3, 4) / 11
    lm.project(screen, picture, fps=1000)
    assert len(screen.images) == 4
    expected = np.zeros((6, 8), np.uint8)
    expected[1:4, 2:6] = np.rint(255 * picture)
    for image in screen.images:
        np.testing.assert_array_equal(image, expected)


def test_cells_colours_and_light() -> None:
    screen = _Screen()
    picture = np.random.default_rng(0).random((3, 4, 3))
    lm.project(screen, picture, cell=2, projector_response="gamma:2", until=lambda: True)
    assert len(screen.images) == 1
    grey = np.sqrt(picture).repeat(2, axis=0).repeat(2, axis=1)
    assert np.abs(screen.images[0] / 255 - grey).max() < 0.003
    with pytest.raises(lm.InputError, match="a picture of 10 x 8 pixels, for a projector of 6 x 8"):
        lm.project(screen, np.zeros((5, 4)), cell=2)
    with pytest.raises(lm.InputError, match="a photograph without a camera"):
        lm.project(screen, picture, photograph="seen.png")


def test_folders_and_videos_begin_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Nobody waits, and a busy machine shows as many pictures.
    monkeypatch.setattr("lightmatrix.rig.showing.Clock", SimulatedClock)
    (tmp_path / "frames").mkdir()
    for k in range(2):
        lm.write_image(tmp_path / "frames" / f"{k}.png", np.full((6, 8), 100 * k, np.uint8))
    with av.open(str(tmp_path / "film.mp4"), "w") as film:
        stream = film.add_stream("mpeg4", rate=50)
        stream.width, stream.height, stream.pix_fmt = 8, 6, "yuv420p"
        for k in range(2):
            frame = av.VideoFrame.from_ndarray(np.full((6, 8, 3), 100 * k, np.uint8), "rgb24")
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
    for source in ("frames", "film.mp4"):
        screen = _Screen()
        lm.project(screen, tmp_path / source, fps=1000 if source == "frames" else None)
        means = [image.mean() for image in screen.images]
        np.testing.assert_allclose(means, [0, 100, 0, 100], atol=8)
    screen = _Screen()
    lm.project(screen, tmp_path / "film.mp4", seconds=0.03)
    # 50 pictures a second.
    assert len(screen.images) == 2


def test_a_photograph_shows_what_the_camera_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    picture = np.kron(np.random.default_rng(1).integers(0, 2, (4, 4)), np.ones((4, 4)))
    with lm.open_rig(RIG) as rig:
        assert rig.truth is not None
        expected = rig.truth.transport().relight(picture)
        seen = lm.project(rig, picture, photograph="seen.npy")
    assert seen is not None
    factor = float((seen * expected).sum() / (expected**2).sum())
    assert np.abs(seen - factor * expected).max() < 0.05
    np.testing.assert_array_equal(lm.read_image("seen.npy"), seen)
    lm.write_image("shown.png", picture)
    assert main(["project", "shown.png", "--rig", RIG, "-o", "seen.png"]) == 0
    assert "seen.png" in capsys.readouterr().out
    light = (lm.read_image("seen.png") / 255) ** 2.2
    assert np.abs(light - np.clip(seen, 0, 1)).max() < 0.05
    for words, reason in (
        ("", "no projector"),
        (f"--rig {RIG}", "nobody sees a virtual rig"),
        (f"--rig {RIG} -o seen.png", "exists already"),
    ):
        assert main(["project", "shown.png", *words.split()]) == 2
        assert reason in capsys.readouterr().err
    assert (
        main(["project", "shown.png", "--projector", "folder:f,size=16x16", "--seconds", "0.01"])
        == 0
    )
    np.testing.assert_array_equal(lm.read_image("f/shown.png"), np.rint(255 * picture))


def test_portrait_patterns_on_a_landscape_projector_are_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = f"patterns bernoulli -k 2 --size 8x6 -o {tmp_path}/p"
    assert main(words.split()) == 0
    assert "for a projector in portrait, 6 pixels wide, or for several" in capsys.readouterr().out
    with pytest.warns(lm.LightMatrixWarning, match="8 rows by 6 columns, and the projector is"):
        ProjectedPatterns(lm.read_patterns(tmp_path / "p"), (10, 16))
