"""Options that several commands share."""

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from typer import Argument, Option

from lightmatrix import defaults
from lightmatrix.errors import InputError, warn
from lightmatrix.files.colours import stores_within

_Command = TypeVar("_Command", bound=Callable[..., Any])


def described(**options: Any) -> Callable[[_Command], _Command]:
    """Give parameters of a command their help: a text, or the `Option` that holds it.

    Typer takes `bits: Annotated[int, Option(help="Bit depth.")] = 8`. This makes it of the
    parameter `bits: int = 8` and `described(bits="Bit depth.")`, so that signatures stay short. An
    `output` is -o as well, and what is off by default has no --no-NAME.
    """

    def decorate(command: _Command) -> _Command:
        signature = inspect.signature(command, eval_str=True)
        parameters = dict(signature.parameters)
        for name, each in options.items():
            names = ["-o"] if name == "output" else []
            if names or parameters[name].default is False:
                names.append(f"--{name.replace('_', '-')}")
            option = Option(*names, help=each) if isinstance(each, str) else each
            kind: Any = Annotated[parameters[name].annotation, option]
            parameters[name] = parameters[name].replace(annotation=kind)
        signature = signature.replace(parameters=[*parameters.values()])
        command.__signature__ = signature  # type: ignore[attr-defined]
        command.__annotations__ = {name: each.annotation for name, each in parameters.items()}
        return command

    return decorate


Overwrite = Annotated[bool, Option("--overwrite", help="Replace an output that exists.")]
Json = Annotated[bool, Option("--json", help="Print one JSON object instead of text.")]
Geometry = Annotated[Path, Option(help="Where camera and projector stand: a file of `calibrate`.")]
Tolerance = Annotated[
    float, Option(help="Error of a depth that counts as right, as a share of the distance.")
]
LeastProbability = Annotated[
    float, Option(help="Keep what is right as probably as this; 0.99 for hardly a wrong point.")
]
Verbose = Annotated[bool, Option("--verbose", help="Show every number instead of the main ones.")]
Clip = Annotated[
    float | None,
    Option(help="Raw level at which samples clip.", show_default="255, 65535, or 1 for float"),
]
RESPONSE_HELP = "linear, gamma:2.2, srgb, or a file of `lightmatrix response`."
# The response that `estimate` finds in the photographs.
AUTO = "auto"
FIND_HELP = (
    "linear, gamma:2.2, srgb, a file of `lightmatrix response`; or auto (found in the photographs, "
    "also of a capture folder)."
)
ResponseCurve = Annotated[
    str | None, Option("--response", help=RESPONSE_HELP, show_default="linear")
]
Seed = Annotated[int, Option(help="Seed of the random numbers.", min=0)]
Store = Annotated[Path, Argument(metavar="SCENE.zarr", help="A store of `estimate`, or a T.npz.")]
RigName = Annotated[
    str | None,
    Option("--rig", metavar="virtual:SCENE", help="A virtual rig, which needs no hardware."),
]
ProjectorName = Annotated[str | None, Option("--projector", help="A projector, such as window:1.")]
ProjectorNames = Annotated[
    list[str] | None,
    Option(
        "--projector",
        metavar="ADDRESS",
        help="A projector, such as window:1; repeat it for several at once.",
    ),
]
CameraName = Annotated[str | None, Option("--camera", help="A camera, such as aravis:ID.")]
CameraNames = Annotated[
    list[str] | None,
    Option(
        "--camera",
        metavar="ADDRESS",
        help="A camera, such as aravis:ID; repeat it for several in turn.",
    ),
]
Settle = Annotated[
    float | None,
    Option(help="Seconds to wait after showing a picture.", show_default="as measured"),
]
RigFile = Annotated[
    Path, Option("--rig-file", help="The file that keeps the measurements of the rig.")
]


def written_stores(output: Path) -> str:
    """The store that an estimate wrote, or those of several projectors, in words."""
    return " and ".join(map(str, stores_within(output) or [output]))


def missing_rig_file(file: Path, *, with_rig: bool = True) -> None:
    """Say that there is no rig file of a name that the user gave."""
    if file == Path(defaults.RIG_FILE) or file.is_file():
        return
    if not with_rig:
        raise InputError(f"{file}: no such file", hint="check the name, or leave --rig-file out")
    warn(f"{file}: no such file; the rig is measured now, and the file written")


# Defaults as the texts of options.
USUAL_SIZE = "x".join(map(str, defaults.USUAL_SIZE))
# Numbers of pixels fit into 32 bits.
MOST_PIXELS = 2**31 - 1


def refuse(options: Mapping[str, object], what: str, hint: str = "leave it out") -> None:
    """Raise InputError if any of some options, by name, has a value, as `what` has none."""
    given = [name for name, value in options.items() if value not in (None, False)]
    if given:
        raise InputError(f"{', '.join(given)} for {what}", hint=hint)


def size(text: str) -> tuple[int, int]:
    """Read a size such as 128x128 (rows x columns) or 128."""
    match = re.fullmatch(r"(\d+)(?:[xX*](\d+))?", text.strip(), flags=re.ASCII)
    if match is None:
        raise InputError(f"a size of {text!r}", hint="write rows x columns, such as 128x128")
    rows = int(match[1])
    cols = int(match[2] or rows)
    if rows < 1 or cols < 1 or rows * cols > MOST_PIXELS:
        hint = f"use at least 1x1 and at most {MOST_PIXELS:,} pixels"
        raise InputError(f"a size of {text!r}", hint=hint)
    return rows, cols
