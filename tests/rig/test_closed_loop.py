"""A compensation on a virtual rig gets better by its photographs, and names what does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm

pytestmark = pytest.mark.usefixtures("small_scenes")
RIG = "virtual:l_objects,size=32,real=0"
WANTED = np.tile(np.linspace(0.2, 1, 32), (32, 1))


def test_photographs_correct_a_wrong_matrix(tmp_path: Path) -> None:
    """T lacks its weak entries, the global light: photographs bring it back."""
    with lm.open_rig(RIG) as rig:
        assert rig.truth is not None
        known = rig.truth.transport()
        sparse = known.sparse.copy()
        sparse.data[sparse.data < 0.02 * sparse.data.max()] = 0
        wrong = lm.LightTransport.from_matrix(sparse, (32, 32), (32, 32))
        found = lm.refine_compensation(
            rig, wrong, WANTED, steps=3, output=tmp_path / "shown.png", keep=tmp_path / "rig.json"
        )
    psnr = found.photographed_psnr
    assert len(psnr) == 4
    assert psnr.max() > psnr[0] + 3
    # The photograph that was kept is that of the pattern, in the units of T up to one factor.
    light = known.relight(found.pattern)
    factor = float((light * found.photograph).sum() / (light**2).sum())
    apart = np.abs(found.photograph - factor * light) / found.compensation.scale
    assert apart.mean() < 0.01
    assert apart.max() < 0.1
    assert lm.read_image(tmp_path / "shown.png").shape == (32, 32)


def test_a_webcam_with_a_gamma_is_read_as_the_capture_of_t_was() -> None:
    with lm.open_rig("virtual:procedural,size=16,real=0,bits=8,black=0,camera_gamma=2.2") as rig:
        assert rig.truth is not None
        capture = {"capture_description": {"response": "gamma:2.2"}}
        known = replace(rig.truth.transport(), provenance=capture)
        wanted = np.tile(np.linspace(0.3, 1, 16), (16, 1))
        found = lm.refine_compensation(rig, known, wanted, steps=1, brightness=0.5)
    assert found.photographed_psnr.max() > 30


def test_the_picture_is_held_while_the_light_changes() -> None:
    """After five photographs a lamp is switched on beside the scene, and later off again."""
    seen: list[float] = []
    with lm.open_rig("virtual:procedural,size=16,real=0") as rig:
        assert rig.truth is not None
        room = rig.projector._light.room  # type: ignore[attr-defined]
        lamp = 0.08 * np.median(rig.truth.matrix.sum(axis=1))

        def go_on(decibels: float) -> bool:
            seen.append(decibels)
            room[:] += {5: lamp, 14: -lamp}.get(len(seen), 0.0)
            return len(seen) < 22

        wanted = np.full((16, 16), 0.6)
        found = lm.refine_compensation(
            rig, rig.truth.transport(), wanted, brightness=0.7, keep=None, live=go_on
        )
    assert len(found.photographed_psnr) == 22
    for changed in (5, 14):
        # The first photograph after the change is wrong; the loop brings the picture back.
        assert seen[changed] < min(seen[:5]) - 3
        assert max(seen[changed + 4 : changed + 8]) > min(seen[:5]) - 1


def test_a_matrix_of_another_rig_is_refused() -> None:
    other = lm.ProceduralScene((16, 16), (32, 32)).truth().transport()
    with lm.open_rig(RIG) as rig, pytest.raises(lm.InputError, match="camera of shape"):
        lm.refine_compensation(rig, other, np.ones((16, 16)), keep=None)


@pytest.mark.parametrize("steps", [-1, 101, 1.5])
def test_the_number_of_steps_is_checked(steps: int) -> None:
    known = lm.truth("l_objects", (32, 32)).transport()
    with lm.open_rig(RIG) as rig, pytest.raises(lm.InputError, match="corrections"):
        lm.refine_compensation(rig, known, WANTED, steps=steps)


@pytest.mark.parametrize(("cell", "block"), [(2, 1), (1, 2)])
def test_coarse_patterns_fill_the_screen(cell: int, block: int) -> None:
    """Of a capture by cells of 2 x 2 projector pixels, or of T of blocks of them."""
    with lm.open_rig(RIG) as rig:
        assert rig.truth is not None
        fine = rig.truth.transport().sparse.toarray().reshape(1024, 16, 2, 16, 2)
        coarse = fine.sum(axis=(2, 4)).reshape(1024, 256)
        about = {"capture_description": {"cell": cell, "bin_projector": [block, block]}}
        known = lm.LightTransport.from_matrix(coarse, (32, 32), (16, 16))
        known = replace(known, provenance=about)
        found = lm.refine_compensation(rig, known, WANTED, steps=0, brightness=0.5, keep=None)
        assert found.photographed_psnr[0] > 25
        # T of another scene is named, though its sizes fit.
        other = replace(known, sparse=known.sparse[::-1])
        with pytest.warns(lm.LightMatrixWarning, match="is it the matrix of this rig"):
            lm.refine_compensation(rig, other, WANTED, steps=0, keep=None)
        oblong = {"capture_description": {"bin_projector": [2, 1]}}
        with pytest.raises(lm.InputError, match="2 x 1 projector pixels"):
            lm.refine_compensation(rig, replace(known, provenance=oblong), WANTED, keep=None)
