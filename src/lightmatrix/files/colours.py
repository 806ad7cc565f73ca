"""The channels of a colour image, and of a colour projector, in their order."""

from __future__ import annotations

COLOURS = ("red", "green", "blue")
