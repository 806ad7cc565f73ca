"""What is measured of a camera and a projector, independent of any scene.

`responses` measures how light and levels depend on each other. The geometry of camera and
projector belongs here too.
"""
