"""Projectors: one back end a file."""
