"""Ctrl-C: never lost, one line of ours, nothing from destructors that it has met half-way."""

from __future__ import annotations

import _thread
import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds until a stop is looked after, and how often a module that is being loaded may put it off.
_AGAIN, _PATIENCE = 0.05, 100


@contextmanager
def quiet_stops() -> Iterator[None]:
    """Let Ctrl-C stop what is inside for certain, without a word on exceptions Python ignores.

    One stop in a hundred was lost: in callbacks of the import system, and in libraries that catch
    all that goes wrong. So while a module is being loaded a stop waits until that is done, and one
    that nobody handles a moment later is repeated. A stop in the midst of a library's constructor
    lets its destructor fail, which would be told with a traceback; and one in the midst of what an
    event loop was asked lets that log that its task was left. Interrupts that are ignored, as in
    the background of a shell, stay so.
    """
    main = threading.current_thread() is threading.main_thread()
    ours = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    stops, hook = _Stops(), sys.unraisablehook

    def tell(unraisable: sys.UnraisableHookArgs) -> None:
        if not stops.met:
            hook(unraisable)

    if ours:
        signal.signal(signal.SIGINT, stops.stop)
    sys.unraisablehook = tell
    try:
        yield
    finally:
        stops.end()
        # What was stopped ends now; its objects and its libraries' loops may outlive this block.
        if not stops.met:
            sys.unraisablehook = hook
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def is_stop(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind it: libraries that are being loaded may turn it into their own."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


class _Stops:
    """Interrupts of the main thread, each looked after until somebody handles it."""

    def __init__(self) -> None:
        self.met = 0
        self._repeated = False
        self._timer: threading.Timer | None = None

    def stop(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal (in the main thread, as Python handles all)."""
        repeated, self._repeated = self._repeated, False
        if repeated and is_stop(sys.exc_info()[1]):
            return  # What tidies up after the first is at work.
        self.met += 1
        logging.disable()
        self._timer = threading.Timer(_AGAIN, self._repeat)
        self._timer.daemon = True
        self._timer.start()
        if self.met > _PATIENCE or not _is_loading(frame):
            signal.default_int_handler(number, frame)

    def end(self) -> None:
        """Look after none any more."""
        if self._timer is not None:
            self._timer.cancel()

    def _repeat(self) -> None:
        self._repeated = True
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, signal.SIGINT)  # Wakes it from waiting too.
        else:
            _thread.interrupt_main()


def _is_loading(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
