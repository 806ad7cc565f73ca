"""Outputs: whole or absent, told from what others wrote, and locked while they are written."""
