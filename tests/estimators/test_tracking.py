"""T that follows a scene: what moved is found, learned anew, and nothing else changes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.capture.folder import write_capture
from lightmatrix.cli import main
from lightmatrix.estimators.tracking import Update
from lightmatrix.judgement.metrics import squared_errors
from lightmatrix.rig.devices.base import Frame
from lightmatrix.rig.devices.folders import WatchedFolder
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
    with pytest.raises(lm.InputError, match="uint16 of a pattern"):
        tracker.update(frame.astype(np.uint16), pattern)
    with pytest.raises(lm.InputError, match="a pattern \\(31, 32"):
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


def test_the_command_follows_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = photographs("l_objects", 0, 24)
    frames_so_far = [capture.frame(k) for k in range(24)]
    write_capture(tmp_path / "c", capture.patterns, frames_so_far, sensor=lm.Sensor(exposure=0.5))

    def frames() -> Iterator[Frame]:
        for k in range(3):
            yield Frame(capture.frame(k), 0.0, 255.0)
        raise lm.FrameTimeoutError("no more", hint="")

    coming = frames()
    monkeypatch.setattr(WatchedFolder, "get_image", lambda *_, **__: next(coming))
    command = ["track", str(tmp_path / "c"), "-o", str(tmp_path / "s.zarr")]
    assert main([*command, "--watch", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "% missed, " in out
    assert "T after 3 photographs" in out
