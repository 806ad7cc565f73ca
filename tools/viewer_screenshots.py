"""Photograph the viewer for the docs, or measure how fast it paints.

python tools/viewer_screenshots.py
python tools/viewer_screenshots.py --times
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import psutil
from browser import opened
from playwright.sync_api import Browser, Page

import lightmatrix as lm
from lightmatrix.simulation.procedural import ProceduralScene

IMAGES = Path(__file__).parent.parent / "docs" / "images"
Scheme = Literal["light", "dark"]
WINDOWS: dict[int, tuple[int, Scheme]] = {
    1440: (900, "light"),
    390: (844, "dark"),
}
# Camera and projector of the matrices whose strokes are timed, and movements of the brush.
SIZES = (((128, 128), (128, 128)), ((768, 1024), (1024, 1024)))
# Serves a store, of which the page may hold some bytes; with 0 T stays on disk.
SERVE = """import functools, sys, lightmatrix as lm
ready = functools.partial(print, flush=True)
lm.serve_viewer(sys.argv[1], browser=False, page_bytes=int(sys.argv[2]), ready=ready)"""
MOVEMENTS = 120


def main() -> None:
    """Make the screenshots, or print a table of times."""
    with tempfile.TemporaryDirectory() as place, opened() as browser:
        if "--times" in sys.argv:
            for camera, projector in SIZES:
                store, truth = Path(place) / "T.zarr", _like_an_estimate(camera, projector)
                lm.save(store, truth, overwrite=True)
                lm.index_columns(store)
                for page_bytes in (512 << 20, 0):
                    print(_times(browser, store, truth, page_bytes), flush=True)
            return
        file = Path(place) / "page.html"
        lm.export_viewer(file, lm.truth("metal").transport())
        for width, (height, scheme) in WINDOWS.items():
            with _shown(browser, file.as_uri(), width, height, scheme) as page:
                _letter(page)
                page.screenshot(path=IMAGES / f"viewer-{width}.png")


def _like_an_estimate(camera: tuple[int, int], projector: tuple[int, int]) -> lm.LightTransport:
    """A dozen entries a row and a background of 8 x 8 cells, as estimates have them."""
    scene = ProceduralScene(camera, projector, seed=1, bounces=8, background=0)
    sparse = scene.truth().transport().sparse
    cells = 8 * 8
    falloff = 0.01 / (1 + np.arange(cells))
    background = np.outer(np.linspace(0.5, 1, sparse.shape[0]), falloff).astype(np.float32)
    return lm.LightTransport(sparse, background, camera, projector, background_grid=(8, 8))


@contextmanager
def _shown(
    browser: Browser, address: str, width: int, height: int, scheme: Scheme = "light"
) -> Iterator[Page]:
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    page.set_default_timeout(120_000)
    page.goto(address)
    page.locator(".stage").first.wait_for()
    yield page
    page.close()


def _letter(page: Page) -> None:
    """Paint the letter that stands for wavelengths, with a fine brush on a black projector."""
    page.get_by_role("button", name="Clear").click()
    page.evaluate("scrollTo(0, 0)")
    box = page.locator(".stage").first.bounding_box()
    assert box is not None
    side = min(box["width"], box["height"])
    left, top = box["x"] + (box["width"] - side) / 2, box["y"] + (box["height"] - side) / 2
    strokes = (((0.3, 0.2), (0.42, 0.2), (0.72, 0.82)), ((0.51, 0.4), (0.28, 0.82)))
    for places in strokes:
        x, y = places[0]
        page.mouse.move(left + x * side, top + y * side)
        page.mouse.down()
        for x, y in places[1:]:
            page.mouse.move(left + x * side, top + y * side, steps=10)
        page.mouse.up()
    page.get_by_role("button", name="Auto exposure").click()
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(500)


def _times(browser: Browser, store: Path, transport: lm.LightTransport, page_bytes: int) -> str:
    """A row of the table in docs/viewer.md."""
    command = [sys.executable, "-c", SERVE, str(store), str(page_bytes)]
    begin = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        with _shown(browser, address, 1440, 900) as page:
            _wait(page)
            first = time.monotonic() - begin
            times = _circle(page)
            page.get_by_label("Stored pattern").select_option("checks")
            _wait(page)
        memory = psutil.Process(server.pid).memory_info().rss >> 20
        server.terminate()
    middle, most = np.quantile(times, (0.5, 0.9))
    camera, projector = (
        " x ".join(map(str, shape)) for shape in (transport.camera_shape, transport.projector_shape)
    )
    where = "in the page" if page_bytes else "on disk"
    return (
        f"| {projector} under {camera} | {transport.sparse.nnz:,} | {where} | {first:.1f} s "
        f"| {middle:.0f} ms | {most:.0f} ms | {memory} MiB |"
    )


def _wait(page: Page) -> None:
    """Wait until the photograph is that of the pattern."""
    frames = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.evaluate(frames)
    while page.evaluate("globalThis.lightmatrixViewer.matrix.busy"):
        page.wait_for_timeout(10)


def _circle(page: Page) -> list[float]:
    """Draw a circle, and return the milliseconds that each movement took to be seen."""
    box = page.locator(".stage").first.bounding_box()
    assert box is not None
    for k in range(MOVEMENTS):
        angle = 2 * np.pi * k / MOVEMENTS
        x = box["x"] + box["width"] * (0.5 + 0.25 * np.sin(angle))
        y = box["y"] + box["height"] * (0.5 - 0.25 * np.cos(angle))
        page.mouse.move(x, y)
        if k == 0:
            page.mouse.down()
    page.mouse.up()
    _wait(page)
    times: list[float] = page.evaluate("globalThis.lightmatrixViewer.latencies")
    return times


if __name__ == "__main__":
    main()
