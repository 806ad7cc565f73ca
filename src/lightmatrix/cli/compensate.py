"""`lightmatrix compensate`: the pattern under which the camera sees a wanted picture."""

from pathlib import Path
from typing import Any, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.terminal import Stages, enter_was_pressed, progress, say, show_json
from lightmatrix.defaults import RIG_FILE, VIDEOS
from lightmatrix.errors import InputError
from lightmatrix.files.colours import shown_files


@options.described(
    output="Image of the pattern; of a video, a folder of them.",
    wanted=Argument(
        metavar="WANTED",
        help="The picture that the camera is to see: an image, a folder of frames, or a video.",
    ),
    brightness=Option(
        metavar="0.7",
        help="Light of wanted white, as a share of that of a white pattern.",
        show_default="as bright as possible",
    ),
    fit="A picture of another size covers the camera, is seen whole, or is stretched.",
    black="Photograph of a black pattern: the room's light.",
    mask="Image of camera pixels, 0 where the picture does not matter.",
    projector_mask="Image of projector pixels, 0 for those that stay black.",
    gamma=Option(
        help="Display gamma of the picture.", show_default="2.2; 1 for files of floats: EXR"
    ),
    projector_response=Option(
        metavar="FILE|gamma:2.2|linear",
        help="Light of the projector's grey values, by which the pattern is encoded.",
        show_default="that of the rig's file or of T's capture, or gamma:2.2",
    ),
    beside=Option(
        metavar="OTHER.zarr", help="T of a further projector on the same scene; repeatable."
    ),
    cancel_global="Show direct light only, as under the pattern WANTED, or under white.",
    refine=Option(help="Photographs on a rig that correct the pattern.", show_default="none"),
    live="Go on photographing and correcting until Enter, while the light may change.",
)
def compensate(
    scene: options.Store,
    output: Path,
    wanted: Path | None = None,
    brightness: float | None = None,
    fit: Literal["cover", "contain", "stretch"] = "cover",
    black: Path | None = None,
    mask: Path | None = None,
    projector_mask: Path | None = None,
    gamma: float | None = None,
    projector_response: str | None = None,
    beside: list[Path] | None = None,
    cancel_global: bool = False,
    refine: int | None = None,
    live: bool = False,
    rig: options.RigName = None,
    projector: options.ProjectorNames = None,
    camera: options.CameraName = None,
    settle: options.Settle = None,
    rig_file: options.RigFile = Path(RIG_FILE),
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Find the pattern that makes the scene look as wanted.

    It takes into account what light does on its way from surface to surface. Pixels that cannot be
    reached are counted. With a rig, photographs of the pattern correct it.
    """
    with_rig = rig is not None or projector is not None or camera is not None
    video = wanted is not None and (wanted.is_dir() or wanted.suffix.lower() in VIDEOS)
    of_rig: dict[str, object] = {"--refine": refine, "--live": live, "--settle": settle}
    if cancel_global:
        of_rig |= {"--beside": beside, "--black": black, "--mask": mask, "--gamma": gamma}
        of_rig |= {"--brightness": brightness, "--projector-mask": projector_mask}
        options.refuse(of_rig | {"a video": video, "a rig": with_rig}, "--cancel-global")
    elif wanted is None:
        raise InputError("no picture", hint="give the wanted picture, or a folder of frames")
    elif with_rig:
        options.refuse({"--black": black}, "a rig", "leave it out: the rig photographs black")
        known = "leave it out: the rig's file has it, which `lightmatrix rig response` measures"
        options.refuse({"--projector-response": projector_response}, "a rig", known)
        options.refuse({"--beside": beside, "a video": video}, "a rig")
    else:
        options.refuse(of_rig, "a compensation without a rig", "name the rig, or leave it out")
        options.refuse({"--beside": video and beside}, "a video")
    options.missing_rig_file(rig_file, with_rig=with_rig)
    response: Any = projector_response
    source = "the rig" if with_rig else projector_response or "the capture of T"
    if response is None and not with_rig and not beside and rig_file.is_file():
        response, source = lm.RigMeasurements.load(rig_file).response, str(rig_file)
    written: dict[str, Any] = {"output": output, "overwrite": overwrite}
    if not with_rig:
        written["projector_response"] = response
    common: dict[str, Any] = {"mask": mask, "projector_mask": projector_mask, **written}
    common |= {"brightness": brightness, "gamma": gamma, "fit": fit}
    found: Any
    if cancel_global:
        found = lm.cancel_global(scene, wanted, **written)
    elif video:
        assert wanted is not None
        with progress("compensating", "frames") as report:
            found = lm.compensate_video(scene, wanted, ambient=black, progress=report, **common)
    elif with_rig:
        opened = lm.open_rig(rig, projector=projector, camera=camera)
        assert wanted is not None
        if live:
            common["live"] = _Live(refine, quiet=as_json)
        elif refine is not None:
            common["steps"] = refine
        with opened, Stages() as shown:
            common |= {"keep": rig_file, "settle": settle, "measuring": shown.measured}
            found = lm.refine_compensation(opened, scene, wanted, **common)
    else:
        assert wanted is not None
        found = lm.compensate([scene, *(beside or ())], wanted, ambient=black, **common)
    shown_patterns = getattr(found, "compensation", found)
    one = video or shown_patterns.in_colour
    names = shown_files(output, 1 if one else len(shown_patterns.patterns))
    summary = {"output": output if len(names) == 1 else names, **found.as_dict()}
    if as_json:
        show_json(summary)
        return
    if cancel_global:
        say(f"{output}: the camera sees direct light, within 5 % of the light of white")
    else:
        white = f"{100 * summary['brightness']:.0f} %"
        listed = " and ".join(map(str, names))
        say(f"{listed}: wanted white is {white} of what a white pattern gives")
    if "frames" in summary:
        say(f"{summary['frames']} frames; {100 * summary['reached']:.1f} % of the pixels reached")
    else:
        _show(summary, live=live)
    gamma_shown = summary["projector_gamma"]
    if gamma_shown is None:
        say("it holds light, for a projector without a gamma")
    elif summary["projector_gamma_assumed"]:
        say(
            f"encoded for a projector of gamma {gamma_shown:.2g}, which is assumed: "
            "`lightmatrix rig response` measures it, --projector-response states it",
            style="yellow",
        )
    else:
        say(f"encoded for a projector of gamma {gamma_shown:.2g}, by {source}")


class _Live:
    """Says how close each photograph comes, until Enter or so many photographs after the first."""

    def __init__(self, most: int | None, *, quiet: bool) -> None:
        self._most, self._quiet, self._count = most, quiet, 0

    def __call__(self, decibels: float) -> bool:
        if not self._quiet:
            say(f"photograph {self._count}: {decibels:.1f} dB" + "; Enter ends" * (not self._count))
        self._count += 1
        return not enter_was_pressed() and (self._most is None or self._count <= self._most)


def _show(summary: dict[str, Any], *, live: bool) -> None:
    plain = summary["uncompensated_psnr"]
    if plain is not None:
        say(
            f"predicted PSNR {summary['predicted_psnr']:.1f} dB, "
            f"{plain:.1f} dB if the picture were shown as it is"
        )
    reasons = {"too_dark": "too dark", "too_bright": "too bright", "shadow": "in shadow"}
    reasons |= {"masked": "masked"}
    shares = {text: summary.get(key) for key, text in reasons.items()}
    rest = [f"{100 * share:.1f} % {text}" for text, share in shares.items() if share]
    share = f"{100 * summary['reached']:.1f} % of the camera pixels are reached"
    say("; ".join([share, ", ".join(rest)] if rest else [share]))
    if not live:
        for step, decibels in enumerate(summary.get("photographed_psnr", ())):
            say(f"photograph {step}: {decibels:.1f} dB")
    if summary["clipped"]:
        say(f"{100 * summary['clipped']:.2g} % of the pixels would clip", style="yellow")
