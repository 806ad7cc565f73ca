"""Whether a frame of a live rig can be trusted: one question a file."""
