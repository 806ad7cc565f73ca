"""Progress of the measurements of a rig, one bar after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from lightmatrix.cli.terminal import progress


@contextmanager
def calibrating() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each part that is measured; silent where there is no terminal.

    Yields a callback that takes (part, done, total).
    """
    with ExitStack() as shown:
        bars: dict[str, Callable[[int, int], None]] = {}

        def tell(part: str, done: int, total: int) -> None:
            if part not in bars:
                shown.close()
                bars[part] = shown.enter_context(progress(f"measuring {part}", "looks"))
            bars[part](done, total)
            if done == total:
                shown.close()

        yield tell
