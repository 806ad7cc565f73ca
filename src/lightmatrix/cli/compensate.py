"""`lightmatrix compensate`: the pattern under which the camera sees a wanted picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.terminal import progress, say, show_json, stages
from lightmatrix.defaults import RIG_FILE, USUAL_PATIENCE
from lightmatrix.errors import InputError


def compensate(
    scene: options.Store,
    output: Annotated[Path, options.output_option("Image of the pattern; a folder with --video.")],
    wanted: Annotated[
        Path | None, Argument(metavar="WANTED", help="The picture that the camera is to see.")
    ] = None,
    brightness: Annotated[
        str,
        Option(
            metavar="auto|0.7", help="Light of wanted white, as a share of that of a white pattern."
        ),
    ] = "auto",
    black: Annotated[
        Path | None, Option(help="Photograph of a black pattern: the room's light.")
    ] = None,
    mask: Annotated[
        Path | None, Option(help="Image that is 0 where the picture does not matter.")
    ] = None,
    gamma: Annotated[
        float, Option(help="Display gamma of the picture, 2.2 for most photographs.")
    ] = 1.0,
    resize: Annotated[bool, Option("--resize", help="Resize the picture to the camera.")] = False,
    exposure: Annotated[
        float,
        Option(help="Exposure at which clipped camera pixels are counted; T is for exposure 1."),
    ] = 1.0,
    projector_response: Annotated[
        str | None,
        Option(
            metavar="FILE|gamma:2.2|linear",
            help="Light of the projector's grey values, by which the pattern is encoded.",
            show_default="that of the rig's file, or of T's capture",
        ),
    ] = None,
    green: options.Green = None,
    blue: options.Blue = None,
    beside: Annotated[
        list[Path] | None,
        Option(
            metavar="OTHER.zarr", help="T of a further projector on the same scene; repeatable."
        ),
    ] = None,
    video: Annotated[
        Path | None, Option(help="Folder of frames to compensate instead of one picture.")
    ] = None,
    cancel_global: Annotated[
        bool,
        Option(
            "--cancel-global",
            help="Show direct light only, as under the pattern WANTED, or under white.",
        ),
    ] = False,
    refine: Annotated[
        int | None,
        Option(help="Photographs on a rig that correct the pattern.", show_default="none"),
    ] = None,
    rig: options.RigName = None,
    projector: options.ProjectorName = None,
    camera: options.CameraName = None,
    settle: options.Settle = None,
    patience: options.Patience = USUAL_PATIENCE,
    rig_file: options.RigFile = Path(RIG_FILE),
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Find the pattern that makes the scene look as wanted.

    It takes into account what light does on its way from surface to surface. Pixels that cannot be
    reached are counted. With a rig, photographs of the pattern correct it.
    """
    common: dict[str, Any] = {
        "mask": mask,
        "brightness": _brightness(brightness),
        "gamma": gamma,
        "resize": resize,
        "output": output,
        "overwrite": overwrite,
    }
    with_rig = rig is not None or projector is not None or camera is not None
    several = bool(green or blue or beside)
    if cancel_global:
        other = several or video or with_rig or refine is not None or black or mask or resize
        if other or common["brightness"] is not None or gamma != 1:
            raise InputError(
                "--cancel-global with options of other compensations",
                hint="it takes SCENE.zarr and, if not white, a pattern",
            )
    elif (wanted is None) == (video is None):
        both = "both a picture and a video" if wanted else "no picture"
        raise InputError(both, hint="give the wanted picture, or --video and a folder of frames")
    elif (refine is not None or settle is not None) and not with_rig:
        raise InputError(
            f"--{'settle' if refine is None else 'refine'} without a rig",
            hint="add --rig virtual:SCENE, or --projector and --camera",
        )
    elif several and (video is not None or with_rig):
        raise InputError(
            "several matrices for a video or a rig",
            hint="compensate single pictures with several projectors or in colour",
        )
    elif with_rig and (video is not None or black is not None):
        raise InputError(
            f"a rig and --{'video' if video is not None else 'black'}",
            hint="a rig takes a picture, and photographs black by itself",
        )
    response: Any = projector_response
    source = projector_response or "the capture of T"
    if with_rig:
        if projector_response is not None:
            raise InputError(
                "a rig and --projector-response", hint="a rig measures its response by itself"
            )
        source = "the rig"
    elif response is None and not several and rig_file.is_file():
        response, source = lm.RigMeasurements.load(rig_file).response, str(rig_file)
    encoding = {"projector_response": response}
    summary: dict[str, Any] = {"output": output}
    if cancel_global:
        found = lm.cancel_global(scene, wanted, output=output, overwrite=overwrite, **encoding)
        summary |= found.as_dict()
    elif video is not None:
        with progress("compensating", "frames") as report:
            frames = lm.compensate_video(
                scene, video, ambient=black, progress=report, **common, **encoding
            )
        summary |= frames.as_dict()
    elif with_rig:
        opened = lm.open_rig(rig, projector=projector, camera=camera, patience=patience)
        with opened, stages() as shown:
            if refine is not None:
                common["steps"] = refine
            assert wanted is not None
            refined = lm.refine_compensation(
                opened,
                scene,
                wanted,
                keep=rig_file,
                settle=settle,
                measuring=shown.measured,
                **common,
            )
        summary |= refined.as_dict()
    else:
        matrices = [*(options.primaries(scene, green, blue) or (scene,)), *(beside or ())]
        assert wanted is not None
        found = lm.compensate(
            matrices, wanted, ambient=black, exposure=exposure, **common, **encoding
        )
        summary |= found.as_dict()
    if as_json:
        show_json(summary)
    else:
        _show(summary, cancelled=cancel_global)
        gamma_shown = summary["projector_gamma"]
        if gamma_shown is None:
            say("it holds light: a projector with a gamma needs --projector-response")
        else:
            say(f"encoded for a projector of gamma {gamma_shown:.2g}, by {source}")


def _brightness(text: str) -> float | None:
    if text == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"a brightness of {text!r}", hint="write auto, or a number") from None


def _show(summary: dict[str, Any], *, cancelled: bool) -> None:
    if cancelled:
        say(f"{summary['output']}: the camera sees direct light, within 5 % of the light of white")
    else:
        white = f"{100 * summary['brightness']:.0f} %"
        say(f"{summary['output']}: wanted white is {white} of what a white pattern gives")
    if "frames" in summary:
        say(f"{summary['frames']} frames; {100 * summary['reached']:.1f} % of the pixels reached")
        return
    reasons = {"too_dark": "too dark", "too_bright": "too bright", "shadow": "in shadow"}
    rest = [
        f"{100 * summary[key]:.1f} % {text}"
        for key, text in {**reasons, "masked": "masked"}.items()
        if summary.get(key)
    ]
    share = f"{100 * summary['reached']:.1f} % of the camera pixels are reached"
    say("; ".join([share, ", ".join(rest)] if rest else [share]))
    for step, decibels in enumerate(summary.get("photographed_psnr", ())):
        say(f"photograph {step}: {decibels:.1f} dB")
    if summary["clipped"]:
        say(f"{100 * summary['clipped']:.2g} % of the pixels would clip", style="yellow")
