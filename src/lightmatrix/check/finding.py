"""One thing that is wrong with a capture, and every kind of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Every kind of finding, and what it means.
KINDS = {
    "files": "files that cannot be read, do not fit together, or have levels of an unknown scale",
    "counts": "a photograph too few or too many",
    "interchanged": "patterns and photographs in each other's place",
    "patterns": "patterns from which T cannot be determined everywhere",
    "stripes": "patterns of stripes, which suffice where each camera pixel sees one place",
    "light": "too much or too little light",
    "clip": "photographs that clip below the stated clip level",
    "black": "a black frame that is too bright, or not the darkest",
    "white": "a white frame that is not the brightest",
    "order": "photographs that show the pattern of another one",
    "mirrored": "a projector's image that the camera sees mirrored",
    "unrelated": "photographs that do not follow the patterns at all",
    "frame": "a photograph that does not show its pattern",
    "motion": "a scene, camera or projector that moved by pixels",
    "linearity": "photographs that cannot tell whether they are linear in light",
    "unlit": "projector pixels that no pattern lights, where one is lit at a time",
    "jpeg": "photographs that went through lossy compression",
    "unseen": "camera pixels that never see the projector",
    # What the rig did in the course of the capture, by the names of its model.
    "gain": "light that changes from frame to frame",
    "exposure": "light that changes once",
    "ambient": "light of the room that changes",
    "shift": "a scene, camera or projector that moves by less than a pixel or two",
    "rows": "light that varies along the rows of the camera",
    "previous": "photographs that show some of the picture before",
    "camera-curve": "photographs that are not linear in light",
    "projector-curve": "patterns whose grey values are not proportional to light",
    "crosstalk": "projector pixels that lose light beside dark ones",
    "sharpening": "a projector that sharpens its picture",
    "camera-sharpening": "a camera that sharpens its photographs",
    "dynamic-contrast": "a projector whose light follows its picture",
    "tone-mapping": "a camera that brightens what is dark around",
    "camera-blur": "a camera that is out of focus",
}

# Kinds that say what a healthy capture cannot reveal; `check` exits with 0 if it has no other.
NOTES = ("stripes",)

# What to do about photographs out of order.
WRONG_ORDER = (
    "put the images in the order of the patterns, or take the capture again, waiting longer after "
    "each change of pattern"
)

# What to do about light that differs from frame to frame.
STEADY_LIGHT = (
    "fix exposure, gain and white balance, expose for whole periods of the mains and of the "
    "projector (1/50 or 1/60 s and multiples), and let lamps warm up; or state the exposures"
)

# The entry of a store's provenance that holds the findings of its capture.
FINDINGS = "findings"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a capture.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    frames : tuple of int
        The frames that are concerned, from 0; empty if all are.
    message : str
        What is wrong, and how it shows.
    advice : str
        What to do.
    """

    kind: str
    frames: tuple[int, ...]
    message: str
    advice: str

    @property
    def is_note(self) -> bool:
        """Whether nothing is wrong: healthy captures of this kind only have limits."""
        return self.kind in NOTES

    def as_dict(self) -> dict[str, Any]:
        """The finding, JSON-ready."""
        return {**vars(self), "frames": list(self.frames)}


def join_names(names: Sequence[str]) -> str:
    """Some names in words: "a, b and c", "a, b, c, d, e and 7 more"."""
    if len(names) > 5:
        return f"{', '.join(names[:5])} and {len(names) - 5} more"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def odd_light(changes: Mapping[str, float]) -> str:
    """State which frames are brighter or darker than all others, and by which share."""
    words = [f"{name} ({100 * change:+.0f} %)" for name, change in changes.items()]
    return f"the light is not that of the other frames in {join_names(words)}"


def order_findings(shown: Mapping[int, int], name: Callable[[int], str]) -> list[Finding]:
    """State which single frames show the pattern of which other frame."""
    findings = []
    for frame, pattern in sorted(shown.items()):
        if shown.get(pattern) != frame:
            message = (
                f"{name(frame)} shows the pattern of {name(pattern)}: is it swapped, repeated or "
                "late?"
            )
            findings.append(Finding("order", (frame,), message, WRONG_ORDER))
        elif frame < pattern:
            message = f"{name(frame)} and {name(pattern)} look swapped"
            findings.append(Finding("order", (frame, pattern), message, WRONG_ORDER))
    return findings
