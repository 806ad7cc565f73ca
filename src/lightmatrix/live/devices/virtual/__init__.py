"""A virtual rig: a projector and a camera before a scene whose light transport is known."""
