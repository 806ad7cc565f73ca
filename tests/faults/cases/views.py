"""The viewer: what it refuses before it serves a page, and pages that are written."""

from __future__ import annotations

import socket
from pathlib import Path

from ..case import Case, Command, Ran
from ..checks import holds
from ..put import both, copy, flip, text

NEEDS = ("scene.zarr",)
SERVE = "view scene.zarr --no-browser"


def _on_a_port_in_use(folder: Path, run: Command) -> Ran:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return run(f"{SERVE} --port {taken.getsockname()[1]}")


CASES = [
    Case("no store", "view nowhere.zarr --no-browser", "nowhere.zarr"),
    Case("a port in use", SERVE, "cannot be used", scenario=_on_a_port_in_use),
    Case("port 70000", f"{SERVE} --port 70000", "70000"),
    Case("port -1", f"{SERVE} --port=-1", "-1"),
    Case("much memory", f"{SERVE} --page-memory much", "much"),
    Case("no capture", f"{SERVE} --capture nowhere", "nowhere"),
    Case(
        "a damaged store",
        "view bad.zarr --no-browser",
        "bad.zarr",
        both(copy("scene.zarr", "bad.zarr"), flip("bad.zarr/data/c/0", 0.5)),
    ),
    Case(
        "a page",
        "view scene.zarr --export p.html",
        code=0,
        makes=("p.html",),
        check=holds("p.html"),
    ),
    Case("a page called txt", "view scene.zarr --export p.txt", ".html"),
    Case("a page of no store", "view nowhere.zarr --export p.html", "nowhere.zarr"),
    Case(
        "somebody else's page",
        "view scene.zarr --export p.html --overwrite",
        "p.html",
        text("p.html"),
    ),
    Case("a page on a port", "view scene.zarr --export p.html --port 8000", "--port"),
    Case("a page of a capture", "view scene.zarr --export p.html --capture capture", "--capture"),
]
