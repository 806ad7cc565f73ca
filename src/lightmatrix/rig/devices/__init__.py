"""Devices of a live rig: projectors, cameras, and the virtual rig."""
