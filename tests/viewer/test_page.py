"""The page in a real browser: what it computes, what it draws, and how it is used."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.pictures import maps
from lightmatrix.simulation.procedural import ProceduralScene
from tests.viewer import running
from tests.viewer.running import (
    VIEWER,
    numbers,
    pattern,
    photograph,
    settle,
    shown,
    spot,
    stroke,
    wait_for,
)

pytest.importorskip("uvicorn")
# What the page computes may miss T p by this share of the white image.
CLOSE = 1e-3
# Most of this is the browser's; docs/viewer.md has what a quiet machine takes.
SLOWEST_STROKE_MS = 150


@pytest.fixture(scope="module")
def transport() -> lm.LightTransport:
    return running.scene()


@pytest.fixture(scope="module")
def server(
    transport: lm.LightTransport, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[running.Server]:
    store = tmp_path_factory.mktemp("viewer") / "scene.zarr"
    lm.save(store, transport)
    with running.served(store) as server:
        yield server


@pytest.fixture
def page(browser: Browser, server: running.Server) -> Iterator[Page]:
    with shown(browser, server.address) as page:
        yield page


def assert_relit(page: Page, transport: lm.LightTransport) -> None:
    """Whether the photograph of the page is that of its pattern."""
    white = float(transport.relight(np.ones(transport.projector_shape)).max())
    expected = transport.relight(pattern(page, transport))
    assert np.abs(photograph(page, transport) - expected).max() <= CLOSE * white


def test_strokes_are_relit(page: Page, transport: lm.LightTransport) -> None:
    before = pattern(page, transport)
    assert_relit(page, transport)
    stroke(page, (1, 1), (3, 9), (12, 15))
    painted = pattern(page, transport)
    assert (painted - before).sum() > 20
    assert_relit(page, transport)
    page.get_by_role("slider", name="Intensity").fill("40")
    stroke(page, (8, 2), (8, 16))
    assert 102 / 255 in pattern(page, transport)
    page.get_by_role("radio", name="Eraser").check()
    stroke(page, (14, 4), (2, 4))
    assert_relit(page, transport)
    for _ in range(2):
        page.get_by_role("button", name="Undo").click()
    np.testing.assert_array_equal(pattern(page, transport), painted)
    assert_relit(page, transport)
    page.get_by_role("button", name="Redo").click()
    assert (pattern(page, transport) != painted).any()


def test_many_strokes_add_up_to_no_error(page: Page, transport: lm.LightTransport) -> None:
    """The photograph is only ever changed by differences; their rounding must not add up."""
    page.evaluate(
        f"""() => {{
          let seed = 1;
          const next = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
          for (let k = 0; k < 3000; k++) {{
            {VIEWER}.pattern.stroke([next() * 16, next() * 18], [next() * 16, next() * 18],
                                    1 + 4 * next(), Math.floor(256 * next()));
            {VIEWER}.relight();
          }}
          {VIEWER}.change();
        }}"""
    )
    levels = pattern(page, transport)
    assert len(np.unique(levels)) > 10
    assert_relit(page, transport)


def test_stored_patterns(page: Page, transport: lm.LightTransport) -> None:
    options = page.get_by_label("Stored pattern").locator("option").all_text_contents()
    expected: dict[str, NDArray[np.float64] | None] = {
        "White": np.ones((16, 18)),
        "Ramp": np.tile(np.rint(255 * np.arange(18) / 17) / 255, (16, 1)),
        "Vertical stripes": np.tile(np.arange(18) % 2 < 1.0, (16, 1)).astype(float),
        "Checkerboard": None,
        "Random": None,
    }
    for name, wanted in expected.items():
        page.get_by_label("Stored pattern").select_option(next(o for o in options if name in o))
        levels = pattern(page, transport)
        if wanted is not None:
            np.testing.assert_allclose(levels, wanted)
        assert_relit(page, transport)
        page.get_by_role("button", name="Invert").click()
        np.testing.assert_allclose(pattern(page, transport), 1 - levels, atol=1e-9)
        page.get_by_role("button", name="Clear").click()
        assert photograph(page, transport) == pytest.approx(0, abs=1e-6)


def test_a_picture_becomes_the_pattern(
    page: Page, transport: lm.LightTransport, tmp_path: Path
) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (16, 18)).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "picture.png")
    page.locator("input[type=file]").set_input_files(tmp_path / "picture.png")
    page.get_by_role("button", name="Undo").and_(page.locator(":enabled")).wait_for()
    np.testing.assert_allclose(255 * pattern(page, transport), levels, atol=1.01)
    assert_relit(page, transport)
    # A picture in colour and of another shape is shown whole, which the page says.
    Image.new("RGB", (36, 16), (200, 60, 60)).save(tmp_path / "wide.jpg")
    page.locator("input[type=file]").set_input_files(tmp_path / "wide.jpg")
    page.get_by_text("wide.jpg (36 × 16) is shown in grey at 18 × 8, with black bars").wait_for()
    lit = pattern(page, transport) > 0.3
    np.testing.assert_array_equal(lit[[1, 7, 14]].all(axis=1), [False, True, False])
    (tmp_path / "text.png").write_text("no picture")
    page.locator("input[type=file]").set_input_files(tmp_path / "text.png")
    page.get_by_text("text.png is not a picture").wait_for()


def test_what_is_drawn_is_what_was_computed(page: Page, transport: lm.LightTransport) -> None:
    page.get_by_role("slider", name="Exposure").fill("-1")
    page.get_by_role("slider", name="Gamma").fill("2")
    settle(page)
    drawn = numbers(page, f"{VIEWER}.snapshot().data").reshape(*transport.camera_shape, 4)
    light = 0.5 * photograph(page, transport)
    np.testing.assert_allclose(drawn[..., 0], 255 * np.clip(light, 0, 1) ** 0.5, atol=1)
    assert (drawn[..., 3] == 255).all()
    # The same pixels on the screen, where each is many.
    centres = [spot(page, "camera", row + 0.5, col + 0.5) for row, col in ((2, 3), (20, 11))]
    picture = page.screenshot()
    for (row, col), (x, y) in zip(((2, 3), (20, 11)), centres, strict=True):
        assert _pixel(picture, x, y)[0] == pytest.approx(drawn[row, col, 0], abs=1)
    page.get_by_label("Mark clipped").check()
    page.get_by_role("slider", name="Exposure").fill("3")
    drawn = numbers(page, f"{VIEWER}.snapshot().data").reshape(*transport.camera_shape, 4)
    clipped = 8 * photograph(page, transport) >= 1
    assert clipped.any()
    np.testing.assert_array_equal((drawn[..., 0] == 230) & (drawn[..., 1] < 30), clipped)
    page.get_by_label("False colour").check()
    page.get_by_label("Mark clipped").uncheck()
    drawn = numbers(page, f"{VIEWER}.snapshot().data").reshape(*transport.camera_shape, 4)
    # The brightest colour of viridis.
    assert drawn[clipped][:, :3] == pytest.approx(np.tile((253, 231, 36), (clipped.sum(), 1)))


def _pixel(png: bytes, x: float, y: float) -> tuple[int, ...]:
    import io

    found = Image.open(io.BytesIO(png)).convert("RGB").getpixel((int(x), int(y)))
    assert isinstance(found, tuple)
    return found


def test_the_scene_lies_behind_the_pattern(page: Page) -> None:
    page.get_by_role("button", name="Clear").click()
    wait_for(page, f"!!{VIEWER}.layers.behind")
    brightest = int(np.argmax(numbers(page, f"{VIEWER}.layers.behind")))

    def shown_there() -> tuple[int, ...]:
        settle(page)
        place = spot(page, "projector", brightest // 18 + 0.5, brightest % 18 + 0.5)
        return _pixel(page.screenshot(), *place)

    red, _, blue = shown_there()
    assert 20 < red < blue
    page.get_by_label("Scene behind the pattern").uncheck()
    assert shown_there() == (0, 0, 0)


def test_rows_and_columns(page: Page, transport: lm.LightTransport) -> None:
    page.mouse.move(*spot(page, "camera", 7.5, 11.5))
    settle(page)
    row = numbers(page, f"{VIEWER}.overlay.projector.values").reshape(16, 18)
    np.testing.assert_allclose(row, transport.row(7, 11), atol=CLOSE * row.max())
    assert page.get_by_text("Row of camera pixel 7, 11").is_visible()
    assert page.get_by_text("row 7, column 11:").is_visible()
    page.mouse.move(5, 5)
    settle(page)
    assert page.evaluate(f"{VIEWER}.overlay.projector") is None
    page.get_by_role("radio", name="Column").check()
    page.mouse.click(*spot(page, "projector", 9.2, 4.8))
    settle(page)
    column = numbers(page, f"{VIEWER}.overlay.camera.values").reshape(transport.camera_shape)
    np.testing.assert_allclose(column, transport.column(9, 4), atol=CLOSE * column.max())
    assert page.get_by_text("Column of projector pixel 9, 4").is_visible()


@pytest.mark.parametrize("name", ["clipping", "estimated-error", "row", "confidence", "dual"])
def test_layers(name: str, page: Page, transport: lm.LightTransport) -> None:
    side = "projector" if name == "dual" else "camera"
    page.get_by_label(f"Layer of the {side}").select_option(name)
    # The network may be idle before the page asks for the layer.
    wait_for(page, f"!!{VIEWER}.layers.get('{name}')")
    values = numbers(page, f"Array.from({VIEWER}.layers.get('{name}').arrays.values, String)")
    matches = maps.correspondence_maps(lm.correspondence(transport))
    expected = {
        "clipping": maps.clipping_map(transport).values,
        "estimated-error": maps.estimated_error_map(transport).values,
        "row": matches[0].values,
        "confidence": matches[2].values,
        "dual": transport.dual_image().astype(float),
    }[name]
    np.testing.assert_allclose(values, expected.ravel(), rtol=1e-6)
    # The address shows the same layer again.
    wait_for(page, f"location.hash.includes('{side}={name}')")
    page.reload()
    page.locator(".stage").first.wait_for()
    wait_for(page, f"{VIEWER}?.panes.{side}.select.value === '{name}'")


@pytest.mark.slow  # A machine that is busy takes longer.
def test_painting_takes_less_than_an_eye_notices(page: Page) -> None:
    stroke(page, (2, 2), *((2 + k % 12, 2 + k) for k in range(14)))
    times = numbers(page, f"{VIEWER}.latencies")
    assert len(times) >= 10
    assert np.median(times) < SLOWEST_STROKE_MS


def test_a_stroke_is_seen_before_it_ends(
    browser: Browser, transport: lm.LightTransport, tmp_path: Path
) -> None:
    """Light that has come is drawn, even if the answer to a later movement is on its way."""
    store = tmp_path / "scene.zarr"
    lm.save(store, transport)
    with (
        running.served(store, program=running.ON_DISK) as server,
        shown(browser, server.address) as page,
    ):
        page.evaluate(f"Object.defineProperty({VIEWER}.matrix, 'expects', {{ get: () => true }})")
        stroke(page, *((2 + k % 12, 2 + k) for k in range(14)))
        assert len(numbers(page, f"{VIEWER}.latencies")) > 1
        assert_relit(page, transport)


def test_zoom_and_pan_are_joined_and_kept_in_the_address(page: Page) -> None:
    page.mouse.move(*spot(page, "camera", 6, 5))
    page.mouse.wheel(0, -600)
    settle(page)
    x, y = spot(page, "camera", 6, 5)
    # The place under the pointer stays there, as far as the picture's edge lets it.
    view = page.evaluate(f"{VIEWER}.view")
    assert view["zoom"] > 2
    scales = page.evaluate(f"Object.values({VIEWER}.panes).map((pane) => pane.at.scale)")
    assert scales[0] / scales[1] == pytest.approx(24 / 16, rel=0.4)
    page.get_by_role("radio", name="Move").check()
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 20)
    page.mouse.up()
    settle(page)
    assert spot(page, "camera", 6, 5) != (x, y)
    view = page.evaluate(f"{VIEWER}.view")
    kept = "Math.abs(new URLSearchParams(location.hash.slice(1)).get"
    wait_for(page, " && ".join(f"{kept}('{key}') - {view[key]}) < 0.01" for key in "xy"))
    page.reload()
    page.locator(".stage").first.wait_for()
    again = page.evaluate(f"{VIEWER}.view")
    assert [again[key] for key in "xy"] == pytest.approx([view[key] for key in "xy"], abs=0.01)


def test_everything_by_keyboard(page: Page, transport: lm.LightTransport) -> None:
    page.get_by_role("button", name="Clear").click()
    page.get_by_role("slider", name="Size").fill("1")
    projector = page.get_by_role("application", name="Projector. Arrow")
    projector.focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.keyboard.press("Shift+ArrowDown")
    page.keyboard.press("Space")
    painted = pattern(page, transport)
    expected = np.zeros((16, 18))
    expected[7, 9:14] = 1
    expected[15, 13] = 1
    np.testing.assert_array_equal(painted, expected)
    page.keyboard.press("Control+z")
    assert pattern(page, transport).sum() == 5
    page.keyboard.press("i")
    assert pattern(page, transport).sum() == 16 * 18 - 5
    page.keyboard.press("e")
    assert page.get_by_role("radio", name="Eraser").is_checked()
    page.get_by_role("application", name="Camera. Arrow").focus()
    page.keyboard.press("ArrowDown")
    settle(page)
    assert "row 13, column 10:" in page.get_by_role("status").inner_text()
    row = numbers(page, f"{VIEWER}.overlay.projector.values").reshape(16, 18)
    np.testing.assert_allclose(row, transport.row(13, 10), atol=CLOSE * row.max())


def test_files_of_photograph_and_pattern(
    page: Page, transport: lm.LightTransport, tmp_path: Path
) -> None:
    for name, expression in (("Save pattern", "patternImage"), ("Save photograph", "snapshot")):
        with page.expect_download() as download:
            page.get_by_role("button", name=name).click()
        download.value.save_as(tmp_path / "file.png")
        shape = transport.projector_shape if "pattern" in name else transport.camera_shape
        found = np.asarray(Image.open(tmp_path / "file.png").convert("L"))
        drawn = numbers(page, f"{VIEWER}.{expression}().data").reshape(*shape, 4)
        np.testing.assert_array_equal(found, drawn[..., 0])


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (390, "dark")])
def test_everyone_can_use_it(
    width: int, scheme: str, browser: Browser, server: running.Server
) -> None:
    with shown(browser, server.address, width, color_scheme=scheme, bypass_csp=True) as page:
        page.get_by_text("Keyboard").click()
        page.get_by_label("Layer of the camera").select_option("clipping")
        page.wait_for_load_state("networkidle")
        violations = Axe().run(page).response["violations"]
        assert not violations, [v["id"] + str(v["nodes"][0]["html"]) for v in violations]
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        # On a telephone, the tools are in sight beside the picture that one paints on.
        page.evaluate("scrollTo(0, 0)")
        bottom = page.get_by_role("slider", name="Size").evaluate(
            "(slider) => slider.getBoundingClientRect().bottom"
        )
        assert bottom <= 600
        sizes = page.evaluate(
            "[...document.querySelectorAll('button, select')].map((e) => e.clientHeight)"
        )
        assert min(sizes) >= 24


def test_no_tool_is_cut_off(page: Page) -> None:
    right = "(e) => e.getBoundingClientRect().right"
    for width in (600, 1024, 1200):
        page.set_viewport_size({"width": width, "height": 900})
        for name in ("Brush", "Move"):
            tool = page.locator(".choice label", has_text=name)
            assert tool.evaluate(right) <= page.locator(".choice").evaluate(right)
            assert tool.locator("span").evaluate("(e) => e.scrollWidth <= e.clientWidth")


def test_a_colour_camera(browser: Browser, tmp_path: Path) -> None:
    grey = running.scene()
    matrix = csr_array(
        np.repeat(grey.sparse.toarray(), 3, axis=0) * np.tile([1, 0.5, 0.2], 480)[:, None]
    )
    colour = lm.LightTransport.from_matrix(matrix, (24, 20, 3), (16, 18))
    lm.export_viewer(tmp_path / "page.html", colour)
    with shown(browser, (tmp_path / "page.html").as_uri()) as page:
        assert_relit(page, colour)
        stroke(page, (1, 1), (3, 9))
        assert_relit(page, colour)
        page.mouse.move(*spot(page, "camera", 7.5, 11.5))
        settle(page)
        row = numbers(page, f"{VIEWER}.overlay.projector.values").reshape(16, 18)
        expected = sum(colour.row(7, 11, channel) for channel in range(3))
        np.testing.assert_allclose(row, expected, atol=CLOSE * row.max())


def test_the_exported_page_needs_no_network(
    browser: Browser, transport: lm.LightTransport, tmp_path: Path
) -> None:
    patterns = lm.BernoulliPatterns(transport.projector_shape, 3)
    capture = lm.simulate(ProceduralScene((24, 20), (16, 18)).truth(), patterns, exposure=0.1)
    lm.export_viewer(tmp_path / "page.html", transport, capture=capture)
    text = (tmp_path / "page.html").read_text()
    addresses = re.findall(r"(?:src|href)=[\"']?([^\"'\s>]+)", text)
    assert not addresses
    context = browser.new_context(offline=True)
    requests: list[str] = []
    context.on("request", lambda request: requests.append(request.url))
    page = context.new_page()
    page.goto((tmp_path / "page.html").as_uri())
    page.locator(".stage").first.wait_for()
    assert_relit(page, transport)
    stroke(page, (1, 1), (9, 9))
    assert_relit(page, transport)
    page.get_by_role("slider", name="Pattern of the capture").fill("2")
    page.get_by_text("3 of 3").wait_for()
    np.testing.assert_array_equal(pattern(page, transport), patterns.images(2, 3)[0])
    page.get_by_label("Layer of the camera").select_option("estimated-error")
    settle(page)
    assert page.evaluate(f"{VIEWER}.shown.camera") == "estimated-error"
    assert [url for url in requests if not url.startswith(("file:", "blob:"))] == []
    context.close()


def test_titles_are_text(browser: Browser, transport: lm.LightTransport, tmp_path: Path) -> None:
    store = tmp_path / "<script>alert(1)<b>.zarr"
    if not _can_be_named(store):
        pytest.skip("this file system refuses the name")
    lm.save(store, transport)
    lm.export_viewer(tmp_path / "page.html", store)
    with shown(browser, (tmp_path / "page.html").as_uri()) as page:
        assert page.locator("h1").inner_text() == "<script>alert(1)<b>.zarr"


def _can_be_named(path: Path) -> bool:
    return "/" not in path.name
