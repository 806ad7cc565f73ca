"""`lm.view`: the viewer as a widget in notebooks."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, LightMatrixError
from lightmatrix.files.extras import load_extra
from lightmatrix.ranges import check_finite
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.export import STYLE, bundle, page_file
from lightmatrix.viewer.scene import ViewedScene
from lightmatrix.viewer.session import REST_MILLISECONDS, MessageError, Session

# The largest matrix that a notebook sends to its page, where it may be kept with the notebook.
_PAGE_BYTES = 32 << 20
# Sends a message of JSON, and bytes behind it.
Send = Callable[[dict[str, Any], Sequence[bytes]], None]


def view(transport: LightTransport | str | Path, *, page_bytes: int = _PAGE_BYTES) -> Any:
    """Show a light transport matrix in a notebook: Jupyter, JupyterLab, VS Code or marimo.

    Parameters
    ----------
    transport : LightTransport, str or Path
        T, or where `open` finds it.
    page_bytes : int
        The largest matrix that is sent to the page, which then relights it; the kernel relights a
        larger one. A store of this size without an index of its columns gets one.

    Returns
    -------
    anywidget.AnyWidget
        Its ``pattern`` is what the projector shows, (rows, cols) in [0, 1], black before the widget
        is shown; assign to it to project something else. Its ``photograph`` is the camera image
        under it.

    Raises
    ------
    InputError
        If there is no such matrix, or a browser cannot show it.
    MissingExtraError
        If the extra ``notebook`` is not installed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> widget = lm.view(lm.truth("metal").transport())
    >>> widget.pattern = np.eye(64)
    >>> float(widget.pattern.sum()), widget.photograph.shape
    (64.0, (64, 64))
    """
    widget_class = _widget_class()
    return widget_class(ViewedScene(transport, page_bytes=page_bytes))


class Views:
    """The views of one widget, each in a page."""

    def __init__(self, scene: ViewedScene, send: Send) -> None:
        self._scene, self._send = scene, send
        self._sessions: dict[str, Session] = {}

    def receive(self, content: Any, buffers: Sequence[Any]) -> None:
        """Answer a message of a view; what no view sends is ignored."""
        if not isinstance(content, dict) or not isinstance(view := content.get("view"), str):
            return
        what = content.get("what")
        if what == "layer":
            answer = {"view": view, "what": "layer", "name": content.get("name")}
            try:
                self._send(answer, [self._scene.layers.get(answer["name"])])
            except LightMatrixError as error:
                self._send({**answer, "error": error.message}, [])
        elif what == "message" and len(buffers) == 1:
            session = self._session(view)
            try:
                parts = session.answer(bytes(buffers[0]))
            except MessageError:
                return
            for part in parts:
                self._part(view, session, part, more=session.unfinished and part is parts[-1])
        elif what == "finish":
            # One more part of the photograph. The view asks for the next.
            session, part = self._session(view), None
            while part is None and session.unfinished:
                part = session.finish()
            if part is not None:
                self._part(view, session, part, more=session.unfinished)

    def _part(self, view: str, session: Session, part: bytes, *, more: bool) -> None:
        """Send a part of an answer, and when the view may ask for the next, in milliseconds."""
        wait = REST_MILLISECONDS if session.patient else 0
        self._send({"view": view, "what": "part", "more": more, "wait": wait}, [part])

    def _session(self, view: str) -> Session:
        if view not in self._sessions:
            # The photographs of eight views are kept; more of them forget the oldest.
            if len(self._sessions) >= 8:
                del self._sessions[next(iter(self._sessions))]
            self._sessions[view] = self._scene.session()
        return self._sessions[view]


@cache
def _widget_class() -> Any:
    """The class of the widgets. It is made here because its base belongs to an extra."""
    load_extra("anywidget", "the viewer in a notebook needs anywidget", "notebook")
    import anywidget
    import traitlets

    class ViewerWidget(anywidget.AnyWidget):
        """The viewer of one matrix; made by `lm.view`."""

        _esm = bundle("widget.js")
        _css = page_file(STYLE)
        # What the page is sent, and the pattern as it has it, a byte a pixel.
        description = traitlets.Bytes().tag(sync=True)
        matrix = traitlets.Bytes().tag(sync=True)
        levels = traitlets.Bytes().tag(sync=True)

        def __init__(self, scene: ViewedScene) -> None:
            matrix = b"" if scene.light is not None else scene.matrix_bytes
            super().__init__(description=scene.description, matrix=matrix)
            self._transport = scene.matrix
            self.views = Views(scene, self.send)
            self.on_msg(lambda _, content, buffers: self.views.receive(content, buffers))

        def __repr__(self) -> str:
            rows, cols = self._transport.projector_shape
            down, right = self._transport.camera_shape[:2]
            return f"<viewer: projector {rows} x {cols}, camera {down} x {right}>"

        @property
        def pattern(self) -> NDArray[np.float64]:
            shape = self._transport.projector_shape
            if not self.levels:
                return np.zeros(shape)
            return np.frombuffer(self.levels, np.uint8).reshape(shape) / 255

        @pattern.setter
        def pattern(self, values: NDArray[Any]) -> None:
            pattern, shape = np.asarray(values, np.float64), self._transport.projector_shape
            if pattern.shape != shape:
                hint = f"its shape must be {shape}"
                raise InputError(f"a pattern of shape {pattern.shape}", hint=hint)
            check_finite("values of a pattern", pattern)
            if not (pattern.min() >= 0 and pattern.max() <= 1):
                hint = "divide it by its maximum"
                raise InputError("a pattern with values outside [0, 1]", hint=hint)
            self.levels = np.rint(255 * pattern).astype(np.uint8).tobytes()

        @property
        def photograph(self) -> NDArray[np.float32]:
            return self._transport.relight(self.pattern)

    return ViewerWidget
