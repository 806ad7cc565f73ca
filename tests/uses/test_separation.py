"""Separation: exact sums, known geometry, a plane, no direct light, colour, files, bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.simulation.realism import defocus
from lightmatrix.uses import loading
from lightmatrix.uses.separation import Separation

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
    away = abs(parts.geometry.direction - angle) % 180
    assert min(away, 180 - away) < 1.5
    white = np.ones((SIDE, SIDE))
    # A few pixels beside the box are lost: fewer than a fifth of their neighbours see it too.
    assert _relative(parts.direct.relight(white), direct) < 0.1
    dark = direct < 0.1
    assert (parts.direct.relight(white)[dark] > 0.05).mean() < 0.05
    assert not parts.geometry.perspective
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
    assert geometry.perspective
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
    rows = np.repeat(np.arange(SIDE**2), 3)
    scale = csr_array((np.tile(gains, SIDE**2), (np.arange(3 * SIDE**2), rows)))
    colour = lm.LightTransport(
        csr_array(scale @ grey.sparse),
        scale @ grey.background,
        (SIDE, SIDE, 3),
        (SIDE, SIDE),
        (2, 2),
    )
    parts = lm.separate(colour)
    _assert_sums(parts, colour)
    image = parts.direct.relight(np.ones((SIDE, SIDE)))
    assert image.shape == (SIDE, SIDE, 3)
    assert _relative(image, direct[..., None] * gains) < 0.1
    assert parts.confidence.shape == (SIDE, SIDE)


def test_epipolar_parts_are_a_split_too() -> None:
    transport, _ = _scene(30, depth=5, glow=0.1)
    parts = lm.separate(transport)
    assert ((parts.epipolar.sparse + parts.non_epipolar.sparse) != transport.sparse).nnz == 0
    white = np.ones((SIDE, SIDE))
    direct, epipolar = parts.direct.relight(white), parts.epipolar.relight(white)
    assert (epipolar >= direct - 1e-6).mean() > 0.99
    assert epipolar.sum() < 0.5 * (direct.sum() + transport.relight(white).sum())


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
    known = lm.truth("l_objects").transport()
    lm.save(tmp_path / "scene.zarr", known)
    stored = lm.StoredTransport.open(tmp_path / "scene.zarr")
    part = lm.separate(stored).direct.sparse != lm.separate(known).direct.sparse
    assert part.nnz == 0
    size = sum(array.bytes for array in stored.arrays.values())
    monkeypatch.setattr(loading, "available_bytes", lambda: 4 * size)
    with pytest.raises(lm.InputError, match=r"scene\.zarr: takes .* GiB of memory") as refused:
        lm.separate(stored)
    assert "region" in (refused.value.hint or "")
    # What the message advises works.
    half = stored.region(slice(0, 64), slice(0, 32))
    assert lm.separate(half).direct.camera_shape == (64, 32)


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
        assert lm.read_image(tmp_path / "s" / f"{name}.png").shape == (SIDE, SIDE)
    np.testing.assert_array_equal(np.load(tmp_path / "s" / "parallax.npy"), parts.parallax)
    np.testing.assert_array_equal(np.load(tmp_path / "s" / "confidence.npy"), parts.confidence)
    with pytest.raises(lm.OutputError):
        lm.separate(transport, output=tmp_path / "s")
    assert len(repr(parts)) < 600
    assert "\n" not in repr(parts)
