"""A full-screen window on a monitor or projector, exact to the bit.

Each screen pixel is one texel fetch at the monitor's own resolution: no scaling, no filter, no
colour management, no dither. The graphics card's gamma ramp acts behind that.
"""

import os
import re
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices import base

_VERTEX = """
#version 330
void main() {
    // One triangle that covers the screen.
    gl_Position = vec4(4.0 * (gl_VertexID & 1) - 1.0, 4.0 * (gl_VertexID >> 1) - 1.0, 0.0, 1.0);
}
"""
_FRAGMENT = """
#version 330
uniform sampler2D image;
out vec4 light;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    // Images begin with their top row, the screen of OpenGL with its bottom one.
    light = texelFetch(image, ivec2(at.x, textureSize(image, 0).y - 1 - at.y), 0);
}
"""
# Number of open windows: GLFW ends with the last one.
_windows = 0


class WindowProjector(base.Projector):
    """A full-screen window, used only by the thread that made it (on macOS the main thread)."""

    def __init__(self, glfw: Any, moderngl: Any, monitor: Any, number: int, gamma: str) -> None:
        self._glfw = glfw
        self._number = number
        self._key = False
        name = _name(glfw, monitor)
        mode = glfw.get_video_mode(monitor)
        self._window: Any = _full_screen(glfw, monitor, mode)
        glfw.make_context_current(self._window)
        # A swap waits for the monitor's refresh, so that no image is torn.
        glfw.swap_interval(1)
        glfw.set_input_mode(self._window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
        glfw.set_key_callback(self._window, self._pressed)
        self._context = moderngl.create_context()
        # This is GL_DITHER, which ModernGL has no name for.
        self._context.disable_direct(0x0BD0)
        width, height = glfw.get_framebuffer_size(self._window)
        self._shape = (height, width)
        self._context.viewport = (0, 0, width, height)
        self._program = self._context.program(_VERTEX, _FRAGMENT)
        self._triangle = self._context.vertex_array(self._program, [])
        # An alignment of 1 means that there is no gap between rows.
        self._texture = self._context.texture(self._shape[::-1], 3, alignment=1)
        self._texture.filter = (self._context.NEAREST, self._context.NEAREST)
        if gamma == "linear":
            # GLFW restores the ramp when it ends.
            glfw.set_gamma(monitor, 1.0)
        largest = max(mode.size for mode in glfw.get_video_modes(monitor))
        self._info = {
            "name": name,
            "kind": "window",
            "monitor": number,
            "shape": self._shape,
            # The monitor scales the image if its current mode is a smaller one.
            "largest_mode": (largest.height, largest.width),
            "refresh": float(mode.refresh_rate) or None,
            "renderer": self._context.info["GL_RENDERER"],
        }
        self.black()

    def info(self) -> dict[str, Any]:
        """JSON-ready facts."""
        return dict(self._info)

    def show(self, image: NDArray[np.uint8]) -> float:
        """Show an image; return when the swap was done."""
        if self._window is None:
            raise DeviceError("the projector window is closed", hint="open it again")
        base.check_image(image, self._shape)
        colours = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        self._texture.write(np.ascontiguousarray(colours).data)
        self._texture.use()
        self._triangle.render(vertices=3)
        self._glfw.swap_buffers(self._window)
        # Wait until the graphics card has done it, not only received it.
        self._context.finish()
        shown = time.monotonic()
        self._glfw.poll_events()
        if self._glfw.window_should_close(self._window):
            hint = "run the same command again to go on"
            raise DeviceError("the projector window was closed", hint=hint)
        if not self._glfw.get_window_monitor(self._window):
            hint = "plug it in again, then run the same command again to go on"
            raise DeviceError(f"monitor {self._number} ({self._info['name']}) is gone", hint=hint)
        return shown

    def asked_to_end(self) -> bool:
        """Whether a key was pressed in the window since it was opened."""
        return self._key

    def close(self) -> None:
        """Close the window; the screen is as it was before."""
        global _windows
        if self._window is None:
            return
        self._context.release()
        self._glfw.destroy_window(self._window)
        self._window = None
        _windows -= 1
        if not _windows:
            self._glfw.terminate()

    def _pressed(self, window: Any, key: int, *_: int) -> None:
        self._key = True
        # On a single monitor the window covers the terminal, so the Escape key closes it.
        if key == self._glfw.KEY_ESCAPE:
            self._glfw.set_window_should_close(window, True)


def open_window(address: base.Address) -> WindowProjector:
    """Open a window on the monitor of a number or name, or on the second one if there is one.

    The option gamma=linear loads a linear gamma ramp as long as the window is open; gamma=keep, the
    default, leaves the ramp.
    """
    global _windows
    address.check_options(("gamma",))
    gamma = address.choice("gamma", ("keep", "linear"))
    glfw, moderngl = _load()
    _start(glfw)
    _windows += 1
    try:
        monitors = glfw.get_monitors()
        number = _chosen(address, [_name(glfw, monitor) for monitor in monitors])
        return WindowProjector(glfw, moderngl, monitors[number], number, gamma)
    except BaseException as error:
        _windows -= 1
        if not _windows:
            glfw.terminate()
        if isinstance(error, InputError | DeviceError | KeyboardInterrupt):
            raise
        raise DeviceError(
            f"{address}: no full-screen window could be opened ({_text(error)})",
            hint="OpenGL 3.3 is needed: install the graphics driver, or Mesa (libgl1-mesa-dri)",
        ) from error


def find_windows() -> list[base.AvailableDevice]:
    """The monitors of this computer."""
    glfw, _ = _load()
    _start(glfw)
    devices = []
    for number, monitor in enumerate(glfw.get_monitors()):
        size, _, refresh = glfw.get_video_mode(monitor)
        words = f"{_name(glfw, monitor)}, {base.size_in_words((size.height, size.width))}"
        if refresh:
            words += f" at {refresh} Hz"
        if not number:
            words += ", the first monitor"
        devices.append(base.AvailableDevice(f"window:{number}", words))
    if not _windows:
        glfw.terminate()
    return devices


def _load() -> tuple[Any, Any]:
    glfw, moderngl = base.load("window", "a projector window", "glfw", "moderngl")
    # Otherwise GLFW only prints its errors.
    glfw.ERROR_REPORTING = "raise"
    return glfw, moderngl


def _start(glfw: Any) -> None:
    reason = "it does not say why"
    try:
        if glfw.init():
            return
    except glfw.GLFWError as error:
        reason = _text(error)
    if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
        reason += "; neither DISPLAY nor WAYLAND_DISPLAY is set"
    hint = "run it in a desktop session; over ssh, set DISPLAY=:0 first"
    raise DeviceError(f"no display to open a projector window on ({reason})", hint=hint)


def _chosen(address: base.Address, names: list[str]) -> int:
    listed = ", ".join(f"{number} ({name})" for number, name in enumerate(names)) or "none"
    wanted = address.argument
    if not names:
        number = -1
    elif not wanted:
        return min(1, len(names) - 1)
    elif wanted.isdecimal():
        number = int(wanted)
    else:
        number = names.index(wanted) if wanted in names else -1
    if not 0 <= number < len(names):
        raise DeviceError(
            f"{address}: there is no such monitor; there are: {listed}",
            hint="switch the projector on, extend the desktop to it (do not mirror), and see "
            "`lightmatrix rig list`",
        )
    return number


def _full_screen(glfw: Any, monitor: Any, mode: Any) -> Any:
    glfw.default_window_hints()
    for hint, value in (
        (glfw.CONTEXT_VERSION_MAJOR, 3),
        (glfw.CONTEXT_VERSION_MINOR, 3),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE),
        (glfw.OPENGL_FORWARD_COMPAT, True),
        (glfw.RED_BITS, mode.bits.red),
        (glfw.GREEN_BITS, mode.bits.green),
        (glfw.BLUE_BITS, mode.bits.blue),
        # Keep the monitor's mode.
        (glfw.REFRESH_RATE, mode.refresh_rate or glfw.DONT_CARE),
        (glfw.SRGB_CAPABLE, False),
        (glfw.SAMPLES, 0),
        # Keep the window open when somebody clicks on another monitor.
        (glfw.AUTO_ICONIFY, False),
    ):
        glfw.window_hint(hint, value)
    return glfw.create_window(
        mode.size.width, mode.size.height, "lightmatrix projector", monitor, None
    )


def _name(glfw: Any, monitor: Any) -> str:
    name = glfw.get_monitor_name(monitor)
    return name.decode(errors="replace") if isinstance(name, bytes) else str(name)


def _text(error: BaseException) -> str:
    """GLFW's message without its number and the quotes of bytes."""
    return re.sub(r"^\([0-9]+\) b?['\"]?(.*?) ?['\"]?$", r"\1", " ".join(str(error).split()))
