"""`lm.serve_viewer`: the viewer in the browser, served by this process until Ctrl-C."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError, MissingExtraError, OutputError
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.answers import MOST_SOCKETS, Answers
from lightmatrix.viewer.guard import LOOPBACK, Guard
from lightmatrix.viewer.lights import Progress
from lightmatrix.viewer.scene import PAGE_BYTES, Scene

# Requests at once: those of all windows while they load, and as many again.
_MOST_REQUESTS = 8 * MOST_SOCKETS
# Seconds that open pages have to say goodbye after Ctrl-C.
_GOODBYE_SECONDS = 1
_HIGHEST_PORT = 65535


def serve_viewer(
    transport: LightTransport | str | Path,
    *,
    port: int = 0,
    browser: bool = True,
    ready: Callable[[str], None] | None = None,
    page_bytes: int = PAGE_BYTES,
    progress: Progress | None = None,
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
        The geometry of the rig, from `calibrate`. The page then has a layer of depth.

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
    uvicorn = _library()
    if not 0 <= port <= _HIGHEST_PORT:
        raise InputError(f"port {port}", hint=f"use 0 (any free one) to {_HIGHEST_PORT}")
    scene = Scene(
        transport, page_bytes=page_bytes, progress=progress, capture=capture, geometry=geometry
    )
    with _bound(port) as listening:
        guard = Guard(listening.getsockname()[1])
        # The socket listens already, so that whoever opens the page now is answered.
        if ready is not None:
            ready(guard.address)
        if browser:
            # A browser in the terminal would not return before it is closed.
            threading.Thread(target=webbrowser.open, args=(guard.address,), daemon=True).start()
        uvicorn.Server(_config(uvicorn, Answers(scene, guard), scene.most_message)).run(
            sockets=[listening]
        )


def _config(uvicorn: Any, answers: Answers, most_message: int) -> Any:
    return uvicorn.Config(
        answers,
        lifespan="off",
        log_level="critical",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws="websockets-sansio",
        ws_max_size=most_message,
        ws_per_message_deflate=False,
        limit_concurrency=_MOST_REQUESTS,
        timeout_graceful_shutdown=_GOODBYE_SECONDS,
    )


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
        raise OutputError(
            f"port {port} cannot be used ({error.strerror})",
            hint="choose another --port, or leave it out for one that is free",
        ) from error
    return listening


def _library() -> Any:
    try:
        import uvicorn
        import websockets  # noqa: F401 - uvicorn needs it for the page's connection
    except ImportError as error:
        raise MissingExtraError(
            "the viewer needs a web server",
            hint='install the extra: pip install "lightmatrix[viewer]"',
        ) from error
    return uvicorn
