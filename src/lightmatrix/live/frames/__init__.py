"""Whether a frame of a live rig can be trusted: each file answers one question."""
