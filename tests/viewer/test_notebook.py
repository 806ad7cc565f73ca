"""The widget for notebooks: its object, and its module in a page that stands in for anywidget."""

from __future__ import annotations

import base64
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import lightmatrix as lm
from tests.viewer import hostile, running
from tests.viewer.running import numbers, settle, spot

pytest.importorskip("anywidget")
CLOSE = 1e-3
# A host as small as can be: the model of anywidget with the traits of one widget, and its element.
HOST = (Path(__file__).parent / "host.html").read_text()


@contextmanager
def hosted(page: Page, widget: Any) -> Iterator[Page]:
    """A page that shows a widget, connected to it in place of a kernel."""
    answers: list[tuple[Any, list[str]]] = []

    def send(content: Any, buffers: list[bytes]) -> None:
        answers.append((content, [base64.b64encode(part).decode() for part in buffers]))

    def python(what: str, content: Any, buffers: list[str]) -> Any:
        parts = [base64.b64decode(part) for part in buffers]
        if what == "traits":
            names = ("description", "matrix", "levels")
            return {n: base64.b64encode(getattr(widget, n)).decode() for n in names}
        if what == "module":
            return widget._esm
        if what == "levels":
            widget.levels = parts[0]
            return None
        answers.clear()
        widget._handle_custom_msg(content, parts)
        return list(answers)

    widget.views._send = send
    page.expose_function("python", python)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.set_default_timeout(running.PATIENCE_MS)
    page.set_content(HOST.replace("STYLE", widget._css))
    page.locator(".stage").first.wait_for()
    while not page.evaluate("Boolean(globalThis.lightmatrixViewer)"):
        page.wait_for_timeout(20)
    settle(page)
    yield page
    page.close()
    assert not errors


@pytest.mark.parametrize("page_bytes", [1 << 25, 0], ids=["in the page", "in the kernel"])
def test_brush_row_column_and_layers(page_bytes: int, browser: Browser) -> None:
    transport = running.scene()
    widget = lm.view(transport, page_bytes=page_bytes)
    assert bool(widget.matrix) == bool(page_bytes)
    with hosted(browser.new_page(), widget) as page:

        def assert_relit() -> None:
            expected = transport.relight(running.pattern(page, transport))
            white = transport.relight(np.ones((16, 18))).max()
            found = running.photograph(page, transport)
            assert np.abs(found - expected).max() <= CLOSE * white

        assert_relit()
        running.stroke(page, (1, 1), (3, 9), (12, 15))
        assert_relit()
        # The kernel learns what was painted, and the page what is assigned.
        painted = running.pattern(page, transport)
        end = time.monotonic() + running.PATIENCE_MS / 1000
        while (widget.pattern != painted).any() and time.monotonic() < end:
            page.wait_for_timeout(20)
        np.testing.assert_array_equal(widget.pattern, painted)
        np.testing.assert_allclose(widget.photograph, transport.relight(painted))
        widget.pattern = np.eye(16, 18)
        page.evaluate("(text) => host.change(text)", base64.b64encode(widget.levels).decode())
        np.testing.assert_array_equal(running.pattern(page, transport), np.eye(16, 18))
        assert_relit()
        page.mouse.move(*spot(page, "camera", 7.5, 11.5))
        settle(page)
        row = numbers(page, "lightmatrixViewer.overlay.projector.values").reshape(16, 18)
        np.testing.assert_allclose(row, transport.row(7, 11), atol=CLOSE * row.max())
        page.get_by_role("radio", name="Column").check()
        page.mouse.click(*spot(page, "projector", 9.2, 4.8))
        settle(page)
        column = numbers(page, "lightmatrixViewer.overlay.camera.values").reshape(24, 20)
        np.testing.assert_allclose(column, transport.column(9, 4), atol=CLOSE * column.max())
        page.get_by_label("Layer of the camera").select_option("clipping")
        page.get_by_text("Computing the layer").wait_for(state="hidden")
        assert page.evaluate("lightmatrixViewer.shown.camera") == "clipping"
        page.evaluate("ended()")


def test_the_pattern_of_a_widget() -> None:
    widget = lm.view(running.scene())
    assert widget.levels == b""
    assert widget.pattern.shape == (16, 18)
    widget.pattern = np.full((16, 18), 0.2)
    assert widget.levels == bytes([51]) * (16 * 18)
    for pattern, words in (
        (np.ones((18, 16)), "shape"),
        (np.full((16, 18), 1.1), "outside"),
        (np.full((16, 18), np.nan), "finite"),
    ):
        with pytest.raises(lm.InputError, match=words):
            widget.pattern = pattern


def test_what_no_view_sends_is_ignored() -> None:
    widget = lm.view(running.scene(), page_bytes=0)
    sent: list[Any] = []
    widget.views._send = lambda *message: sent.append(message)
    for content in (None, "text", {}, {"view": 3}, {"view": "a", "what": "else"}):
        widget._handle_custom_msg(content, [])
    for message in hostile.nonsense((24, 20), (16, 18)):
        if isinstance(message, bytes):
            widget._handle_custom_msg({"view": "a", "what": "message"}, [message])
    assert not sent
    widget._handle_custom_msg({"view": "a", "what": "layer", "name": ["gap"]}, [])
    assert "error" in sent[-1][0]
    for number in range(20):
        message = hostile.messages((24, 20), (16, 18))[0]
        widget._handle_custom_msg({"view": str(number), "what": "message"}, [message])
    assert len(widget.views._sessions) == 8


def test_without_the_extra_it_says_what_to_install(tmp_path: Path) -> None:
    lm.save(tmp_path / "scene.zarr", running.scene())
    program = (
        "import sys; sys.modules['anywidget'] = None\n"
        "import lightmatrix as lm\n"
        f"try: lm.view({str(tmp_path / 'scene.zarr')!r})\n"
        "except lm.MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert 'pip install "lightmatrix[notebook]"' in done.stdout, done.stderr
