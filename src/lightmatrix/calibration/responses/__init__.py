"""How levels and light depend on each other, measured from photographs.

- `camera`: the camera's response, from photographs of one scene at several exposures.
  `pixel_series` chooses the pixels, and `curve_fit` fits the curve.
- `projector`: the projector's response, from photographs of a ramp of grey values.
- `photographs` and `pictures` serve both: what is read, and what is drawn.

The models of the two responses are `camera.camera_curve` and `patterns.projector_curve`. A live rig
measures its projector by itself: `live.light_levels`.
"""
