"""The response curve of a camera, found in the photographs of a capture itself.

Light adds up. What a camera pixel shows under many patterns is therefore a sum that can be
predicted, and a curve that bends the light leaves a trace that no sum explains.

- `bend`: how a curve may differ from the one that is assumed: by a gamma, or by a few smooth bends.
- `trace`: the equation from which the size of the bends follows.
- `from_windows`: predicts without an estimate of T, from windows of projector pixels.
- `from_transport`: predicts by an estimate of T, which is more exact where the light is blurred.
- `curve`: what was found, with its uncertainty.

`calibration/responses/` measures curves from photographs that are taken for this purpose.
"""
