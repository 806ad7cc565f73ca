"""Exact depth, normals and matrices of rendered scenes, against formulas, Mitsuba and T."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

import lightmatrix as lm
from experiments.shape import depths_within
from lightmatrix.simulation.renderer import load_mitsuba, mitsuba_scene
from lightmatrix.simulation.scenes import Part, Scene, View, matt, names, scene
from lightmatrix.simulation.shapes import Mesh, ball, sheet
from lightmatrix.simulation.truth import binned, trace_surface, view_geometry
from tests.helpers.renderer import needs_llvm


def pixels(shape: tuple[int, ...]) -> np.ndarray:
    """All pixels as (col, row), in the order of rows."""
    row, col = np.mgrid[: shape[0], : shape[1]]
    return np.column_stack([col.ravel(), row.ravel()]).astype(float)


def test_a_ball_on_a_sheet_has_the_depth_of_a_sphere() -> None:
    built = Scene("ball", "a ball", (Part(sheet(), matt(0.5)), Part(ball(0.5, 400), matt(0.5))))
    geometry = view_geometry(built, (40, 30), (30, 40))
    depth, normals = trace_surface(built, geometry)
    origin, rays = geometry.camera_centre, geometry.camera_rays(pixels((40, 30)))
    centre = np.array([0, 0, 0.5])
    a, b = (rays**2).sum(axis=1), rays @ (origin - centre)
    c = ((origin - centre) ** 2).sum() - 0.25
    with np.errstate(invalid="ignore"):
        sphere = (-b - np.sqrt(b * b - a * c)) / a
    plane = -origin[2] / rays[:, 2]
    expected = np.where(np.isnan(sphere), plane, sphere).reshape(40, 30)
    # The mesh has 64 facets around, so its silhouette is a little smaller.
    assert (np.abs(depth - expected) < 2e-3).mean() > 0.98
    hit = np.abs(depth - sphere.reshape(40, 30)) < 2e-3
    points = origin + depth[hit][:, None] * rays[hit.ravel()]
    cosine = (normals[hit] * (points - centre)).sum(axis=1) / 0.5
    assert cosine.min() > 0.99
    flat = np.abs(depth - 4) < 1e-9
    np.testing.assert_allclose(normals[flat], [[0, 0, 1]] * int(flat.sum()), atol=1e-12)


def test_pixels_that_see_nothing_are_nan() -> None:
    small = Mesh(np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0, 0.5, 0]]), np.array([[0, 1, 2]]))
    built = Scene("triangle", "a triangle", (Part(small, matt(0.5)),))
    depth, normals = trace_surface(built, view_geometry(built, (8, 8), (8, 8)))
    seen = np.isfinite(depth)
    # The triangle covers an eighth of the square, here 8 of 64 pixels.
    assert 6 <= seen.sum() <= 10
    assert (np.isfinite(normals).all(axis=2) == seen).all()


@needs_llvm
@pytest.mark.parametrize("name", ["corner", "vase"])
def test_views_and_surfaces_are_those_that_mitsuba_renders(name: str) -> None:
    mi = load_mitsuba()
    built, camera, projector = scene(name), (24, 36), (20, 30)
    loaded = mitsuba_scene(mi, built, camera, projector)
    geometry = view_geometry(built, camera, projector)
    depth, _ = trace_surface(built, geometry)
    at = (pixels(camera) + 0.5) / [camera[1], camera[0]]
    film = mi.Point2f(at[:, 0].astype(np.float32), at[:, 1].astype(np.float32))
    ray, _ = loaded.sensors()[0].sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    hit = loaded.ray_intersect(mi.Ray3f(ray.o, ray.d))
    points = np.array(hit.p).T.reshape(-1, 3)
    good = np.abs(geometry.depth(points) - depth.ravel()) < 1e-4
    assert good.mean() > 0.99
    light, _ = loaded.sample_emitter_direction(hit, mi.Point2f(0.5), False)
    uv = np.array(light.uv).T.reshape(-1, 2) * [projector[1], projector[0]] - 0.5
    lit = good & (np.array(light.pdf) > 0)
    assert lit.sum() > 200
    expected = geometry.project_projector(points[lit])
    np.testing.assert_allclose(uv[lit], expected, atol=2e-3)


@pytest.mark.parametrize("name", ["l_objects", "corner"])
def test_the_bundled_matrices_show_these_depths(name: str) -> None:
    known = lm.truth(name)
    assert known.geometry is not None
    assert known.depth is not None
    matches = lm.correspondence(known.transport())
    points = known.geometry.triangulate(
        pixels(known.camera_shape), matches.place[..., ::-1].reshape(-1, 2)
    )
    error = np.abs(known.geometry.depth(points) / known.depth.ravel() - 1)
    assert np.median(error) < 2e-3
    assert (error < 0.01).mean() > 0.9
    within = depths_within(known, 3)
    np.testing.assert_allclose(within[..., 4], known.depth, atol=1e-9)
    assert (np.ptp(within, axis=2) >= 0).all()


def test_the_geometry_follows_crops_and_bins() -> None:
    known = lm.truth("l_objects")
    assert known.depth is not None
    part = lm.simulate(known, lm.BernoulliPatterns((64, 64), 2)).crop((10, 20), (32, 40)).truth
    assert part.depth is not None
    np.testing.assert_allclose(part.depth, known.depth[10:42, 20:60], atol=1e-9)
    small = binned(known, 4, 2)
    assert small.geometry is not None
    assert (small.geometry.camera_shape, small.geometry.projector_shape) == ((16, 16), (32, 32))
    assert small.depth is not None
    # Blocks have their centre between four pixels.
    middle = known.depth.reshape(16, 4, 16, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    assert np.median(np.abs(small.depth - middle)) < 1e-3


def test_simulated_captures_bring_geometry_and_depth(tmp_path: Path) -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 2))
    capture.save(tmp_path / "metal")
    lm.pack(tmp_path / "metal", tmp_path / "metal.zarr")
    depth = capture.truth.depth
    assert depth is not None
    for folder in (tmp_path / "metal", tmp_path / "metal.zarr"):
        again, rig = lm.truth(folder), lm.RigGeometry.load(folder / "geometry.json")
        assert again.geometry is not None
        assert again.depth is not None
        np.testing.assert_allclose(rig.camera_matrix, again.geometry.camera_matrix)
        stored = tifffile.imread(folder / "depth.tiff")
        np.testing.assert_allclose(stored, depth, rtol=1e-6)
        np.testing.assert_allclose(again.depth, depth)


def test_other_truths_have_no_geometry(tmp_path: Path) -> None:
    assert lm.ProceduralScene((8, 8), (8, 8)).truth().depth is None
    known = lm.truth("metal")
    changed = replace(known, metadata={**known.metadata, "scene_version": 0})
    assert changed.depth is None
    replace(known, camera_shape=(32, 128)).save(tmp_path / "T.npz")
    with pytest.raises(lm.InputError, match="other image sizes"):
        lm.truth(tmp_path / "T.npz")


def test_a_turned_view_has_its_target_in_the_middle() -> None:
    view = View((-1.5, -0.7, 3.5), target=(0.1, 0.2, 0.3), roll=30, width=1.0)
    matrix = view.matrix((21, 41))
    col, row, depth = matrix @ [0.1, 0.2, 0.3, 1]
    assert (col / depth, row / depth) == pytest.approx((20, 10))
    assert depth == pytest.approx(view.distance)
    # A point half a width to the right in the image lies at its edge.
    col, row, depth = matrix @ np.append(np.array([0.1, 0.2, 0.3]) + 0.5 * view.axes[0], 1)
    assert (col / depth, row / depth) == pytest.approx((40.5, 10))
    # Turned clockwise, the device sees the world turned the other way: up leans to the left.
    straight = replace(view, roll=0)
    up = straight.axes[1] * -1
    assert up @ view.axes[0] < 0


def test_every_scene_is_seen_and_lit() -> None:
    for name in names():
        built = scene(name)
        geometry = view_geometry(built, (16, 16), (16, 16))
        depth, _ = trace_surface(built, geometry)
        assert np.isfinite(depth).mean() > 0.99
        rays = geometry.camera_rays(pixels((16, 16)))
        points = geometry.camera_centre + depth.reshape(-1, 1) * rays
        place = geometry.project_projector(points)
        # The first of two projectors lights a part.
        least = 0.3 if name in ("stage", "statues", "dome") else 0.7
        assert ((place > -0.5) & (place < 15.5)).all(axis=1).mean() > least


def test_the_pictures_in_the_dome_overlap_by_a_third() -> None:
    shape = (64, 64)
    built = scene("dome")
    for camera in built.cameras:
        lit = []
        for projector in built.projectors:
            pair = replace(built, camera=camera, projector=projector)
            geometry = view_geometry(pair, shape, shape)
            depth, _ = trace_surface(pair, geometry)
            points = depth.reshape(-1, 1) * geometry.camera_rays(pixels(shape))
            place = geometry.project_projector(geometry.camera_centre + points)
            lit.append(((place > -0.5) & (place < 63.5)).all(axis=1))
        both = (lit[0] & lit[1]).sum()
        for one in lit:
            assert both / one.sum() == pytest.approx(1 / 3, abs=0.05)
