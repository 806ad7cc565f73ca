"""Cameras: one back end a file."""
