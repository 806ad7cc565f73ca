"""Matrices that stay in Python: what a window is told, and that nothing but its messages counts."""

from __future__ import annotations

import json
import os
import struct
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.pictures import maps
from lightmatrix.simulation.truth import binned
from lightmatrix.transport import store as stores
from lightmatrix.viewer import lights, packed, session
from lightmatrix.viewer.layers import LayerSource
from lightmatrix.viewer.scene import ViewedScene
from lightmatrix.viewer.session import MessageError, MessageKind
from tests.viewer import hostile, running

# What a window shows may miss T p by this share of the white image.
CLOSE = 1e-3


class Window:
    """The page's side of a session: it puts together what it is sent."""

    def __init__(self, scene: ViewedScene) -> None:
        self.session = scene.session()
        rows, cols, *channels = scene.matrix.camera_shape
        self.image = np.zeros((rows, cols, *(channels or [1])), np.float32)
        self.levels = np.zeros(scene.matrix.projector_shape, np.uint8)
        self.parts: list[dict[str, Any]] = []

    def paint(self, top: int, left: int, levels: NDArray[np.uint8], *, finish: bool = True) -> None:
        rows, cols = levels.shape
        self.levels[top : top + rows, left : left + cols] = levels
        numbers = (MessageKind.PAINT, 7, top, left, rows, cols)
        for part in self.session.answer(struct.pack("<6I", *numbers) + levels.tobytes()):
            self.receive(part)
        assert self.parts[-1]["answers"] == 7
        while finish and self.session.unfinished:
            self.finish()

    def finish(self) -> None:
        part = self.session.finish()
        if part is not None:
            self.receive(part)

    def receive(self, part: bytes) -> None:
        header, values = unpack(part)
        self.parts.append(header)
        if header["kind"] == "samples":
            place = header["arrays"]["samples"]
            start = 12 + int.from_bytes(part[8:12], "little") + place["offset"]
            samples = np.frombuffer(part[start : start + 4 * place["count"]], np.uint32)
            self.image.reshape(-1)[samples] = values
        elif header["kind"] == "tiles":
            place_tiles(self.image, header["tiles"], values)

    def ask(
        self, kind: MessageKind, row: int, col: int, shape: tuple[int, ...]
    ) -> NDArray[np.float32]:
        (part,) = self.session.answer(struct.pack("<4I", kind, 3, row, col))
        header, values = unpack(part)
        assert (header["kind"], header["answers"]) == ("image", 3)
        image = np.zeros(shape, np.float32)
        place_tiles(image, header["tiles"], values)
        return image


def unpack(part: bytes) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """The header and the values of a message, as packed.js reads them."""
    length = int.from_bytes(part[8:12], "little")
    header = json.loads(part[12 : 12 + length])
    if "values" not in header["arrays"]:
        return header, np.zeros(0, np.float32)
    place = header["arrays"]["values"]
    start = 12 + length + place["offset"]
    values = np.frombuffer(part[start : start + 2 * place["count"]], np.float16)
    return header, values.astype(np.float32) * np.float32(header["scale"])


def place_tiles(image: NDArray[np.float32], tiles: list[list[int]], values: Any) -> None:
    start = 0
    for top, left, rows, cols in tiles:
        window = image[top : top + rows, left : left + cols]
        window[...] = values[start : start + window.size].reshape(window.shape)
        start += window.size
    assert start == len(values)


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many tiles, blocks and groups, although the matrices are small."""
    monkeypatch.setattr(packed, "TILE", 8)
    monkeypatch.setattr(session, "_MOST_TILES", 3)
    monkeypatch.setattr(lights, "_BLOCK_ENTRIES", 500)
    monkeypatch.setattr(lights, "_GROUP_ROWS", 16)
    monkeypatch.setattr(stores, "_BLOCK_ENTRIES", 500)


@pytest.fixture(scope="module", params=["grey", "colour"])
def transport(request: pytest.FixtureRequest) -> lm.LightTransport:
    grey = running.scene()
    if request.param == "grey":
        return grey
    shades = np.tile([1, 0.5, 0.2], 480)[:, None]
    return replace(
        grey,
        sparse=csr_array(np.repeat(grey.sparse.toarray(), 3, axis=0) * shades, dtype=np.float32),
        background=(np.repeat(grey.background, 3, axis=0) * shades).astype(np.float32),
        camera_shape=(24, 20, 3),
        diagnostics={name: np.repeat(v, 3) for name, v in grey.diagnostics.items()},
    )


@pytest.fixture(scope="module")
def store(transport: lm.LightTransport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The matrix on disk; the first scene of it makes its index."""
    store = tmp_path_factory.mktemp("session") / "scene.zarr"
    lm.save(store, transport)
    steps: list[tuple[int, int, str]] = []
    ViewedScene(store, page_bytes=0, progress=lambda *step: steps.append(step))
    assert steps[-1][0] == steps[-1][1]
    assert "MiB beside the matrix" in steps[-1][2]
    return store


@pytest.fixture(params=["disk", "memory"])
def scene(request: pytest.FixtureRequest, transport: lm.LightTransport, store: Path) -> ViewedScene:
    if request.param == "memory":
        return ViewedScene(transport, page_bytes=0)
    # The index that is there is used.
    return ViewedScene(store, page_bytes=0, progress=lambda *_: pytest.fail("it was made again"))


def assert_shown(window: Window, transport: lm.LightTransport) -> None:
    expected = transport.relight(window.levels / 255)
    white = float(transport.relight(np.ones(transport.projector_shape)).max())
    missed = np.abs(window.image.reshape(transport.camera_shape) - expected)
    assert missed.max() <= CLOSE * white


def test_strokes_and_patterns(scene: ViewedScene, transport: lm.LightTransport) -> None:
    window = Window(scene)
    generator = np.random.default_rng(0)
    window.paint(0, 0, np.full((16, 18), 255, np.uint8))
    assert_shown(window, transport)
    for _ in range(30):
        top, left = generator.integers(0, 16), generator.integers(0, 18)
        size = (generator.integers(1, 17 - top), generator.integers(1, 19 - left))
        window.paint(int(top), int(left), generator.integers(0, 256, size).astype(np.uint8))
        assert_shown(window, transport)
    assert max(len(part.get("tiles", [])) for part in window.parts) == 3


def test_a_stroke_within_a_pattern_that_is_still_relit(
    scene: ViewedScene, transport: lm.LightTransport
) -> None:
    window = Window(scene)
    generator = np.random.default_rng(1)
    for step in range(6):
        levels = generator.integers(0, 256, (16, 18)).astype(np.uint8)
        window.paint(0, 0, levels, finish=False)
        for _ in range(step):
            window.finish()
        window.paint(3, step, np.full((2, 3), 200, np.uint8), finish=step % 2 == 1)
    assert_shown(window, transport)


def test_only_what_changed_is_sent() -> None:
    """One lit pixel, which lights one camera pixel."""
    pixel = np.arange(16 * 18)
    places = (pixel // 18 * 20 + pixel % 18, pixel)
    matrix = csr_array((np.ones(16 * 18), places), shape=(24 * 20, 16 * 18))
    bare = lm.LightTransport.from_matrix(matrix, (24, 20), (16, 18))
    window = Window(ViewedScene(bare, page_bytes=0))
    window.paint(8, 9, np.full((1, 1), 255, np.uint8))
    first, *rest = window.parts
    assert first["arrays"]["samples"]["count"] == 1
    assert all(not part["tiles"] for part in rest)
    assert_shown(window, bare)
    window.paint(0, 0, np.full((1, 16), 255, np.uint8))
    window.paint(2, 0, np.full((4, 4), 255, np.uint8))
    assert {part["kind"] for part in window.parts} == {"samples", "tiles"}
    window.paint(0, 0, np.full((16, 18), 99, np.uint8))
    assert_shown(window, bare)


def test_rows_and_columns(scene: ViewedScene, transport: lm.LightTransport) -> None:
    window = Window(scene)
    for row, col in ((0, 0), (23, 19), (7, 11)):
        found = window.ask(MessageKind.ROW, row, col, (16, 18, 1))[..., 0]
        first = (row * 20 + col) * (transport.shape[0] // 480)
        stop = first + transport.shape[0] // 480
        expected = transport.to_matrix(dense_background=True)[first:stop].sum(axis=0)
        expected = expected.reshape(16, 18)
        np.testing.assert_allclose(found, expected, atol=CLOSE * expected.max())
    for row, col in ((0, 0), (15, 17), (9, 4)):
        shape = window.image.shape
        found = window.ask(MessageKind.COLUMN, row, col, shape).reshape(transport.camera_shape)
        expected = transport.column(row, col)
        np.testing.assert_allclose(found, expected, atol=CLOSE * expected.max())


def test_layers_are_those_of_a_matrix_in_memory(
    scene: ViewedScene, transport: lm.LightTransport
) -> None:
    assert scene.light is not None
    whole, here = LayerSource(transport), LayerSource(scene.light)
    # Only matrices in memory are separated.
    assert set(whole.available) - set(here.available) <= {"direct", "global", "parallax"}
    assert "row" in here.available
    np.testing.assert_allclose(here.whole.dual_image(), transport.dual_image(), rtol=1e-5)
    for name in ("pixel", "place", "confidence"):
        one, other = (getattr(s.correspondence, name) for s in (here, whole))
        np.testing.assert_allclose(one, other, rtol=1e-5)
    assert here.get("clipping") == whole.get("clipping")
    assert maps.has_diagnostic(here.facts, "estimated_error")


def test_the_white_level_is_estimated(scene: ViewedScene, transport: lm.LightTransport) -> None:
    white = transport.relight(np.ones(transport.projector_shape))
    assert scene._white == pytest.approx(np.quantile(white, 0.995), rel=0.2)


def test_what_the_page_would_not_send_is_refused(scene: ViewedScene) -> None:
    window = Window(scene)
    for message in hostile.nonsense((24, 20), (16, 18)):
        with pytest.raises(MessageError):
            window.session.answer(message)
    # It is the window that is closed; another one goes on.
    Window(scene).paint(0, 0, np.zeros((1, 1), np.uint8))


def test_a_matrix_that_the_page_has_takes_no_messages(transport: lm.LightTransport) -> None:
    scene = ViewedScene(transport)
    assert not scene.session().unfinished
    assert scene.session().finish() is None
    for kind in (MessageKind.ROW, MessageKind.COLUMN):
        with pytest.raises(MessageError):
            scene.session().answer(struct.pack("<4I", kind, 1, 2, 3))


def test_a_store_that_changes_is_told(transport: lm.LightTransport, tmp_path: Path) -> None:
    lm.save(tmp_path / "scene.zarr", transport)
    window = Window(ViewedScene(tmp_path / "scene.zarr", page_bytes=0))
    window.paint(0, 0, np.full((2, 2), 255, np.uint8))
    other = replace(transport, sparse=csr_array(2 * transport.sparse))
    lm.save(tmp_path / "scene.zarr", other, overwrite=True)
    for levels in (np.full((2, 2), 9, np.uint8), np.full((16, 18), 9, np.uint8)):
        window.paint(0, 0, levels)
    errors = [part for part in window.parts if part["kind"] == "error"]
    assert "is not the one that was written" in errors[0]["message"]
    assert not window.session.unfinished


def test_direct_and_global_light_and_compensation() -> None:
    known = binned(lm.truth("l_objects"), 2).transport()
    scene = ViewedScene(known)
    parts = lm.separate(known)
    for name, part in (("direct", parts.direct), ("global", parts.global_)):
        _, values = unpack_floats(scene.layers.get(name))
        np.testing.assert_array_equal(values, part.relight(np.ones((32, 32))).ravel())
    header, values = unpack_floats(scene.layers.get("parallax"))
    assert header["low"] < np.nanmedian(values) < header["high"]
    picture = np.full((32, 32), 200, np.uint8)
    picture[:, 10:20] = 60
    message = struct.pack("<2I", MessageKind.COMPENSATE, 5) + picture.tobytes()
    (answer,) = scene.session().answer(message)
    length = int.from_bytes(answer[8:12], "little")
    levels = np.frombuffer(answer[12 + length :], np.uint8).reshape(32, 32)
    found = lm.compensate(known, picture / np.float32(255), gamma=2.2)
    np.testing.assert_array_equal(levels, np.rint(255 * found.pattern))
    # Refused while the matrix is too large for it.
    with pytest.raises(MessageError):
        ViewedScene(known, page_bytes=0).session().answer(message[:-1])


def unpack_floats(part: bytes) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """The header and the values of a layer."""
    length = int.from_bytes(part[8:12], "little")
    header = json.loads(part[12 : 12 + length])
    place = header["arrays"]["values"]
    start = 12 + length + place["offset"]
    return header, np.frombuffer(part[start : start + 4 * place["count"]], np.float32)


def test_a_matrix_that_cannot_be_separated_has_no_such_layers(tmp_path: Path) -> None:
    matrix = csr_array(([-1.0], ([0], [0])), shape=(480, 288), dtype=np.float32)
    signed = lm.LightTransport.from_matrix(matrix, (24, 20), (16, 18))
    assert "direct" not in ViewedScene(signed).layers.available
    dark = lm.LightTransport.from_matrix(abs(matrix), (24, 20), (16, 18))
    assert "direct" in ViewedScene(dark).layers.available
    with pytest.raises(lm.InputError, match="light"):
        ViewedScene(dark).layers.get("direct")
    lm.export_viewer(tmp_path / "page.html", dark)
    assert 'id="data-layer-direct"' not in (tmp_path / "page.html").read_text()


def test_patterns_of_the_capture(transport: lm.LightTransport) -> None:
    patterns = lm.BernoulliPatterns((32, 36), 8)
    frames = np.zeros((8, *transport.camera_shape), np.uint8)
    capture = lm.Capture.from_arrays(patterns, frames, lm.Sensor())
    scene = ViewedScene(transport, capture=capture)
    assert scene.pattern_count == 8
    # The matrix has the projector binned by 2.
    expected = patterns.images()[3].reshape(16, 2, 18, 2).mean(axis=(1, 3))
    levels = scene.pattern(3)[-16 * 18 :]
    np.testing.assert_allclose(np.frombuffer(levels, np.uint8), 255 * expected.ravel(), atol=0.51)
    for number in (-1, 8):
        with pytest.raises(lm.InputError, match=f"pattern {number} of 8"):
            scene.pattern(number)
    other = lm.Capture.from_arrays(lm.BernoulliPatterns((8, 8), 8), frames, lm.Sensor())
    with pytest.raises(lm.InputError, match="projector of 8 x 8"):
        ViewedScene(transport, capture=other)


def test_depth_where_the_geometry_is_known(tmp_path: Path) -> None:
    truth = binned(lm.truth("metal"), 2)
    known = truth.transport()
    assert truth.geometry is not None
    assert "depth" not in ViewedScene(known).layers.available
    header, values = unpack_floats(ViewedScene(known, geometry=truth.geometry).layers.get("depth"))
    expected = lm.triangulate(known, truth.geometry).depth
    np.testing.assert_array_equal(values, expected.ravel())
    assert header["low"] < np.nanmedian(values) < header["high"]
    # Both surfaces, in the colours of one scale, what mirrors show, and how certain the depth is.
    found = lm.layers(known, truth.geometry)
    assert np.isfinite(found.depth[..., 1]).any()
    assert found.mirrored.any()
    whole = ViewedScene(known, geometry=truth.geometry).layers
    scales = set()
    for name, expected_map in {
        "first": found.depth[..., 0],
        "behind": found.depth[..., 1],
        "mirrors": np.where(found.mirrored, found.light, 0).sum(axis=-1),
        "probability": lm.triangulate(known, truth.geometry).probability,
    }.items():
        header, values = unpack_floats(whole.get(name))
        np.testing.assert_array_equal(values, expected_map.ravel())
        scales.add((header.get("low"), header.get("high")))
    assert len(scales) == 3
    # A matrix on disk gives depth by its correspondence, which knows one surface.
    stored = ViewedScene(known, page_bytes=0, geometry=truth.geometry).layers
    assert "behind" not in stored.available
    _, values = unpack_floats(stored.get("depth"))
    both = np.isfinite(values) & np.isfinite(expected.ravel())
    assert both.mean() > 0.3
    relative = values[both] / expected.ravel()[both] - 1
    assert np.median(np.abs(relative)) < 0.01


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the names of files are text")
def test_a_store_whose_name_is_no_text_is_shown(tmp_path: Path) -> None:
    store = tmp_path / os.fsdecode(b"sc\xffne.zarr")
    lm.save(store, running.scene())
    lm.export_viewer(tmp_path / "page.html", store)
    assert "<title>sc?ne.zarr" in (tmp_path / "page.html").read_text()
    assert b"sc?ne.zarr" in ViewedScene(store).description
