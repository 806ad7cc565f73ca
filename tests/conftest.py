"""What is done once for all tests."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

import lightmatrix as lm
from lightmatrix.simulation import library
from lightmatrix.simulation.library import read_bundled
from lightmatrix.simulation.truth import Truth, binned
from tests.helpers.projectors import two_projectors

# A busy machine may need long for an example, and for drawing it.
settings.register_profile(
    "busy", deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("busy")


@pytest.fixture(scope="session", autouse=True)
def _scenes_are_unpacked_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The bundled scenes, which take up to a second each and are asked for hundreds of times.

    Others are rendered from few paths, and not kept in the user's cache.
    """
    rendered = tmp_path_factory.mktemp("rendered")

    @cache
    def once(path: Path) -> Truth:
        truth = read_bundled(path)
        # No test may change what the next ones get.
        for values in (truth.matrix.data, truth.matrix.indices, truth.matrix.indptr):
            values.flags.writeable = False
        truth.direct_data.flags.writeable = False
        return truth

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "read_bundled", once)
        patch.setattr(library, "USUAL_SAMPLES", 64)
        patch.setattr(library, "cache_folder", lambda: rendered)
        yield


@pytest.fixture(scope="module")
def small_scenes() -> Iterator[None]:
    """The bundled scenes at smaller sizes too, binned, and a stage that is made of one."""
    bundled = library.truth
    coarse = cache(lambda name, factor: binned(bundled(name), factor))

    def truth(
        name: str | Path | Truth, size: tuple[int, int] = library.BUNDLED_SIZE, **options: Any
    ) -> Truth:
        if name == "stage":
            camera = options.pop("camera", 1)
            return two_projectors(truth("l_objects", size, **options), camera)
        if name in library.BUNDLED and size in ((32, 32), (16, 16)):
            return coarse(name, 64 // size[0])
        return bundled(name, size, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "truth", truth)
        patch.setattr(lm, "truth", truth)
        yield


@pytest.fixture(scope="module")
def unchecked() -> Iterator[None]:
    """Estimates that do not look for faults of their photographs, which takes longest."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("estimate", "colour"):
            name = f"lightmatrix.estimators.{module}.refuse_unordered"
            patch.setattr(name, lambda capture: [])
        patch.setattr("lightmatrix.estimators.estimate._without_faults", lambda *_: None)
        yield


# Files that one process runs together: it alone has the loopback network's camera, a browser, and
# the work folder of the faults with its fork server. They take longest, and so come first.
_TOGETHER = {
    "tests/faults/": "faults",
    "tests/rig/test_aravis.py": "gige",
    "tests/rig/test_devices.py": "gige",
    "tests/viewer/": "viewer",
}


def _group(nodeid: str) -> str:
    """The tests that one process runs one after the other: those of a file, as they share fixtures.

    The examples share nothing and are the longest file, so each is handed out by itself.
    """
    file = nodeid.split("::", 1)[0]
    if file == "tests/project/test_examples.py":
        return nodeid
    return next((name for start, name in _TOGETHER.items() if file.startswith(start)), file)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the largest groups first, so that no process is left alone with one."""
    items.sort(key=lambda item: _group(item.nodeid) not in _TOGETHER.values())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Hand out the groups, each to one process."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    scheduling = LoadFileScheduling(config, log)
    scheduling._split_scope = _group
    return scheduling
