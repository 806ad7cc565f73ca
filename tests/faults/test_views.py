"""The viewer: what it refuses before it serves a page, and pages that are written."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from .case import Case, bear
from .checks import holds
from .put import both, copy, flip, text
from .run import Ran, run

NEEDS = ("scene.zarr",)
SERVE = "view scene.zarr --no-browser"
PAGE = "view scene.zarr --export"


def _on_a_port_in_use(folder: Path) -> Ran:
    with socket.create_server(("127.0.0.1", 0)) as used:
        return run(f"{SERVE} --port {used.getsockname()[1]}", folder)


DAMAGED = both(copy("scene.zarr", "bad.zarr"), flip("bad.zarr/data/c/0", 0.5))
CASES = [
    Case("no store", "view nowhere.zarr --no-browser", "nowhere.zarr"),
    Case("a port in use", SERVE, "cannot be used", scenario=_on_a_port_in_use),
    Case("port 70000", f"{SERVE} --port 70000", "70000"),
    Case("port -1", f"{SERVE} --port=-1", "-1"),
    Case("no capture", f"{SERVE} --capture nowhere", "nowhere"),
    Case("a damaged store", "view bad.zarr --no-browser", "bad.zarr", DAMAGED),
    Case("a page", f"{PAGE} p.html", code=0, makes=("p.html",), check=holds("p.html")),
    Case("a page called txt", f"{PAGE} p.txt", ".html"),
    Case("a page of no store", "view nowhere.zarr --export p.html", "nowhere.zarr"),
    Case("somebody else's page", f"{PAGE} p.html --overwrite", "p.html", text("p.html")),
    Case("a page on a port", f"{PAGE} p.html --port 8000", "--port"),
    Case("a page of no capture", f"{PAGE} p.html --capture nowhere", "nowhere"),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_viewer(case: Case, work: Path) -> None:
    bear(case, work)
