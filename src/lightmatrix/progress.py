"""How long calls report their progress."""

from collections.abc import Callable

# Called with what is done and the total, in the unit that the call states.
Progress = Callable[[int, int], None]
