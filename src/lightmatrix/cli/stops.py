"""Ctrl-C: one line of ours, and nothing from destructors that it has met half-way."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def quiet_stops() -> Iterator[None]:
    """Say nothing of exceptions that Python ignores, once Ctrl-C was pressed.

    A stop in the midst of a library's constructor lets its destructor fail, which would be told
    with a traceback. Interrupts that are ignored, as in the background of a shell, stay so.
    """
    hook, handler = sys.unraisablehook, signal.getsignal(signal.SIGINT)
    stopped = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        signal.default_int_handler(number, frame)

    def tell(unraisable: sys.UnraisableHookArgs) -> None:
        if not stopped:
            hook(unraisable)

    main = threading.current_thread() is threading.main_thread()
    ours = main and handler is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = tell
    try:
        yield
    finally:
        # What was stopped ends now; its objects may outlive this block.
        if not stopped:
            sys.unraisablehook = hook
        if ours:
            signal.signal(signal.SIGINT, handler)
