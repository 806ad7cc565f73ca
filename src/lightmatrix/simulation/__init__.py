"""The simulator: rendered and procedural scenes whose light transport matrix is known exactly."""
