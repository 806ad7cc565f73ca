"""The names of colour channels, in the order of an image's last axis."""

from __future__ import annotations

COLOURS = ("red", "green", "blue")
