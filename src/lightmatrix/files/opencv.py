"""OpenCV, an optional part that several extras bring."""

from __future__ import annotations

from typing import Any

from lightmatrix.errors import MissingExtraError


def load_opencv(purpose: str, extra: str) -> Any:
    """The module cv2, or an error that says what for and which extra brings it."""
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs OpenCV", hint=f'install the extra: pip install "lightmatrix[{extra}]"'
        ) from error
    return cv2
