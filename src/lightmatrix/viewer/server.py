"""`lm.serve_viewer`: the viewer in the browser, served by this process until Ctrl-C."""

import asyncio
import html
import os
import re
import secrets
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import PAGE_BYTES
from lightmatrix.errors import InputError, LightMatrixError, OutputError
from lightmatrix.files.extras import load_extra
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.export import STYLE, frame, module_names, page_file
from lightmatrix.viewer.lights import StageProgress
from lightmatrix.viewer.scene import ViewedScene
from lightmatrix.viewer.session import REST_MILLISECONDS, MessageError

# Who may connect: this machine only, by the address that was handed out, and from its own page.
#
# A page of another site could otherwise reach a server on the loopback: by a name that it makes
# point there (DNS rebinding), or by a WebSocket, which browsers let any page open.

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Guard:
    """The token and the hosts of one server."""

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    @property
    def hosts(self) -> set[str]:
        """What a browser may call this server."""
        return {f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"}

    def inner_path(self, scope: dict[str, Any]) -> str | None:
        """The path within the page that a request asks for; None if it is refused."""
        hosts, origins = _header(scope, b"host"), _header(scope, b"origin")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return None
        # A browser names the page that opens a WebSocket, and so must others.
        if len(origins) > 1 or (scope["type"] == "websocket" and not origins):
            return None
        if origins and origins[0] != f"http://{hosts[0]}":
            return None
        token, _, path = scope["path"].removeprefix("/").partition("/")
        known = secrets.compare_digest(token.encode(), self.token.encode())
        return path if known else None

    def headers(self) -> list[tuple[bytes, bytes]]:
        """Headers of every answer: the page loads nothing from elsewhere and tells nobody of it."""
        sockets = " ".join(f"ws://{host}" for host in sorted(self.hosts))
        policy = (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        )
        return [
            (b"content-security-policy", policy.encode()),
            (b"referrer-policy", b"no-referrer"),
            (b"x-content-type-options", b"nosniff"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cache-control", b"no-store"),
        ]


@contextmanager
def _handed_to_the_browser(address: str) -> Iterator[None]:
    """Open an address in the browser, by a file that only this user can read.

    Every user of this machine can read the arguments of a process, and the address holds the token.
    """
    # Browsers in a sandbox, such as Ubuntu's Firefox, read no hidden folder and no temporary one.
    home = os.path.expanduser("~")
    place = home if os.access(home, os.W_OK) else None
    with tempfile.TemporaryDirectory(
        prefix="lightmatrix-viewer-", dir=place, ignore_cleanup_errors=True
    ) as folder:
        page = Path(folder) / "open.html"
        target = html.escape(address)
        page.write_text(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={target}">'
            f'<a href="{target}">Open the viewer</a>\n'
        )
        # A browser in the terminal would not return before it is closed.
        threading.Thread(target=webbrowser.open, args=(page.as_uri(),), daemon=True).start()
        yield


def _header(scope: dict[str, Any], name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


# What the server answers, as an ASGI application: the page, the matrix, its layers.

Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]

# WebSocket's code for "you broke the rules".
_VIOLATION = 1008
_BINARY, _TEXT = "application/octet-stream", "text/plain; charset=utf-8"


class Answers:
    """The ASGI application of one scene."""

    def __init__(self, scene: ViewedScene, guard: Guard) -> None:
        self._scene, self._guard = scene, guard

    async def __call__(self, scope: dict[str, Any], receive: Receive, send: Send) -> None:
        path = self._guard.inner_path(scope)
        if scope["type"] == "websocket":
            await self._socket(path, receive, send)
        elif path is None:
            await self._answer(send, 403, _TEXT, b"This address is not the one that was given.")
        elif scope["method"] not in ("GET", "HEAD"):
            await self._answer(send, 405, _TEXT, b"Only GET is answered.")
        else:
            await self._page(path, send, body=scope["method"] == "GET")

    async def _page(self, path: str, send: Send, body: bool) -> None:
        scene = self._scene
        files: dict[str, tuple[str, Callable[[], bytes]]] = {
            "": ("text/html; charset=utf-8", lambda: frame(scene.title).encode()),
            STYLE: ("text/css; charset=utf-8", lambda: page_file(STYLE).encode()),
            "scene.bin": (_BINARY, lambda: scene.description),
            "matrix.bin": (_BINARY, lambda: scene.matrix_bytes),
        }
        if path in module_names():
            files[path] = ("text/javascript; charset=utf-8", lambda: page_file(path).encode())
        if path.startswith("layer/") and path.endswith(".bin"):
            name = path.removeprefix("layer/").removesuffix(".bin")
            files[path] = (_BINARY, lambda: scene.layers.get(name))
        if re.fullmatch(r"frame/[0-9]{1,9}\.bin", path):
            number = int(path.removeprefix("frame/").removesuffix(".bin"))
            files[path] = (_BINARY, lambda: scene.pattern(number))
        if path not in files:
            await self._answer(send, 404, _TEXT, b"There is no such file.")
            return
        kind, make = files[path]
        try:
            content = await asyncio.to_thread(make)
        except LightMatrixError as error:
            await self._answer(send, 404, _TEXT, error.message.encode())
            return
        await self._answer(send, 200, kind, content if body else b"")

    async def _answer(self, send: Send, status: int, kind: str, content: bytes) -> None:
        headers = [(b"content-type", kind.encode()), *self._guard.headers()]
        headers.append((b"content-length", str(len(content)).encode()))
        if status == 403:
            headers.append((b"connection", b"close"))
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": content})

    async def _socket(self, path: str | None, receive: Receive, send: Send) -> None:
        await receive()
        if path != "socket":
            await send({"type": "websocket.close", "code": _VIOLATION})
            return
        # The window may be closed while it is being answered.
        with suppress(OSError):
            await send({"type": "websocket.accept"})
            await self._converse(receive, send)

    async def _converse(self, receive: Receive, send: Send) -> None:
        """Answer the messages of a window, and meanwhile send what it lacks."""
        session = await asyncio.to_thread(self._scene.session)
        coming = asyncio.ensure_future(receive())
        try:
            while True:
                # A message goes first: it may make the rest superfluous.
                await asyncio.sleep(0)
                if session.unfinished and session.patient:
                    await asyncio.wait([coming], timeout=REST_MILLISECONDS / 1000)
                if session.unfinished and not coming.done():
                    part = await asyncio.to_thread(session.finish)
                    if part is not None:
                        await send({"type": "websocket.send", "bytes": part})
                    continue
                event = await coming
                if event["type"] != "websocket.receive":
                    return
                coming = asyncio.ensure_future(receive())
                try:
                    parts = await asyncio.to_thread(session.answer, event.get("bytes"))
                except MessageError:
                    # Whoever sends this is not the page.
                    await send({"type": "websocket.close", "code": _VIOLATION})
                    return
                for part in parts:
                    await send({"type": "websocket.send", "bytes": part})
        finally:
            coming.cancel()


def serve_viewer(
    transport: LightTransport | str | Path,
    *,
    port: int = 0,
    browser: bool = True,
    ready: Callable[[str], None] | None = None,
    page_bytes: int = PAGE_BYTES,
    progress: StageProgress | None = None,
    capture: Capture | str | Path | None = None,
    geometry: RigGeometry | str | Path | None = None,
) -> None:
    """Show a light transport matrix in the browser, and serve the page until Ctrl-C.

    The page is reachable from this machine only, and only by its address, which holds a secret
    token.

    Parameters
    ----------
    transport : LightTransport, str or Path
        T, or where `open` finds it.
    port : int
        Port on this machine; 0 for one that is free.
    browser : bool
        Whether to open the page in the browser.
    ready : callable, optional
        Called with the address of the page when it can be opened.
    page_bytes : int
        The largest matrix that is sent to the page, which then relights it: 4 bytes an entry, or 6.
        This process relights a larger one, and reads it from disk if it is a store. A store without
        an index of its columns gets one, which takes about as much disk space as the store.
    progress : callable, optional
        Called with (done, total, note) while the index is made; the note says how much disk space
        it takes.
    capture : Capture, str or Path, optional
        The capture that T was estimated from. The page then offers its patterns.
    geometry : RigGeometry, str or Path, optional
        The geometry of the rig, from `calibrate`. The page then has layers of depth.

    Raises
    ------
    InputError
        If there is no such matrix, or the port is none.
    OutputError
        If the port is in use, or the index cannot be written.
    MissingExtraError
        If the extra ``viewer`` is not installed.
    KeyboardInterrupt
        On Ctrl-C, when the port is free again.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.serve_viewer("scene.zarr")  # doctest: +SKIP
    """
    # Uvicorn needs websockets for the page's connection.
    _, uvicorn = (
        load_extra(name, "the viewer needs a web server", "viewer")
        for name in ("websockets", "uvicorn")
    )
    if not 0 <= port <= 65535:
        raise InputError(f"port {port}", hint="use 0 (any free one) to 65535")
    scene = ViewedScene(
        transport, page_bytes=page_bytes, progress=progress, capture=capture, geometry=geometry
    )
    with _bound(port) as listening:
        guard = Guard(listening.getsockname()[1])
        # The socket listens already, so that whoever opens the page now is answered.
        if ready is not None:
            ready(guard.address)
        config = uvicorn.Config(
            Answers(scene, guard),
            lifespan="off",
            log_level="critical",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws="websockets-sansio",
            timeout_keep_alive=2,
            ws_max_size=scene.most_message,
            ws_per_message_deflate=False,
            # Seconds that open pages have to say goodbye after Ctrl-C.
            timeout_graceful_shutdown=1,
        )
        with _handed_to_the_browser(guard.address) if browser else nullcontext():
            uvicorn.Server(config).run(sockets=[listening])
    # Only Ctrl-C ends the server. The event loop may have swallowed its KeyboardInterrupt.
    raise KeyboardInterrupt


def _bound(port: int) -> socket.socket:
    """A socket of the loopback that is bound to a port."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # Otherwise a port that was just left stays in use for a minute.
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((LOOPBACK, port))
        listening.listen()
    except OSError as error:
        listening.close()
        hint = "choose another port, or port=0 for one that is free"
        raise OutputError(f"port {port} cannot be used ({error.strerror})", hint=hint) from error
    return listening
