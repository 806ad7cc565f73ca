"""The live rig: a real projector and a real camera, or a virtual pair, driven frame by frame."""
