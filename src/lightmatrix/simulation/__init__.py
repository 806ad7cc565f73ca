"""The simulated rig: rendered scenes whose light transport matrix is known exactly."""
