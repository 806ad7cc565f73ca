"""Captures: patterns, the photographs under them, how to read and how to check these."""
