"""The one-pass renderer: seeds, halves, colour, thinning, limits; the bundled scenes anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.resources import memory
from lightmatrix.simulation import library, renderer
from lightmatrix.simulation.renderer import needed_bytes, render
from lightmatrix.simulation.truth import Truth
from tests.helpers.renderer import needs_llvm


@needs_llvm
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name != "gripper"))
        for name in library.BUNDLED
    ],
)
def test_bundled_scenes_agree_with_a_rendering(name: str) -> None:
    bundled = library.truth(name)
    rendered = render(name, library.BUNDLED_SIZE, samples=512, seed=7)
    # Both in the renderer's own units, before the scale that makes a fifth of the rows clip.
    expected = bundled.matrix.sum(axis=1) / bundled.metadata["scale"]
    white = rendered.matrix.sum(axis=1) / rendered.metadata["scale"]
    noise = rendered.metadata["noise_white"]
    assert 0.001 < noise < 0.1
    assert np.linalg.norm(white - expected) < 1.5 * noise * np.linalg.norm(expected)
    assert white.sum() == pytest.approx(expected.sum(), rel=max(0.001, noise / 10))
    entries = rendered.matrix / rendered.metadata["scale"]
    wrong = np.linalg.norm((entries - bundled.matrix / bundled.metadata["scale"]).data)
    assert wrong < 1.5 * rendered.metadata["noise_entries"] * np.linalg.norm(entries.data)
    direct = rendered.direct_data.sum() / rendered.matrix.sum()
    assert direct == pytest.approx(bundled.direct_data.sum() / bundled.matrix.sum(), abs=0.005)


@needs_llvm
def test_rendering_obeys_energy_and_seed() -> None:
    first, same, other = (
        render("metal", (4, 5), projector_size=(3, 2), samples=40, seed=seed) for seed in (1, 1, 2)
    )
    assert first.camera_shape == (4, 5)
    assert first.projector_shape == (3, 2)
    np.testing.assert_array_equal(first.matrix.toarray(), same.matrix.toarray())
    assert abs(first.matrix - other.matrix).sum() > 0
    assert (first.matrix.data > 0).all()
    assert (first.direct_data <= first.matrix.data * (1 + 1e-6)).all()


@needs_llvm
def test_blocks_of_rows_do_not_change_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = render("gripper", (12, 12), samples=2048)
    monkeypatch.setattr(renderer, "WAVEFRONT", 50 * 1024)
    seen: list[tuple[int, int]] = []
    blocks = render(
        "gripper", (12, 12), samples=2048, progress=lambda done, total: seen.append((done, total))
    )
    assert seen[-1] == (144 * 2048, 144 * 2048)
    assert len(seen) >= 6
    a = whole.matrix.toarray() / whole.metadata["scale"]
    b = blocks.matrix.toarray() / blocks.metadata["scale"]
    noise = whole.metadata["noise_entries"]
    assert np.linalg.norm(a - b) < 2 * noise * np.linalg.norm(a)


@needs_llvm
def test_thinning_keeps_rows_and_the_stated_energy() -> None:
    whole = render("corner", (10, 10), samples=1024, keep=1)
    thin = render("corner", (10, 10), samples=1024, keep=0.9)
    assert thin.matrix.nnz < 0.6 * whole.matrix.nnz
    a = whole.matrix.sum(axis=1) / whole.metadata["scale"]
    b = thin.matrix.sum(axis=1) / thin.metadata["scale"]
    np.testing.assert_allclose(a, b, rtol=1e-4)


@needs_llvm
def test_colour_gives_three_rows_a_pixel() -> None:
    colour = render("gripper", (8, 8), samples=1024, colour=True)
    grey = render("gripper", (8, 8), samples=1024)
    assert colour.camera_shape == (8, 8, 3)
    assert colour.matrix.shape == (192, 64)
    channels = np.asarray(colour.matrix.sum(axis=1)).reshape(8, 8, 3) / colour.metadata["scale"]
    white = np.asarray(grey.matrix.sum(axis=1)).reshape(8, 8) / grey.metadata["scale"]
    np.testing.assert_allclose(channels.mean(axis=2), white, rtol=2e-3)
    assert np.ptp(channels, axis=2).max() > 0.01 * channels.max()


@needs_llvm
@pytest.mark.parametrize("size", [(8, 8), (5, 9), (9, 4)])
def test_a_wall_is_seen_as_it_is_lit(size: tuple[int, int]) -> None:
    """Camera and projector see the same rectangle of a wall, so T is diagonal and global-free."""
    truth = render("wall", size, samples=1024)
    share = truth.matrix.diagonal().sum() / truth.matrix.sum()
    assert share > 0.99
    np.testing.assert_array_equal(truth.direct_data, truth.matrix.data)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "l_object"}, "did you mean l_objects"),
        ({"size": (0, 8)}, "a camera of shape"),
        ({"projector_size": (8, 0)}, "a projector of shape"),
        ({"samples": 1}, "1 samples"),
        ({"keep": 0.0}, "keep"),
    ],
)
def test_impossible_renderings_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        render(**{"name": "l_objects", "size": (8, 8), **options})  # type: ignore[arg-type]


@needs_llvm
def test_memory_is_estimated_from_a_few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    room = needed_bytes((16, 16), entries=2000)
    for module in (renderer, memory):
        monkeypatch.setattr(module, "available_bytes", lambda: room)
    sparse = render("wall", (16, 16), projector_size=(64, 64), samples=4096)
    assert sparse.matrix.nnz < 256 * 2000
    room = needed_bytes((16, 16), entries=300)
    with pytest.raises(InputError, match="camera by 64x64 projector pixels takes"):
        render("corner", (16, 16), projector_size=(64, 64), samples=4096)
    thin = render("corner", (16, 16), projector_size=(64, 64), samples=4096, keep=0.8)
    assert thin.matrix.nnz < 256 * 300
    # The paths in flight take this much whatever the size.
    room = 1 << 30
    with pytest.raises(InputError, match=r"takes .* GiB of memory"):
        render("wall", (2, 2))


def test_estimated_memory_grows_only_with_the_result() -> None:
    assert needed_bytes((64, 64)) < 1.3 * 2**30
    assert needed_bytes((512, 512)) < 1.3 * 2**30
    more = needed_bytes((512, 512), entries=1001)
    assert more - needed_bytes((512, 512)) == 512 * 512 * 1000 * 24


def made(name: str, size: tuple[int, int], **options: object) -> Truth:
    """Stands in for `render`: instant, and known by its options."""
    from lightmatrix.simulation.procedural import ProceduralScene

    truth = ProceduralScene(size, size, seed=int(str(options["seed"]))).truth()
    return Truth(
        truth.matrix, truth.direct_data, size, size, {"scene": name, **options, "progress": 0}
    )


def test_renderings_are_cached_by_everything_that_matters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []

    def counted(name: str, size: tuple[int, int], **options: object) -> Truth:
        calls.append((name, size))
        return made(name, size, **options)

    monkeypatch.setattr(library, "render", counted)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path / "cache" / "truth")
    first = library.truth("wall", (8, 8))
    again = library.truth("wall", (8, 8))
    assert len(calls) == 1
    np.testing.assert_array_equal(first.matrix.toarray(), again.matrix.toarray())
    library.truth("wall", (8, 8), seed=1)
    library.truth("wall", (8, 8), samples=99)
    library.truth("wall", (9, 8))
    library.truth("l_objects", (8, 8))
    assert len(calls) == 5
    assert len(list((tmp_path / "cache" / "truth").iterdir())) == 5


def test_an_interrupted_rendering_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> Truth:
        raise KeyboardInterrupt

    monkeypatch.setattr(library, "render", interrupted)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)
    with pytest.raises(KeyboardInterrupt):
        library.truth("wall", (8, 8))
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_cannot_be_written_costs_no_rendering(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    monkeypatch.setattr(library, "render", made)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path / "cache")
    with pytest.warns(LightMatrixWarning, match="could not be cached"):
        truth = library.truth("wall", (8, 8))
    assert truth.camera_shape == (8, 8)


def test_a_damaged_cache_is_rendered_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "render", made)
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)
    good = library.truth("wall", (8, 8))
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:100])
    again = library.truth("wall", (8, 8))
    np.testing.assert_array_equal(again.matrix.toarray(), good.matrix.toarray())


def test_the_bundled_truth_needs_no_renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "render", None)
    assert library.truth("l_objects").camera_shape == (64, 64)
