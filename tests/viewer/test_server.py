"""The server: who may connect, what hostile clients can do, and how it ends."""

from __future__ import annotations

import http.client
import http.server
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

import lightmatrix as lm
from lightmatrix.cli import main
from lightmatrix.viewer import export as export_module
from tests.viewer import hostile, running
from tests.viewer.running import shown

pytest.importorskip("uvicorn")
websockets = pytest.importorskip("websockets.sync.client")
# Mutated requests that are tried, and bytes by which memory may grow meanwhile: far less than one
# kept request each.
MUTATIONS, GROWTH = 300, 20 << 20


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("server") / "scene.zarr"
    lm.save(store, running.scene())
    return store


@pytest.fixture(scope="module")
def server(store: Path) -> Iterator[running.Server]:
    with running.served(store) as server:
        yield server


def ask(
    server: running.Server, path: str, method: str = "GET", **headers: str
) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=120)
    connection.putrequest(method, path, skip_host=True)
    for name, value in {"Host": server.host, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer


def test_only_the_loopback_listens(server: running.Server) -> None:
    assert server.address.startswith("http://127.0.0.1:")
    own = socket.gethostbyname(socket.gethostname())
    if not own.startswith("127."):
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((own, server.port), timeout=5)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/{token}/", {}, 200),
        ("/{token}/matrix.bin", {}, 200),
        ("/{token}/layer/clipping.bin", {"Origin": "http://{host}"}, 200),
        ("/", {}, 403),
        ("/wrong/", {}, 403),
        ("/{token}x/", {}, 403),
        ("/%FF%FE/", {}, 403),
        ("/{token}/", {"Host": "rebound.example:80"}, 403),
        ("/{token}/", {"Host": "127.0.0.1"}, 403),
        ("/{token}/matrix.bin", {"Origin": "http://elsewhere.example"}, 403),
        ("/{token}/matrix.bin", {"Origin": "null"}, 403),
        ("/{token}/../../etc/passwd", {}, 404),
        ("/{token}/layer/gap.bin", {}, 404),
        ("/{token}/layer/../scene.bin", {}, 404),
        ("/{token}/viewer.html", {}, 404),
    ],
)
def test_who_is_answered(
    path: str, headers: dict[str, str], status: int, server: running.Server
) -> None:
    words = {"token": server.token, "host": server.host}
    filled = {name: value.format(**words) for name, value in headers.items()}
    answer = ask(server, path.format(**words), **filled)
    assert answer.status == status
    policy = answer.getheader("Content-Security-Policy")
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert answer.getheader("Referrer-Policy") == "no-referrer"
    assert answer.getheader("Cross-Origin-Resource-Policy") == "same-origin"
    assert answer.getheader("Access-Control-Allow-Origin") is None


def test_nothing_is_written(server: running.Server) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert ask(server, f"/{server.token}/", method).status == 405
    assert ask(server, f"/{server.token}/", "HEAD").status == 200


def connect(server: running.Server, path: str = "", **options: object) -> object:
    address = f"ws://{server.host}/{path or server.token + '/socket'}"
    options = {"origin": f"http://{server.host}", "open_timeout": 120, **options}
    return websockets.connect(address, proxy=None, **options)


@pytest.mark.parametrize("origin", [None, "http://elsewhere.example", "null", "https://{host}"])
def test_sockets_of_other_origins_are_refused(origin: str | None, server: running.Server) -> None:
    from websockets.exceptions import InvalidStatus

    named = None if origin is None else origin.format(host=server.host)
    with pytest.raises(InvalidStatus):
        connect(server, origin=named)
    with pytest.raises(InvalidStatus):
        connect(server, "wrong/socket")


def test_a_socket_that_talks_is_closed(server: running.Server) -> None:
    from websockets.exceptions import ConnectionClosed

    for message in ("hello", b"\0" * 100, "x" * 200_000):
        with connect(server) as connection:  # type: ignore[attr-defined]
            connection.send(message)
            with pytest.raises(ConnectionClosed):
                connection.recv(timeout=120)
    # Windows are counted only while they are open.
    for _ in range(20):
        with connect(server):  # type: ignore[attr-defined]
            pass
    assert ask(server, f"/{server.token}/").status == 200


def test_hostile_requests_change_nothing(server: running.Server) -> None:
    """Mutated requests and frames: no crash, no growth of memory, no answer without the token."""
    import psutil

    whole = [
        f"GET /{server.token}/matrix.bin HTTP/1.1\r\nHost: {server.host}\r\n\r\n",
        f"GET /{server.token}/socket HTTP/1.1\r\nHost: {server.host}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nOrigin: http://{server.host}\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n\x81\x85aaaahello\x88\x80aaaa",
    ]
    generator = random.Random(0)
    process = psutil.Process(server.process.pid)
    before = 0
    for number in range(MUTATIONS):
        if number == MUTATIONS // 10:
            before = process.memory_info().rss
        message = bytearray(generator.choice(whole).encode("latin-1"))
        for _ in range(generator.randint(1, 8)):
            place = generator.randrange(len(message))
            message[place : place + generator.randint(0, 4)] = generator.randbytes(
                generator.randint(0, 6)
            )
        with socket.create_connection(("127.0.0.1", server.port), timeout=120) as connection:
            connection.sendall(message)
            if number % 2:
                connection.shutdown(socket.SHUT_WR)
    assert ask(server, f"/{server.token}/").status == 200
    assert server.process.poll() is None
    assert process.memory_info().rss - before < GROWTH


def test_hostile_messages_change_nothing(tmp_path: Path) -> None:
    # The server adds an index of columns to this store, which others would notice.
    store = tmp_path / "scene.zarr"
    lm.save(store, running.scene())
    with running.served(store, program=running.ON_DISK) as server:
        # `python -m tests.viewer.hostile` sends 10,000.
        answered, refused, growth = hostile.attack(server, MUTATIONS // 5)
        assert min(answered, refused) > MUTATIONS / 100
        assert growth < GROWTH
        assert ask(server, f"/{server.token}/").status == 200
        # Python itself ends by the signal, as nothing of this program catches it.
        assert server.stop() == -signal.SIGINT


def test_a_page_of_another_site_cannot_connect(
    server: running.Server, browser: Browser, tmp_path: Path
) -> None:
    """Even one that knows the token: neither by requests, nor by sockets, nor in a frame."""
    (tmp_path / "index.html").write_text("<!doctype html><title>Another site</title>")

    class _Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments, directory=str(tmp_path))  # type: ignore[arg-type]

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Quiet) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{other.server_port}/index.html")
        script = """async (address) => {
          const fetched = await fetch(address + "matrix.bin").then((a) => a.status, () => "no");
          const socket = new WebSocket(address.replace("http", "ws") + "socket");
          const opened = await new Promise((done) => {
            socket.onopen = () => done("open"); socket.onerror = () => done("no"); });
          const image = new Image(), script = document.createElement("script");
          script.src = address + "page.js";
          const loaded = await new Promise((done) => {
            script.onload = () => done("loaded"); script.onerror = () => done("no");
            document.head.append(script); });
          return [fetched, opened, loaded];
        }"""
        assert page.evaluate(script, server.address) == ["no", "no", "no"]
        # Its own page can, as long as the address is the one that was given.
        with shown(browser, server.address) as own:
            own.wait_for_timeout(500)
            assert own.locator(".notice").is_hidden()
        page.close()
        other.shutdown()


def test_the_end_is_told_and_frees_the_port(store: Path, browser: Browser) -> None:
    with running.served(store) as server, shown(browser, server.address) as page:
        assert server.stop() == 130
        page.get_by_text("The server has ended").wait_for()
        # What the page has still works.
        running.stroke(page, (1, 1), (3, 9))
    with running.served(store, "--port", str(server.port)) as again:
        assert again.port == server.port
        assert again.token != server.token


@pytest.mark.skipif(os.name == "nt", reason="the browser of this test is a shell script")
def test_a_browser_that_does_not_return_is_served(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one in the terminal, which runs until it is closed."""
    monkeypatch.setenv("HOME", str(tmp_path))
    browser = tmp_path / "browser"
    # Its outputs are closed, as the command's pipes would stay open as long as it runs.
    ending = "exec sleep 300 >/dev/null 2>&1"
    # What it was given, whether others may look into that folder, and the page.
    looking = 'page="${1#file://}"; echo "$1"; ls -ld "$(dirname "$page")"; cat "$page"'
    given = tmp_path / "given"
    browser.write_text(
        f"#!/bin/sh\n({looking}) > {given}.part\nmv {given}.part {given}\n{ending}\n"
    )
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with running.served(store, "--browser") as server:
        assert ask(server, f"/{server.token}/").status == 200
        end = time.monotonic() + 120
        while not given.exists() and time.monotonic() < end:
            time.sleep(0.1)
        argument, folder, page = given.read_text().split("\n", 2)
        # Everyone can read the arguments of a process.
        assert argument.startswith(tmp_path.as_uri())
        assert server.token not in argument
        assert folder.startswith("drwx------")
        assert f"url={server.address}" in page
        assert server.stop() == 130
    assert not list(tmp_path.glob("lightmatrix-viewer-*"))


def test_matrices_that_are_too_large_for_one_file_are_refused(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export_module, "_MOST_BYTES", 1 << 10)
    with pytest.raises(lm.InputError, match="MiB in a page"):
        lm.export_viewer(tmp_path / "page.html", store)
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_page_of_the_function(store: Path, tmp_path: Path) -> None:
    assert main(["view", str(store), "--export", str(tmp_path / "one.html")]) == 0
    lm.export_viewer(tmp_path / "two.html", store)
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()
