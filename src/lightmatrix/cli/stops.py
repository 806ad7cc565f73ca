"""Ctrl-C: every one takes effect, and nothing but our own line is printed about it."""

from __future__ import annotations

import _thread
import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds after which an interrupt that nobody handled is repeated, and how often that is done while
# a module is being imported: up to 5 s. Both were chosen by hand.
_REPEAT_AFTER, _MOST_REPEATS = 0.05, 100


@contextmanager
def quiet_stops() -> Iterator[None]:
    """Make sure that Ctrl-C stops the code within, and silence what it breaks.

    One interrupt in a hundred was lost in callbacks of the import system and in libraries that
    catch every exception. So an interrupt waits until the current import ends, and one that nobody
    handles is repeated. Failing destructors and event loops then print tracebacks, which are
    silenced. Ignored interrupts, as in background jobs of a shell, stay ignored.
    """
    main = threading.current_thread() is threading.main_thread()
    ours = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    stops, hook = _Stops(), sys.unraisablehook

    def print_before_stop(unraisable: sys.UnraisableHookArgs) -> None:
        if not stops.count:
            hook(unraisable)

    if ours:
        signal.signal(signal.SIGINT, stops.handle)
    sys.unraisablehook = print_before_stop
    try:
        yield
    finally:
        stops.end()
        # After an interrupt the hook stays: interrupted objects may be destroyed later.
        if not stops.count:
            sys.unraisablehook = hook
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def is_stop(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C, which libraries may have turned into one of theirs."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


class _Stops:
    """Handles interrupts of the main thread, and repeats each until somebody handles it."""

    def __init__(self) -> None:
        self.count = 0
        self._repeated = False
        self._timer: threading.Timer | None = None

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal, in the main thread."""
        repeated, self._repeated = self._repeated, False
        if repeated and is_stop(sys.exc_info()[1]):
            return  # The first interrupt is being handled.
        self.count += 1
        logging.disable()
        self._timer = threading.Timer(_REPEAT_AFTER, self._repeat)
        self._timer.daemon = True
        self._timer.start()
        if self.count > _MOST_REPEATS or not _is_importing(frame):
            signal.default_int_handler(number, frame)

    def end(self) -> None:
        """Repeat none any more."""
        if self._timer is not None:
            self._timer.cancel()

    def _repeat(self) -> None:
        self._repeated = True
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            # The signal also wakes a thread that waits.
            signal.pthread_kill(main, signal.SIGINT)
        else:
            _thread.interrupt_main()


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
