"""Separation: exact sums, known geometry, a plane, no direct light, colour, files, bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron

import lightmatrix as lm
from lightmatrix.resources import memory
from lightmatrix.simulation.realism import defocus
from lightmatrix.uses.separation import Separation, crossing_spots, outshone_spots

SIDE = 40


def _scene(
    angle: float, depth: float, glow: float, seed: int = 0
) -> tuple[lm.LightTransport, NDArray[np.float32]]:
    """A plane with a box before it, epipolar lines at `angle` degrees; T and its direct image."""
    row, col, box = _box()
    shift = np.where(box, depth, 0.02 * depth * (row - col))
    along = np.deg2rad(angle)
    place = np.stack([row + shift * np.sin(along), col + shift * np.cos(along)], -1).reshape(-1, 2)
    return _seen(place, glow, seed)


def _box() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Row and column of camera pixels, and which of them see the box."""
    row, col = np.indices((SIDE, SIDE))
    return row, col, (abs(row - 20) < 8) & (abs(col - 18) < 9)


def _seen(
    place: NDArray[np.float64], glow: float, seed: int = 0
) -> tuple[lm.LightTransport, NDArray[np.float32]]:
    """T of camera pixels that see these places (n, 2) of the projector, and its direct image.

    Each pixel sees 2 x 2 projector pixels directly, and scattered global light; a tenth of the
    pixels sees no direct light.
    """
    random = np.random.default_rng(seed)
    lit = (random.random(SIDE**2) > 0.1) & ((place >= 0) & (place < SIDE - 1)).all(axis=1)
    direct = np.zeros((SIDE**2, SIDE**2))
    corner = np.floor(np.clip(place, 0, SIDE - 2)).astype(int)
    part = np.clip(place, 0, SIDE - 2) - corner
    rows = np.arange(SIDE**2)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - part[:, 0]) * np.abs(1 - right - part[:, 1])
            pixel = (corner[:, 0] + down) * SIDE + corner[:, 1] + right
            direct[rows, pixel] += 0.5 * share * lit
    far = np.zeros_like(direct)
    for _ in range(12):
        far[rows, random.integers(SIDE**2, size=SIDE**2)] += glow / 12
    transport = lm.LightTransport(
        csr_array((direct + far).astype(np.float32)),
        (random.random((SIDE**2, 4)) * glow / 4).astype(np.float32),
        (SIDE, SIDE),
        (SIDE, SIDE),
        (2, 2),
    )
    return transport, direct.sum(axis=1).reshape(SIDE, SIDE).astype(np.float32)


def _relative(found: NDArray[np.float32], expected: NDArray[np.float32]) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def _assert_sums(parts: Separation, transport: lm.LightTransport) -> None:
    for part in (parts.direct, parts.global_):
        assert (part.sparse.data > 0).all()
        assert (part.background >= 0).all()
        assert part.sparse.dtype == np.float32
    assert ((parts.direct.sparse + parts.global_.sparse) != transport.sparse).nnz == 0
    np.testing.assert_array_equal(parts.global_.background, transport.background)
    assert not parts.direct.background.any()


@pytest.mark.parametrize("angle", [0, 30, -70, 90])
def test_geometry_and_direct_light_of_a_known_scene(angle: float) -> None:
    transport, direct = _scene(angle, depth=5, glow=0.1)
    parts = lm.separate(transport)
    _assert_sums(parts, transport)
    down, right, _ = parts.geometry.fundamental @ (SIDE / 2, SIDE / 2, 1)
    away = abs(np.degrees(np.arctan2(-right, down)) - angle) % 180
    assert min(away, 180 - away) < 1.5
    white = np.ones((SIDE, SIDE))
    # A few pixels beside the box are lost: fewer than a fifth of their neighbours see it too.
    assert _relative(parts.direct.relight(white), direct) < 0.1
    dark = direct < 0.1
    assert (parts.direct.relight(white)[dark] > 0.05).mean() < 0.05
    assert not parts.geometry.fundamental[:2, :2].any()
    # The box stands out by its depth, along the lines.
    box, plane = parts.parallax[14:26, 12:24], parts.parallax[2:8, 30:38]
    assert abs(np.nanmedian(box) - np.nanmedian(plane)) > 3
    assert np.isnan(parts.parallax[dark]).mean() > 0.95


def test_lines_that_meet_and_keystone_are_found() -> None:
    """Plane and parallax: a camera pixel x sees H x + d e, with its depth d and the epipole e."""
    keystone = np.array([[0.9, 0.05, 2.0], [0.02, 0.85, 3.0], [0.0, -0.004, 1.0]])
    epipole = np.array([-25.0, 10.0, 1.0])
    row, col, box = _box()
    pixels = np.stack([row, col, np.ones_like(row)], axis=-1).reshape(-1, 3)
    depth = np.where(box, -0.12, 0.02 + 0.0005 * row).ravel()
    seen = pixels @ keystone.T + depth[:, None] * epipole
    transport, direct = _seen(seen[:, :2] / seen[:, 2:], glow=0.1)
    parts = lm.separate(transport)
    _assert_sums(parts, transport)
    geometry = parts.geometry
    assert geometry.fundamental[:2, :2].any()
    # Where the lines meet: the left null vector of F.
    found = np.linalg.svd(geometry.fundamental.T)[2][-1]
    np.testing.assert_allclose(found[:2] / found[2], epipole[:2], atol=2)
    assert _relative(parts.direct.relight(np.ones((SIDE, SIDE))), direct) < 0.1
    assert (parts.direct.relight(np.ones((SIDE, SIDE)))[direct < 0.1] > 0.05).mean() < 0.05


def test_a_plane_has_no_parallax_and_keeps_its_direct_light() -> None:
    transport, direct = _scene(0, depth=0, glow=0.1)
    parts = lm.separate(transport)
    _assert_sums(parts, transport)
    assert _relative(parts.direct.relight(np.ones((SIDE, SIDE))), direct) < 0.05
    assert np.ptp(parts.parallax[np.isfinite(parts.parallax)]) < 1.5
    assert np.nanmedian(parts.confidence) > 0.7


def test_rendered_scenes_sharp_and_out_of_focus() -> None:
    for blur, most_direct, most_global in ((0, 0.02, 0.2), (1.0, 0.045, 0.4)):
        known = lm.truth("l_objects") if not blur else defocus(lm.truth("l_objects"), blur)
        transport = known.transport()
        parts = lm.separate(transport)
        _assert_sums(parts, transport)
        white = np.ones(known.projector_shape)
        direct = np.asarray(known.direct.sum(axis=1)).reshape(known.camera_shape)
        others = np.asarray(known.indirect.sum(axis=1)).reshape(known.camera_shape)
        assert _relative(parts.direct.relight(white), direct) < most_direct
        assert _relative(parts.global_.relight(white), others) < most_global


def test_channels_share_their_geometry() -> None:
    grey, direct = _scene(30, depth=5, glow=0.1)
    gains = np.array([1.0, 0.5, 0.25], np.float32)
    colour = replace(
        grey,
        sparse=csr_array(kron(grey.sparse, gains[:, None])),
        background=np.kron(grey.background, gains[:, None]),
        camera_shape=(SIDE, SIDE, 3),
    )
    parts = lm.separate(colour)
    _assert_sums(parts, colour)
    image = parts.direct.relight(np.ones((SIDE, SIDE)))
    assert image.shape == (SIDE, SIDE, 3)
    assert _relative(image, direct[..., None] * gains) < 0.1
    assert parts.confidence.shape == (SIDE, SIDE)


def test_global_light_can_be_scaled() -> None:
    transport, _ = _scene(30, depth=5, glow=0.1)
    parts, pattern = lm.separate(transport), np.zeros((SIDE, SIDE))
    pattern[:, ::4] = 1
    np.testing.assert_allclose(parts.relight(pattern), transport.relight(pattern), atol=1e-6)
    np.testing.assert_array_equal(
        parts.relight(pattern, global_scale=0), parts.direct.relight(pattern)
    )


def test_without_direct_light_it_says_so() -> None:
    random = np.random.default_rng(0)
    places = random.integers(900, size=(400, 30))
    owner = np.repeat(np.arange(400), 30)
    matrix = csr_array(
        (random.random(12_000).astype(np.float32), (owner, places.ravel())), (400, 900)
    )
    transport = lm.LightTransport.from_matrix(matrix, (20, 20), (30, 30))
    dark = lm.LightTransport.from_matrix(
        csr_array((400, 900), dtype=np.float32), (20, 20), (30, 30)
    )
    for without in (transport, dark):
        with pytest.raises(lm.InputError, match="that their neighbours agree on") as error:
            lm.separate(without)
        assert "direct light" in (error.value.hint or "")


def test_bad_input_is_refused_before_a_folder_is_made(tmp_path: Path) -> None:
    transport, _ = _scene(0, depth=5, glow=0.1)
    signed = replace(transport, background=-transport.background)
    with pytest.raises(lm.InputError, match="negative entries"):
        lm.separate(signed, output=tmp_path / "new")
    for pattern in (np.ones((3, 3)), np.ones((2, SIDE, SIDE)), 2 * np.ones((SIDE, SIDE))):
        with pytest.raises(lm.InputError, match="pattern"):
            lm.separate(transport, pattern=pattern, output=tmp_path / "new")
    assert not list(tmp_path.iterdir())


def test_a_store_is_loaded_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known, _ = _scene(0, depth=5, glow=0.1)
    lm.save(tmp_path / "scene.zarr", known)
    stored = lm.StoredTransport.open(tmp_path / "scene.zarr")
    wanted = lm.separate(known).direct.sparse
    for source in (stored, tmp_path / "scene.zarr"):
        assert (lm.separate(source).direct.sparse != wanted).nnz == 0
    size = sum(array.bytes for array in stored.arrays.values())
    monkeypatch.setattr(memory, "available_bytes", lambda: 4 * size)
    with pytest.raises(lm.InputError, match=r"scene\.zarr: takes .* [KM]iB of memory") as refused:
        lm.separate(stored)
    assert "crop" in (refused.value.hint or "")
    # What the message advises works.
    half = stored.crop((0, 0), (SIDE, 20))
    assert lm.separate(half).direct.camera_shape == (SIDE, 20)


def test_files_hold_what_is_returned(tmp_path: Path) -> None:
    transport, _ = _scene(0, depth=5, glow=0.1)
    stripes = np.zeros((SIDE, SIDE))
    stripes[::2] = 1
    parts = lm.separate(transport, pattern=stripes, output=tmp_path / "s")
    for name, part in (("direct", parts.direct), ("global", parts.global_)):
        kept = lm.open(tmp_path / "s" / f"{name}.zarr")
        assert (kept.sparse != part.sparse).nnz == 0
        np.testing.assert_array_equal(
            np.load(tmp_path / "s" / f"{name}.npy"), part.relight(stripes)
        )
    assert (tmp_path / "s" / "separation.png").exists()
    assert parts._repr_png_().startswith(b"\x89PNG")
    titles = [axes.get_title() for axes in parts.show().axes]
    assert titles[0] == "Direct light"
    assert titles[1].startswith("Global light")
    np.testing.assert_array_equal(np.load(tmp_path / "s" / "parallax.npy"), parts.parallax)
    np.testing.assert_array_equal(np.load(tmp_path / "s" / "confidence.npy"), parts.confidence)
    with pytest.raises(lm.OutputError):
        lm.separate(transport, output=tmp_path / "s")
    assert len(repr(parts)) < 600
    assert "\n" not in repr(parts)


# Spots of neighbouring camera pixels, and those that lie on their epipolar line by chance.

SHAPE = (7, 9)


def test_a_mirror_image_that_crosses_its_line_is_told_from_a_surface() -> None:
    row = np.indices(SHAPE)[0].reshape(-1, 1)
    light = np.ones((63, 1))
    for sweep, crossing in ((1.8, True), (0.0, False)):
        # The distance to the line, which lies along the projector's rows, is the sweep's.
        distance = sweep * (row - 3)
        relative = np.stack([distance, 0 * distance], axis=-1).astype(float)
        found = crossing_spots(relative, light, np.abs(distance) < 0.6, SHAPE, 2.3)
        assert (found.reshape(SHAPE)[3] == crossing).all()


def test_faint_light_beside_the_line_does_not_reject_a_spot() -> None:
    row = np.indices(SHAPE)[0].reshape(-1, 1)
    distance = 1.8 * (row - 3.0)
    relative = np.stack([distance, 0 * distance], axis=-1)
    light = np.where(row == 3, 1.0, 0.3)
    assert not crossing_spots(relative, light, np.abs(distance) < 0.6, SHAPE, 2.3)[row == 3].any()


def test_the_stronger_surface_keeps_a_projector_pixel() -> None:
    # Two surfaces that claim pixels 10 to 14; the second one only faintly, and 20 by itself.
    col = np.array([10.0, 11, 12, 13, 14, 10.2, 11.2, 12.2, 20])
    place = np.stack([np.zeros(9), col], axis=1)
    parallax = np.array([0.0, 0, 0, 0, 0, 3, 3, 3, 3])
    light = np.array([1.0, 1, 1, 1, 1, 0.3, 0.3, 0.3, 0.3])
    doubtful = np.ones(9, bool)
    found = outshone_spots(place, parallax, light, doubtful)
    assert found.tolist() == [False] * 5 + [True] * 3 + [False]
    assert not outshone_spots(place, parallax, light, ~doubtful).any()


def test_epipolar_parts_are_a_split_too() -> None:
    transport, _ = _scene(30, depth=5, glow=0.1)
    parts = lm.separate(transport)
    assert ((parts.epipolar.sparse + parts.non_epipolar.sparse) != transport.sparse).nnz == 0
    white = np.ones((SIDE, SIDE))
    direct, epipolar = parts.direct.relight(white), parts.epipolar.relight(white)
    assert (epipolar >= direct - 1e-6).mean() > 0.99
    assert epipolar.sum() < 0.5 * (direct.sum() + transport.relight(white).sum())
