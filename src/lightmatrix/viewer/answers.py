"""What the server answers, as an ASGI application: the page, the matrix, its layers, notices."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Awaitable, Callable
from typing import Any

from lightmatrix.errors import LightMatrixError
from lightmatrix.viewer.guard import Guard
from lightmatrix.viewer.messages import MessageError
from lightmatrix.viewer.page_files import STYLE, frame, module_names, page_file
from lightmatrix.viewer.scene import Scene
from lightmatrix.viewer.session import REST_MILLISECONDS

Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]

# Windows that may be open at once. More are turned away, so that a broken page cannot use up
# sockets.
MOST_SOCKETS = 16
# Seconds between two looks at the store.
_WATCH_SECONDS = 1.0
# WebSocket's codes for "you broke the rules" and "come again later".
_VIOLATION, _TRY_LATER = 1008, 1013
_BINARY, _TEXT = "application/octet-stream", "text/plain; charset=utf-8"


class Answers:
    """The ASGI application of one scene."""

    def __init__(self, scene: Scene, guard: Guard) -> None:
        self._scene, self._guard = scene, guard
        self._sockets = 0

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
            files[path] = (_BINARY, lambda: scene.layer(name))
        if re.fullmatch(r"frame/[0-9]{1,9}\.bin", path) and (frames := scene.frames) is not None:
            number = int(path.removeprefix("frame/").removesuffix(".bin"))
            files[path] = (_BINARY, lambda: frames.levels(number))
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
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": content})

    async def _socket(self, path: str | None, receive: Receive, send: Send) -> None:
        await receive()
        if path != "socket" or self._sockets >= MOST_SOCKETS:
            code = _VIOLATION if path != "socket" else _TRY_LATER
            await send({"type": "websocket.close", "code": code})
            return
        self._sockets += 1
        watching = None
        try:
            await send({"type": "websocket.accept"})
            watching = asyncio.create_task(self._watch(send))
            await self._converse(receive, send)
        except OSError:
            # The window was closed while it was being answered.
            return
        finally:
            self._sockets -= 1
            if watching is not None:
                watching.cancel()

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

    async def _watch(self, send: Send) -> None:
        """Tell the page what becomes of the store."""
        told = ""
        while True:
            notice = await asyncio.to_thread(self._scene.notice)
            if notice != told:
                await send({"type": "websocket.send", "text": json.dumps({"notice": notice})})
                told = notice
            await asyncio.sleep(_WATCH_SECONDS)
