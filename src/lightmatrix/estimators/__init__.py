"""From a capture to a light transport matrix: how rows are tiled, solved and joined."""
