"""Outputs that are written whole or not at all, locked meanwhile, and replace only our own."""
