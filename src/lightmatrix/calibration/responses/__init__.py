"""Measuring responses from photographs: the camera's and the projector's."""
