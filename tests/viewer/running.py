"""A viewer that runs: the command in a process of its own, and pages of a real browser."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page

import lightmatrix as lm
from lightmatrix.simulation.procedural import ProceduralScene

PATIENCE_MS = 120_000
VIEWER = "globalThis.lightmatrixViewer"
COMMAND = ("-m", "lightmatrix", "view", "--no-browser")
# The same with a page that may hold no matrix.
ON_DISK = (
    "-c",
    "import functools, sys, lightmatrix as lm\n"
    "ready = functools.partial(print, flush=True)\n"
    "lm.serve_viewer(sys.argv[1], browser=False, page_bytes=0, ready=ready)",
)


@dataclass(frozen=True)
class Server:
    process: subprocess.Popen[str]
    address: str

    @property
    def host(self) -> str:
        return self.address.split("/")[2]

    @property
    def port(self) -> int:
        return int(self.host.split(":")[1])

    @property
    def token(self) -> str:
        return self.address.split("/")[3]

    def stop(self) -> int:
        """Press Ctrl-C, and return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(120)


@contextmanager
def served(store: Path, *words: str, program: tuple[str, ...] = COMMAND) -> Iterator[Server]:
    """The command `view`, or another program of Python, until the block ends."""
    command = [sys.executable, *program, str(store), *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), process.communicate()
        yield Server(process, address)
    finally:
        process.kill()
        process.communicate()


@contextmanager
def shown(browser: Browser, address: str, width: int = 800, **options: Any) -> Iterator[Page]:
    """The page at an address, when its first picture is drawn; errors in it fail the test."""
    page = browser.new_page(viewport={"width": width, "height": 600}, **options)
    page.set_default_timeout(PATIENCE_MS)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.locator(".stage").first.wait_for()
    settle(page)
    yield page
    page.close()
    assert not errors


def settle(page: Page) -> None:
    """Wait for the frame that shows the last change."""
    frames = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.evaluate(frames)
    wait_for(page, f"!{VIEWER}.matrix.busy")


def wait_for(page: Page, condition: str) -> None:
    """Wait until an expression is true; the page's own rules forbid `page.wait_for_function`."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(condition):
        assert time.monotonic() < end, f"still waiting for {condition}"
        page.wait_for_timeout(10)


def numbers(page: Page, expression: str, dtype: Any = np.float64) -> NDArray[Any]:
    """An array of the page, such as the photograph of its viewer."""
    return np.array(json.loads(page.evaluate(f"JSON.stringify([...{expression}])")), dtype)


def pattern(page: Page, transport: lm.LightTransport) -> NDArray[np.float64]:
    """The pattern that the page shows, in [0, 1]."""
    settle(page)
    levels = numbers(page, f"{VIEWER}.pattern.levels")
    return levels.reshape(transport.projector_shape) / 255


def photograph(page: Page, transport: lm.LightTransport) -> NDArray[np.float64]:
    """What the page computed, of the camera's shape."""
    settle(page)
    return numbers(page, f"{VIEWER}.photograph").reshape(transport.camera_shape)


def spot(page: Page, side: str, row: float, col: float) -> tuple[float, float]:
    """Where a place of an image, in its pixels, is on the screen."""
    found: list[float] = page.evaluate(
        f"""([side, row, col]) => {{
          const pane = {VIEWER}.panes[side];
          pane.stage.scrollIntoView({{ block: "nearest" }});
          const box = pane.stage.getBoundingClientRect();
          const ratio = pane.picture.canvas.width / box.width;
          return [box.left + (pane.at.left + col * pane.at.scale) / ratio,
                  box.top + (pane.at.top + row * pane.at.scale) / ratio];
        }}""",
        [side, row, col],
    )
    return found[0], found[1]


def stroke(page: Page, *places: tuple[float, float]) -> None:
    """Drag the mouse over places of the projector."""
    page.mouse.move(*spot(page, "projector", *places[0]))
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*spot(page, "projector", *place), steps=4)
    page.mouse.up()
    settle(page)


def scene(camera: tuple[int, int] = (24, 20), projector: tuple[int, int] = (16, 18)) -> Any:
    """A matrix of odd shapes with a background in 2 x 3 cells, and diagnostics."""
    truth = ProceduralScene(camera, projector, seed=1, bounces=3).truth().transport()
    rows = truth.shape[0]
    generator = np.random.default_rng(0)
    return replace(
        truth,
        background=generator.uniform(0, 0.5, (rows, 6)).astype(np.float32),
        background_grid=(2, 3),
        diagnostics={
            "clipped_share": generator.uniform(0, 1, rows).astype(np.float32),
            "estimated_error": generator.uniform(0.001, 1, rows).astype(np.float32),
        },
    )
