"""T that follows a scene: what moved is found, learned anew, and nothing else changes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.capture.folder import write_capture
from lightmatrix.cli import main
from lightmatrix.estimators.tracking import Update
from lightmatrix.files.images import write_image
from lightmatrix.judgement.metrics import squared_errors
from lightmatrix.simulation.truth import Truth, binned

SIDE, WINDOW = 32, 24
PATTERNS = lm.BernoulliPatterns((SIDE, SIDE), 4 * WINDOW, seed=1)


@cache
def scene(name: str) -> Truth:
    """`l_objects`, or with a disc in which there is something else."""
    first = binned(lm.truth("l_objects"), 2)
    if name == "l_objects":
        return first
    down, right = np.mgrid[:SIDE, :SIDE]
    disc = np.flatnonzero((down - 15) ** 2 + (right - 16) ** 2 < 36)
    rows, other = first.matrix.tolil(), binned(lm.truth(name), 2).matrix
    rows[disc] = other[disc]
    matrix = csr_array(rows.tocsr(), dtype=np.float32)
    return replace(first, matrix=matrix, direct_data=np.zeros_like(matrix.data))


def photographs(name: str, start: int, stop: int) -> lm.Capture:
    patterns = PATTERNS.subset(np.arange(start, stop))
    return lm.simulate(scene(name), patterns, exposure=0.5, seed=start)


class Followed(NamedTuple):
    before: lm.LightTransport
    steps: list[Update]
    transports: list[lm.LightTransport]
    moved: NDArray[np.bool_]


@pytest.fixture(scope="module")
def first() -> tuple[lm.Capture, lm.LightTransport]:
    capture = photographs("l_objects", 0, WINDOW)
    return capture, lm.estimate(capture, check=False, correct="none", progress=False)


@pytest.fixture(scope="module")
def followed(first: tuple[lm.Capture, lm.LightTransport]) -> Followed:
    """Two photographs of the scene, and 16 after a part of it changed."""
    tracker = lm.Tracker(*first)
    steps, transports = [], []
    for capture in (photographs("l_objects", 24, 26), photographs("gripper", 26, 42)):
        for step in tracker.follow(capture):
            steps.append(step)
            transports.append(tracker.transport)
    moved = abs(scene("gripper").matrix - scene("l_objects").matrix).sum(axis=1) > 0
    return Followed(first[1], steps, transports, np.asarray(moved).ravel())


def test_nothing_changes_in_a_scene_that_stays(followed: Followed) -> None:
    for step in followed.steps[:2]:
        assert not step.changed.any()
        assert step.missed < 0.03
    assert (followed.transports[1].sparse != followed.before.sparse).nnz == 0


def test_the_map_shows_what_moved_and_when(followed: Followed) -> None:
    since = followed.transports[-1].diagnostics["since"]
    moved = followed.moved.reshape(SIDE, SIDE)
    assert (since > 0)[followed.moved].mean() > 0.97
    # Few neighbours are taken for changed, and nothing further away.
    assert (since > 0)[~followed.moved].sum() <= 5
    assert not (since > 0)[~binary_dilation(moved, np.ones((3, 3))).ravel()].any()
    # The change came with the third photograph, and shows in most rows at once.
    assert (since[followed.moved] == 3).mean() > 0.9
    assert followed.steps[2].changed.ravel()[followed.moved].mean() > 0.5
    assert lm.show(followed.transports[-1], "changes") is not None


def test_rows_that_did_not_change_stay_bit_by_bit(followed: Followed) -> None:
    after = followed.transports[-1]
    same = after.diagnostics["since"] == 0
    assert same.mean() > 0.8
    assert (after.sparse[same] != followed.before.sparse[same]).nnz == 0
    np.testing.assert_array_equal(after.background[same], followed.before.background[same])
    for name in ("gap", "estimated_error"):
        np.testing.assert_array_equal(
            after.diagnostics[name][same], followed.before.diagnostics[name][same]
        )


def test_what_changed_is_unknown_until_it_is_learned(followed: Followed) -> None:
    """No row is wrong in silence."""
    early, late = followed.transports[4], followed.transports[-1]
    assert early.diagnostics["unknown"][followed.moved].mean() > 0.95
    assert (early.diagnostics["estimated_error"][early.diagnostics["unknown"] > 0] == 1).all()
    assert lm.verdicts(early).transport.level == "doubtful"
    unknown = late.diagnostics["unknown"] > 0
    assert unknown[followed.moved].mean() < 0.05
    fresh = lm.estimate(photographs("gripper", 26, 50), check=False, correct="none", progress=False)
    truth = scene("gripper").transport()
    known = followed.moved & ~unknown
    wrong, light = squared_errors(late, truth)
    assert np.sqrt(wrong[known].sum() / squared_errors(fresh, truth)[0][known].sum()) < 1.5
    stated = np.sqrt((late.diagnostics["estimated_error"] ** 2 * light)[known].sum())
    assert 0.7 < stated / np.sqrt(wrong[known].sum()) < 2.5


def test_what_moves_once_more_meanwhile_is_learned_from_later_photographs(
    first: tuple[lm.Capture, lm.LightTransport], followed: Followed
) -> None:
    tracker = lm.Tracker(*first)
    for capture in (photographs("metal", 24, 29), photographs("gripper", 29, 47)):
        *_, last = tracker.follow(capture)
    assert np.median(tracker.since[followed.moved]) >= 6
    assert last.unknown.ravel()[followed.moved].mean() < 0.1
    known = followed.moved & ~last.unknown.ravel()
    wrong, light = squared_errors(tracker.transport, scene("gripper").transport())
    assert np.sqrt(wrong[known].sum() / light[known].sum()) < 0.1


def test_arrays_say_the_same_as_captures(first: tuple[lm.Capture, lm.LightTransport]) -> None:
    further = photographs("l_objects", 24, 25)
    one, other = lm.Tracker(*first), lm.Tracker(*first)
    by_capture = next(one.follow(further))
    by_arrays = other.update(further.frame(0), further.patterns.images()[0])
    assert by_capture.missed == by_arrays.missed


def test_what_does_not_fit_is_refused(first: tuple[lm.Capture, lm.LightTransport]) -> None:
    capture, transport = first
    tracker, frame, pattern = lm.Tracker(*first), capture.frame(0), np.ones((SIDE, SIDE))
    with pytest.raises(lm.InputError, match="uint16, binned"):
        tracker.update(frame.astype(np.uint16), pattern)
    with pytest.raises(lm.InputError, match="of patterns \\(31, 32"):
        tracker.update(frame, pattern[1:])
    with pytest.raises(lm.InputError, match="of other sizes"):
        lm.Tracker(capture.bin(camera=2), transport)
    with pytest.raises(lm.InputError, match="without light"):
        lm.Tracker(capture, replace(transport, sparse=0 * transport.sparse))


def test_the_command_follows_a_capture(
    followed: Followed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = photographs("l_objects", 0, 24), photographs("gripper", 24, 34)
    frames = [part.frame(k) for part in parts for k in range(part.count)]
    patterns, place = PATTERNS.subset(np.arange(34)), str(tmp_path / "c")
    write_capture(place, patterns, frames, sensor=lm.Sensor(exposure=0.5))
    store = str(tmp_path / "s.zarr")
    assert main(["track", place, "-o", store, "-k", "24", "--json"]) == 0
    lines = json.loads(capsys.readouterr().out)["photographs"]
    assert len(lines) == 10
    assert lines[0]["changed"] > 0.05
    assert (lm.open(store).diagnostics["since"] > 0)[followed.moved].mean() > 0.95
    assert main(["track", place, "-o", str(tmp_path / "t.zarr"), "-k", "34"]) == 2


@pytest.fixture
def watch(
    first: tuple[lm.Capture, lm.LightTransport], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> Callable[..., tuple[int, list[tuple[str, int, float]], str]]:  # fmt: skip
    """Runs `track --watch photos`: what it returns, what it took in, and what it said.

    Photographs arrive at whole seconds of a clock that goes as fast as the command.
    """
    capture, transport = first
    (tmp_path / "photos").mkdir()
    frames = [capture.frame(k) for k in range(WINDOW)]
    write_capture(tmp_path / "c", capture.patterns, frames, sensor=lm.Sensor(exposure=0.5))

    def run(arriving: Mapping[int, Callable[[Path], object]], *options: str) -> Any:
        now, waiting = [0.0], dict(arriving)

        def sleep(seconds: float) -> None:
            now[0] += seconds
            for when in [when for when in waiting if when <= now[0]]:
                waiting.pop(when)(tmp_path / "photos")

        def estimate(*_: object, **__: object) -> lm.LightTransport:
            # Photographs arrive meanwhile.
            sleep(1)
            return transport

        clock = SimpleNamespace(monotonic=lambda: now[0], sleep=sleep, perf_counter=lambda: now[0])
        for module in ("estimators.tracking", "files.new_files"):
            monkeypatch.setattr(f"lightmatrix.{module}.time", clock)
        monkeypatch.setattr(lm, "estimate", estimate)
        sleep(0)
        command = ["track", str(tmp_path / "c"), "-o", str(tmp_path / "s.zarr"), "--json"]
        code = main([*command, "--watch", str(tmp_path / "photos"), *options])
        out, err = capsys.readouterr()
        lines = json.loads(out)["photographs"] if code == 0 else []
        return code, [(Path(e["photograph"]).name, e["pattern"], e["changed"]) for e in lines], err

    return run


def photograph(number: int, name: str = "image_{:04}.png") -> Callable[[Path], object]:
    """Writes a photograph of the pattern of a number."""
    image = photographs("l_objects", 0, WINDOW).frame(number % WINDOW)
    return lambda folder: write_image(folder / name.format(number), image)


def test_names_say_which_pattern_photographs_show(watch: Callable[..., Any]) -> None:
    """Those that are there, those that come during the estimate, in any order, some missing."""
    later = [photograph(n) for n in (1, 2, 4, 24)]
    arriving = {0: later[1], 1: later[0], 3: later[2], 9: later[3]}
    code, lines, err = watch(arriving)
    assert (code, err) == (0, "")
    names = [(f"image_{n:04}.png", n % WINDOW) for n in (1, 2, 4, 24)]
    assert [line[:2] for line in lines] == names
    # Each follows from T under the pattern that it is paired with.
    assert max(changed for *_, changed in lines) < 0.01


def test_what_no_name_pairs_is_left_out_and_said(watch: Callable[..., Any]) -> None:
    def half(folder: Path) -> None:
        photograph(5)(folder)
        content = (folder / "image_0005.png").read_bytes()
        (folder / "image_0005.png").write_bytes(content[: len(content) // 2])

    def whole(folder: Path) -> None:
        (folder / "image_0005.png").unlink()
        photograph(5)(folder)

    small = np.zeros((16, 16), np.uint8)
    arriving = {
        0: photograph(3), 2: photograph(4, "copy_{:04}.png"), 3: photograph(4, "image_0004b.png"),
        4: half, 7: whole, 8: photograph(6),
        9: lambda folder: write_image(folder / "image_0007.png", small),
        17: lambda folder: (folder / "image_0008.png").write_bytes(b"no image"),
        24: photograph(9),
    }  # fmt: skip
    code, lines, err = watch(arriving)
    assert code == 0
    assert [pattern for _, pattern, _ in lines] == [3, 5, 6, 9]
    said = [line for line in err.splitlines() if line.startswith("warning: left out: ")]
    assert [name in line for name, line in zip(
        ("copy_0004.png", "image_0004b.png", "image_0007.png: is 16 x 16", "image_0008.png"),
        said, strict=True,
    )] == 4 * [True]  # fmt: skip


def test_numbers_of_another_count_are_refused_until_the_first_is_stated(
    watch: Callable[..., Any], tmp_path: Path
) -> None:
    coming = {0: photograph(810, "IMG_{}.png")}
    code, _, err = watch(coming)
    assert code == 2
    assert "IMG_810.png: is no number of a pattern" in err
    assert "--first" in err
    assert lm.open(tmp_path / "s.zarr").provenance["tracked_photographs"] == 0
    # Pattern 18 is number 810 if number 792 is that of the first one.
    code, lines, _ = watch({}, "--first", "792", "--overwrite")
    assert code == 0
    assert [pattern for _, pattern, _ in lines] == [18]


def test_without_a_further_photograph_there_is_t_of_the_window(
    first: tuple[lm.Capture, lm.LightTransport], watch: Callable[..., Any], tmp_path: Path
) -> None:
    assert watch({})[:2] == (0, [])
    assert (lm.open(tmp_path / "s.zarr").sparse != first[1].sparse).nnz == 0
    (tmp_path / "photos").rmdir()
    code, _, err = watch({}, "--overwrite")
    assert code == 2
    assert "photos: no such folder" in err


@pytest.mark.parametrize("wrong", ["out of step", "other patterns"])
def test_photographs_that_do_not_follow_the_patterns_are_doubtful(
    first: tuple[lm.Capture, lm.LightTransport], wrong: str,
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    tracker, step = lm.Tracker(*first), 1 if wrong == "out of step" else 40
    shown, seen = photographs("l_objects", 24, 29), photographs("l_objects", 24 + step, 29 + step)
    mixed = replace(seen, patterns=shown.patterns)
    with pytest.warns(lm.LightMatrixWarning, match="out of step with the patterns") as warned:
        assert len(list(tracker.follow(mixed))) == 5
    assert len(warned) == 1
    judged = lm.verdicts(tracker.transport)
    for each in (judged.transport, judged.relighting):
        assert each.level == "doubtful"
        assert "out of step with the patterns, or show others" in each.sentence
    assert judged.correspondence.level == "doubtful"
    lm.save(tmp_path / "s.zarr", tracker.transport)
    assert main(["info", str(tmp_path / "s.zarr")]) == 0
    assert "nan" not in capsys.readouterr().out


def test_a_part_that_is_not_known_counts_in_all_verdicts(followed: Followed) -> None:
    """A tenth of the rows was just found to have changed."""
    judged = lm.verdicts(followed.transports[4])
    assert judged.relighting.level == judged.transport.level == "doubtful"
    assert "changed and are not known yet" in judged.relighting.sentence
    before = lm.verdicts(followed.before).correspondence
    assert before.level != judged.correspondence.level
    clipped = followed.transports[-1].diagnostics["clipped_share"]
    assert np.isfinite(clipped).all()


def test_ctrl_c_leaves_no_photograph_half_taken_in(
    first: tuple[lm.Capture, lm.LightTransport], monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = photographs("gripper", 26, 32)
    one, other = lm.Tracker(*first), lm.Tracker(*first)
    for _ in one.follow(capture):
        pass
    solve = lm.Tracker._solve

    def stop(tracker: lm.Tracker) -> None:
        solve(tracker)
        raise KeyboardInterrupt

    for k in range(capture.count):
        steps = other.follow(capture.select([k]))
        with monkeypatch.context() as patch:
            patch.setattr(lm.Tracker, "_solve", stop)
            with pytest.raises(KeyboardInterrupt):
                next(steps)
        assert other.photographs == k
        next(other.follow(capture.select([k])))
    assert (one.transport.sparse != other.transport.sparse).nnz == 0
    for name, values in one.transport.diagnostics.items():
        np.testing.assert_array_equal(values, other.transport.diagnostics[name])


def test_changes_of_a_matrix_that_did_not_follow(followed: Followed) -> None:
    with pytest.raises(lm.InputError, match="no record of changes of its rows"):
        lm.show(followed.before, "changes")


@pytest.mark.filterwarnings("ignore::lightmatrix.LightMatrixWarning")
@pytest.mark.parametrize("level", [0, 255])
def test_photographs_that_show_nothing_do_not_make_rows_known(
    first: tuple[lm.Capture, lm.LightTransport], level: int
) -> None:
    """Of a lamp that is off, and of a camera that clips wherever it looks."""
    capture, transport = first
    tracker = lm.Tracker(capture, transport)
    photograph = np.full((SIDE, SIDE), level, np.uint8)
    for k in range(12):
        step = tracker.update(photograph, capture.patterns.images(k, k + 1)[0])
        assert step.missed < 1000
    for row_fact in tracker.transport.diagnostics.values():
        assert not np.isinf(row_fact).any()
    if level:
        changed = tracker.since > 0
        assert changed.mean() > 0.5
        assert step.unknown.ravel()[changed].all()
        assert "doubtful" in lm.verdicts(tracker.transport).transport.level


@pytest.mark.filterwarnings("ignore::lightmatrix.LightMatrixWarning")
def test_a_matrix_with_an_even_background_is_followed(
    first: tuple[lm.Capture, lm.LightTransport],
) -> None:
    transport = lm.estimate(first[0], coherent=False, check=False, progress=False)
    assert transport.background_grid == (1, 1)
    tracker = lm.Tracker(first[0], transport)
    steps = list(tracker.follow(photographs("gripper", 26, 34)))
    assert (tracker.since > 0).any()
    assert np.isfinite(steps[-1].missed)
