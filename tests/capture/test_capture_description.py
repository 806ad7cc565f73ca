"""capture.json, what lies beside it, and the level that T is in units of."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lightmatrix as lm
from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.folder import read_white_frame, write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.files.images import write_image
from lightmatrix.patterns.folder import read_patterns, write_patterns
from lightmatrix.solvers.active_set import ActiveSet
from tests.helpers.captures import COUNT, SETS, light, photographs, write_folders, write_plain
from tests.helpers.systems import PIPES

DARK = np.full((5, 7), 20, np.uint8)


def describe(place: Path, **change: Any) -> None:
    file = place / "capture.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))


# Values of another kind or out of range, by key.
WRONG: dict[str, list[Any]] = {
    "exposure": [True, None, "1", [], {"a": 1}, [1, "2"], [1, 0], [[1] * 9], -1, 10**400],
    "clip": [None, "255", True, [], {"level": 255}, 0, 1e300],
    "black_level": ["2", -1, True, [], {}, -1e300],
    "full_scale": [1e300, 0, -1, "255", True, []],
    "response": [2.2, "", True, {}, "gamma:0"],
    "mask": [1, "a\0b", True, {}],
    "provenance": ["text", [1], True],
    "camera_shape": [None, "5x7", 64, [0, 7], [5.0, 7.0], [[5], [7]]],
    "projector_shape": [48, {}, "6x8"],
    "black": [[], {}, True, 7, "black.png", {"file": None}, {"file": 3}, {"file": {}}]
    + [{"file": "black.png", "exposure": each} for each in (None, 0, -1, "1", [], [0.8] * 9)]
    + [{"file": "black.png", key: 1} for key in ("exposrue", "exposures", "File", "level")],
    "version": [0, "1", None, [1], 1e300],
}


@pytest.mark.parametrize("key", WRONG)
def test_values_of_another_kind_or_out_of_range(tmp_path: Path, key: str) -> None:
    place = write_plain(tmp_path)
    write_image(place / "black.png", np.zeros((5, 7), np.uint8))
    before = (place / "capture.json").read_text()
    for value in WRONG[key]:
        describe(place, **{key: value})
        with pytest.raises(InputError, match=rf"capture\.json: .*{key}"):
            Capture.open(place)
        (place / "capture.json").write_text(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('{"a": 1, "a": 2}', "twice"),
        ('{"exposure": NaN}', "NaN is not a number in JSON"),
        ("", "cannot be read"),
        ('"text"', "is not a lightmatrix-capture file"),
        ("[1]", "is not a lightmatrix-capture file"),
        ("null", "is not a lightmatrix-capture file"),
        ("  \n", "cannot be read"),
        ("{exposure: 0.5}", "cannot be read"),
        ('{"format": "lightmatrix-capture"', "cannot be read"),
        ('{"format": "lightmatrix-capture", "version": true}', "format version True"),
    ],
)
def test_damaged_json_is_refused(tmp_path: Path, text: str, message: str) -> None:
    place = write_plain(tmp_path)
    (place / "capture.json").write_text(text)
    with pytest.raises(InputError, match=message):
        Capture.open(place)


@PIPES
def test_how_a_description_may_be_stored(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    file = place / "capture.json"
    expected, text = Capture.open(place).digest, file.read_text()
    file.write_text(text, encoding="utf-8-sig")
    assert Capture.open(place).digest == expected
    file.write_bytes(text.encode() + b"\xff")
    with pytest.raises(InputError, match="is not UTF-8"):
        Capture.open(place)
    file.write_text(text + " " * (17 << 20))
    with pytest.raises(InputError, match="is larger than 16 MiB"):
        Capture.open(place)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(InputError, match="is a pipe or device"):
        Capture.open(place)
    file.unlink()
    file.symlink_to(tmp_path / "nowhere.json")
    with pytest.raises(InputError, match="is a link that leads nowhere"):
        Capture.open(place)


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture, and beside its description a copy of it."""
    place = write_plain(tmp_path_factory.mktemp("described"))
    shutil.copyfile(place / "capture.json", place / "as-it-was.json")
    return place


@given(
    st.dictionaries(
        st.sampled_from(["exposure", "clip", "black_level", "full_scale", "mask", "black", "x"]),
        st.recursive(
            st.none() | st.booleans() | st.floats(allow_nan=False) | st.integers() | st.text(),
            lambda inner: (
                st.lists(inner, max_size=9)
                | st.dictionaries(st.sampled_from(["file", "exposure", "y"]), inner)
            ),
            max_leaves=9,
        ),
    )
)
@settings(max_examples=60, deadline=None)
def test_any_description_is_read_or_refused(described: Path, change: dict[str, Any]) -> None:
    place = described
    shutil.copyfile(place / "as-it-was.json", place / "capture.json")
    describe(place, **change)
    try:
        capture = Capture.open(place)
    except InputError:
        return
    assert np.isfinite(capture.samples().values).all()


def test_files_of_a_capture_lie_in_its_folder(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    write_image(tmp_path / "outside.png", DARK)
    (tmp_path / "curve.txt").write_text("0 0\n1 1\n")
    (place / "link.png").symlink_to(tmp_path / "outside.png")
    (place / "loop.png").symlink_to(place / "loop.png")
    write_image(place / "inside.png", DARK)
    (place / "near.png").symlink_to("inside.png")
    absolute = str(tmp_path / "outside.png")
    for name in (absolute, "../outside.png", "images/../../outside.png", "link.png"):
        for change in ({"black": {"file": name}}, {"mask": name}):
            describe(place, **{"black": None, "mask": None, **change})
            with pytest.raises(InputError, match="lies outside its folder"):
                Capture.open(place)
            Capture.open(place, allow_outside=True)
    describe(place, black=None, mask="loop.png")
    with pytest.raises(InputError, match=r"loop\.png"):
        Capture.open(place)
    describe(place, mask="near.png", black={"file": "images/../inside.png"})
    Capture.open(place)
    describe(place, mask=None, black=None, response="curve:../curve.txt")
    with pytest.raises(InputError, match="lies outside its folder"):
        Capture.open(place)
    Capture.open(place, allow_outside=True)


def test_a_description_spelled_otherwise_is_refused(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    (place / "capture.json").rename(place / "Capture.json")
    with pytest.raises(InputError, match=r"Capture\.json: is not read under this name"):
        Capture.open(place)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"black_level": [0, 0, 0]}, r"black_level has 3 values"),
        ({"clip": 300}, r"a clip level of 300"),
        ({"response": "film"}, r"a response of 'film'"),
        ({"mask": "."}, r"names '\.', which is a folder"),
        ({"black": {"file": "gone.png"}}, r".*gone\.png: no such file"),
        ({"exposures": 1}, "does not know 'exposures'"),
        ({"camera_shape": [5, 8]}, r"camera_shape is \[5, 8\], but the images have \[5, 7\]"),
        ({"projector_shape": [8, 6]}, "projector_shape is"),
        ({"exposure": [1, 2]}, "exposure has 2 values for 9 frames"),
        ({"black_level": 255}, "a black level of 255"),
        ({"version": 2}, "has format version 2"),
        ({"format": "other"}, "is not a lightmatrix-capture file"),
    ],
)
def test_messages_about_levels_name_the_description(
    tmp_path: Path, change: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = write_plain(tmp_path)
    describe(place, **change)
    for folder in (place, Path()):
        with pytest.raises(InputError, match=rf"capture\.json: {message}"):
            Capture.open(folder)
        monkeypatch.chdir(place)


def test_a_black_frame_has_the_depth_of_the_frames(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    describe(place, black={"file": "black.png"})
    write_image(place / "black.png", DARK.astype(np.uint16) * 257)
    with pytest.raises(InputError, match=r"^[^:]*black\.png: the black frame is uint16"):
        Capture.open(place)
    write_image(place / "black.png", DARK, overwrite=True)
    expected = Capture.open(place)
    # The mean of several.
    write_image(place / "mean.npy", DARK.astype(np.float32))
    describe(place, black={"file": "mean.npy"})
    np.testing.assert_allclose(Capture.open(place).samples().values, expected.samples().values)


# ---- response curves


@pytest.mark.parametrize(
    "content", ["root:x:0:0:secret", "1 2\nsecret 3\n", "", "\n#\n", "1 2\n3\n"]
)
@pytest.mark.parametrize("name", ["curve.txt", "curve.npy"])
def test_a_damaged_curve_is_not_quoted(tmp_path: Path, name: str, content: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match="no table of numbers") as refused:
        Response.parse(f"curve:{tmp_path / name}")
    assert "secret" not in str(refused.value)


@PIPES
def test_curves_are_regular_files_of_a_sane_size(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, message in (
        ("/dev/zero", "is a pipe or device"),
        (str(tmp_path / "pipe"), "is a pipe or device"),
        (str(tmp_path), "is a folder"),
    ):
        with pytest.raises(InputError, match=message):
            Response.parse(f"curve:{name}")
    (tmp_path / "long").write_text("0 0\n" * (5 << 20))
    with pytest.raises(InputError, match="is larger than"):
        Response.parse(f"curve:{tmp_path / 'long'}")
    np.save(tmp_path / "wrong.npy", np.array([[0, 0], [-1, 1], [np.inf, 2]]))
    np.save(tmp_path / "negative.npy", np.array([[-2.0, 0], [-1, 1]]))
    np.save(tmp_path / "box.npy", np.zeros((2, 2, 2)))
    np.save(tmp_path / "dark.npy", np.array([[0.0, -1], [255, 1]]))
    np.save(tmp_path / "huge.npy", np.array([[0, 0], [255, 1e308]]))
    np.save(tmp_path / "falling.npy", np.array([[0, 1], [128, 0.5], [255, 0]]))
    np.save(tmp_path / "nan.npy", np.array([[0, 0], [128, np.nan], [255, 1]]))
    for name in ("wrong", "negative", "box", "dark", "huge", "falling", "nan"):
        with pytest.raises(InputError):
            Response.parse(f"curve:{tmp_path / name}.npy")


# ---- what lies beside it


def test_a_black_frame_or_mask_is_never_ignored_silently(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    write_image(place / "Black.PNG", DARK)
    mask = np.full((5, 7), 255, np.uint8)
    mask[0, 0] = 0
    with pytest.warns(LightMatrixWarning, match=r"Black\.PNG: is not used, since capture\.json"):
        Capture.open(place)
    # It points to the line that opens the capture, not to one of the package.
    with pytest.warns(LightMatrixWarning) as warned:
        Capture.open(place)
    assert warned[0].filename == __file__
    describe(place, black=None)
    Capture.open(place)
    describe(place, black={"file": "Black.PNG"}, black_level=0)
    expected = Capture.open(place)
    (place / "capture.json").unlink()
    with pytest.warns(LightMatrixWarning, match=r"Black\.PNG: is used as the black frame"):
        capture = Capture.open(place)
    assert capture.digest == expected.digest
    write_image(place / "mask.tif", mask)
    with (
        pytest.warns(LightMatrixWarning, match="is used as the mask"),
        pytest.warns(LightMatrixWarning, match="is used as the black frame"),
    ):
        assert np.flatnonzero(~Capture.open(place).valid).tolist() == [0]
    write_image(place / "black.npy", DARK)
    with pytest.raises(InputError, match=r"holds Black\.PNG and black\.npy"):
        Capture.open(place)


def test_photographs_of_other_patterns_are_refused(tmp_path: Path) -> None:
    shown, other = lm.BernoulliPatterns((8, 8), 6), lm.BernoulliPatterns((4, 16), 6)
    lm.simulate(lm.ProceduralScene((6, 6), (8, 8)).truth(), shown).save(tmp_path / "c")
    for file in (tmp_path / "c/images/image_0002.png", tmp_path / "c/patterns/pattern_0002.png"):
        file.unlink()
    # What is left of a set belongs to it.
    (tmp_path / "c/patterns/patterns.json").unlink()
    assert Capture.open(tmp_path / "c").patterns.count == 5
    place = tmp_path / "c/images"
    with pytest.raises(InputError, match=r"capture\.json: 6 of the 6 patterns.* pattern 0 "):
        Capture.from_folders(other, place)
    with pytest.raises(InputError, match="6 of the 6"):
        lm.check(patterns=other, images=place)
    file = tmp_path / "c/capture.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "patterns": [1]}))
    with pytest.raises(InputError, match='remove "patterns"'):
        Capture.open(tmp_path / "c")


def test_the_size_of_described_patterns_is_checked_first(tmp_path: Path) -> None:
    write_patterns(tmp_path / "patterns", SETS[0])
    file = tmp_path / "patterns" / "patterns.json"
    content = json.loads(file.read_text())
    for change in ({"shape": [10**9, 10**9]}, {"count": 10**12}, {"shape": "huge"}):
        file.write_text(json.dumps({**content, "description": content["description"] | change}))
        with pytest.warns(LightMatrixWarning, match="the images are used"):
            np.testing.assert_array_equal(
                read_patterns(tmp_path / "patterns").images(), SETS[0].images()
            )
    file.unlink()
    file.symlink_to("nowhere")
    with pytest.raises(InputError, match="leads nowhere"):
        read_patterns(tmp_path / "patterns")


# ---- the unit of T


@pytest.mark.parametrize("pedestal", [0.0, 0.05])
@pytest.mark.parametrize("room", [0.0, 0.1, 0.3])
def test_room_light_does_not_change_the_unit(tmp_path: Path, room: float, pedestal: float) -> None:
    """With a black frame, in plain folders, in a capture folder and without its description."""
    patterns, sensor = SETS[3], Sensor(black_level=pedestal, bits=None)
    received = 0.3 * light(patterns) / light(patterns).max()
    ambient = room * np.linspace(0.5, 1, len(received))[:, None]
    frames = sensor.expose(received + ambient).T.reshape(COUNT, 5, 7)
    black = sensor.expose(ambient).reshape(5, 7)
    for k, frame in enumerate(frames):
        write_image(tmp_path / "photos" / f"{k}.npy", frame)
    write_image(tmp_path / "black.npy", black)
    black_file = tmp_path / "black.npy"
    plain = Capture.from_folders(
        patterns, tmp_path / "photos", ReadSettings(black=black_file, black_level=pedestal or None)
    )
    place = tmp_path / "c"
    write_capture(place, patterns, frames, sensor=sensor, black=black)
    captures = [plain, Capture.open(place)]
    if not pedestal:
        (place / "capture.json").unlink()
        with pytest.warns(LightMatrixWarning, match="is used as the black frame"):
            captures.append(Capture.open(place))
    for capture in captures:
        samples = capture.samples()
        np.testing.assert_allclose(samples.values, received, atol=2e-6)
        # Room light leaves less room below the level at which the camera clips.
        assert np.abs(samples.clip_level - (1 - ambient)).max() < 2e-6
    estimated = PlainEstimator(ActiveSet(), 0.01, background=False).estimate(plain)
    known = Capture.from_arrays(patterns, received.T.reshape(COUNT, 5, 7), Decoder(1, 1))
    expected = PlainEstimator(ActiveSet(), 0.01, background=False).estimate(known)
    np.testing.assert_allclose(
        estimated.sparse.toarray(), expected.sparse.toarray(), atol=2e-3, rtol=1e-2
    )
    write_image(tmp_path / "white.npy", frames[0])
    white = read_white_frame(
        tmp_path / "white.npy", ReadSettings(black=black_file, black_level=pedestal)
    )
    np.testing.assert_allclose(white.values[:, 0], received[:, 0], atol=2e-6)


def test_a_scaled_black_frame_requires_a_black_level(tmp_path: Path) -> None:
    place = write_plain(tmp_path)
    write_image(place / "black.png", DARK)
    file = place / "capture.json"
    content = {k: v for k, v in json.loads(file.read_text()).items() if k != "black_level"}
    black = {"file": "black.png", "exposure": 0.5}
    file.write_text(json.dumps(content | {"black": black}))
    with pytest.raises(InputError, match="no black level is given"):
        Capture.open(place)
    describe(place, black_level=16)
    # 16 + (20 - 16) * 2 is subtracted.
    samples = Capture.open(place).samples()
    expected = Capture.from_arrays(
        SETS[0], photographs(SETS[0], Sensor()), Decoder(255, 255, 16, black_frame=np.full(35, 24))
    ).samples()
    np.testing.assert_allclose(samples.values, expected.values, atol=1e-6)


def test_a_black_level_is_given_once(tmp_path: Path) -> None:
    patterns, photos = write_folders(tmp_path, SETS[3], photographs(SETS[3], Sensor()))
    with pytest.raises(InputError, match="give the black level once"):
        Capture.from_folders(patterns, photos, ReadSettings(black=20, black_level=20))
    level = Capture.from_folders(patterns, photos, ReadSettings(black_level=20)).samples()
    number = Capture.from_folders(patterns, photos, ReadSettings(black=20)).samples()
    np.testing.assert_array_equal(level.values, number.values)
    shutil.rmtree(photos)
