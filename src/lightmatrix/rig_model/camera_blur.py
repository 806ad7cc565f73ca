"""A camera that is out of focus, whose pixels see what their neighbours see, too."""

from __future__ import annotations

from lightmatrix.rig_model.term import Array, Draft, Term


class CameraBlur(Term):
    """The camera's image is blurred; photographs cannot be sharpened, so T is estimated with it.

    The blur and T are found together, by `estimators/defocused.py`.
    """

    name = "camera-blur"
    advice = "focus the camera on the scene, or close its aperture"

    def take_out(self, values: Array, draft: Draft) -> None:
        pass

    def sentence(self, values: Array) -> str:
        return f"the camera is out of focus by {values[0]:.1f} of its pixels"
