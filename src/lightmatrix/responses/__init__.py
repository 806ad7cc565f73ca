"""How levels and light depend on each other, measured from photographs.

- `camera`: the camera's response, from photographs of one scene at several exposures.
- `projector`: the projector's response, from photographs of a ramp of grey values.
- `photographs` serves both: what is read, and what is drawn.

The models of the two responses are `camera.camera_curve` and `patterns.projector_curve`. A live rig
measures its projector by itself: `live.measurements.grey_ramp`.
"""
