"""`lightmatrix view`: paint on the projector in the browser, and see what the camera would."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Overwrite, Store
from lightmatrix.cli.terminal import say
from lightmatrix.errors import InputError


def view(
    scene: Store,
    export: Annotated[
        Path | None,
        typer.Option(
            "--export",
            metavar="PAGE.html",
            help="Write the viewer and the matrix as one page that needs no server.",
        ),
    ] = None,
    port: Annotated[int, typer.Option(help="Port on this machine; 0 for a free one.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
    overwrite: Overwrite = False,
) -> None:
    """Paint with light: show T in the browser.

    Paint on the projector, and see what the camera would photograph. Ctrl-C ends the viewer. The
    page is reachable from this machine only.
    """
    if export is not None:
        if port:
            raise InputError("--port with --export", hint="a page that is written needs no port")
        lm.export_viewer(export, scene, overwrite=overwrite)
        say(f"{export}: open it in a browser")
        return
    lm.serve_viewer(
        scene, port=port, browser=browser, ready=lambda address: say(f"{address}\nCtrl-C ends it")
    )
