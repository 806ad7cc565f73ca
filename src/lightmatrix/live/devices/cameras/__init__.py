"""Cameras: one file for each back end, and what they share (`base`, `genicam`)."""
