"""Calibration of cameras and projectors: their responses."""
