"""`lightmatrix view`: paint on the projector in the browser, and see what the camera would."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Overwrite, Store, described
from lightmatrix.cli.terminal import progress, say
from lightmatrix.errors import InputError


@described(
    export=Option(
        metavar="PAGE.html",
        help="Write the viewer and the matrix as one page that needs no server.",
    ),
    capture="The capture of the estimate, whose patterns the page then offers.",
    geometry=Option(metavar="GEOMETRY.json", help="The geometry of the rig, for layers of depth."),
    port="Port on this machine; 0 for a free one.",
    browser=Option("--browser/--no-browser", help="Open the page in the browser."),
)
def view(
    scene: Store,
    export: Path | None = None,
    capture: Path | None = None,
    geometry: Path | None = None,
    port: int = 0,
    browser: bool = True,
    overwrite: Overwrite = False,
) -> None:
    """Paint with light: show T in the browser.

    Paint on the projector, and see what the camera would photograph. Ctrl-C ends the viewer. The
    page is reachable from this machine only.
    """
    if export is not None:
        if port:
            raise InputError("--port with --export", hint="a page that is written needs none")
        lm.export_viewer(export, scene, capture=capture, geometry=geometry, overwrite=overwrite)
        say(f"{export}: open it in a browser")
        return
    shown = ExitStack()

    @cache
    def bar() -> Any:
        return shown.enter_context(progress(f"indexing the columns of {scene.name}", "entries"))

    def ready(address: str) -> None:
        shown.close()
        say(f"{address}\nCtrl-C ends it")

    with shown:
        lm.serve_viewer(
            scene, port=port, browser=browser, ready=ready, progress=lambda *step: bar()(*step),
            capture=capture, geometry=geometry,
        )  # fmt: skip
