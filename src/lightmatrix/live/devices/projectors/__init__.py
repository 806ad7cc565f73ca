"""Projectors: one file for each back end."""
