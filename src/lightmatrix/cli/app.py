"""All commands under the headings of `lightmatrix --help`; how they run, and how they end.

Whatever ends a command becomes one message on standard error and an exit code, in `report`.
"""

import errno
import functools
import io
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from difflib import get_close_matches
from typing import Annotated, Any, TextIO

import typer
from typer.core import TyperGroup

import lightmatrix as lm
from lightmatrix.cli.calibrate import calibrate, response
from lightmatrix.cli.capture import capture
from lightmatrix.cli.captures import check, convert, pack
from lightmatrix.cli.compensate import compensate
from lightmatrix.cli.estimate import estimate, track
from lightmatrix.cli.help import Command
from lightmatrix.cli.plan import patterns, plan
from lightmatrix.cli.rig import app as rig
from lightmatrix.cli.rig import project
from lightmatrix.cli.shape import decode, layers, map, triangulate
from lightmatrix.cli.simulate import demo, render, scenes, simulate
from lightmatrix.cli.terminal import as_options, say, warn
from lightmatrix.cli.use import evaluate, export, info, relight, separate, show, view
from lightmatrix.errors import LightMatrixError, LightMatrixWarning, lacks_memory

# Exit codes. 70 is EX_SOFTWARE of sysexits.h, and 130 what shells give for Ctrl-C.
BAD, NO_MEMORY, BUG, STOPPED = 2, 3, 70, 130
# If this variable is set, a bug prints its traceback.
DEBUG = "LIGHTMATRIX_DEBUG"
# A shell sets this variable to ask for the words that can come next.
COMPLETION = "_LIGHTMATRIX_COMPLETE"
# Commands by stage of the work.
STAGES: dict[str, tuple[Callable[..., None], ...]] = {
    "Prepare": (plan, patterns),
    "Photograph": (capture, convert, response, calibrate),
    "Measure and use": (
        check, pack, estimate, track, decode, info, show, view, relight, separate, compensate,
        project, map, triangulate, layers, evaluate, export,
    ),
    "Simulate": (scenes, render, simulate),
    "Show": (demo,),
}  # fmt: skip
# Commands with commands of their own, by stage of the work.
GROUPS: dict[str, dict[str, typer.Typer]] = {"Photograph": {"rig": rig}}


class _Group(TyperGroup):
    """Lists the commands under the headings of `STAGES`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = max(len(name) for name in self.commands)
        for stage, members in STAGES.items():
            with formatter.section(stage):
                lines = []
                for name in (*(member.__name__ for member in members), *GROUPS.get(stage, {})):
                    short = self.commands[name].get_short_help_str(formatter.width - width - 6)
                    # Padded, so that all stages share one column.
                    lines.append((f"{name:<{width}}", short))
                formatter.write_dl(lines)


app = typer.Typer(
    name="lightmatrix",
    cls=_Group,
    help="Measure the light transport matrix T of a projector-camera system, c = T p.",
    epilog="Start with `lightmatrix demo`. Exit codes: 0 done, 1 `check` found a fault, 2 bad "
    "input or output, 3 out of memory, 70 a bug of lightmatrix, 130 stopped.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for command in (member for members in STAGES.values() for member in members):
    app.command(command.__name__, cls=Command)(command)
for groups in GROUPS.values():
    for name, group in groups.items():
        app.add_typer(group, name=name)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        say(f"lightmatrix {lm.__version__}")
        raise typer.Exit


def run(arguments: list[str]) -> int:
    """Run the command line with these words; see `lightmatrix.cli.main`."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal without umlauts, or a file name that is not text, must not make a command fail.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("always", LightMatrixWarning)
        warnings.showwarning = _show_warning
        try:
            return _invoke(arguments or ["--help"])
        # BaseException, since Ctrl-C and a panic of the compiled core are no Exception.
        except BaseException as error:
            return report(error)


# Typer reads every signature to build it, which takes half of a short command's time.
@functools.cache
def _command() -> Any:
    return typer.main.get_command(app)


def _invoke(arguments: list[str]) -> int:
    command = _command()
    try:
        if COMPLETION in os.environ:
            # The shell wants the words that can come next, and nothing else.
            command.main(arguments, prog_name="lightmatrix", complete_var=COMPLETION)
        words = ["--help" if word == "--help-all" else word for word in arguments]
        every = words != arguments
        with command.make_context("lightmatrix", words, obj=every) as context:
            command.invoke(context)
    except typer.Exit as leaving:
        return leaving.exit_code
    except SystemExit as leaving:
        # Typer leaves like this after it has answered a shell or installed the completion.
        return leaving.code if isinstance(leaving.code, int) else 0
    finally:
        sys.stdout.flush()
    return 0


def _show_warning(
    message: Warning | str, category: type[Warning], *_: object, **__: object
) -> None:
    if issubclass(category, LightMatrixWarning):
        warn(as_options(f"warning: {message}"), style="yellow")


def report(error: BaseException) -> int:
    """Print what went wrong as one message, and return the exit code."""
    if isinstance(error, BrokenPipeError):
        # The reader, such as `head`, has read enough.
        _give_up(sys.stdout)
        return 0
    code, lines = _explain(error)
    try:
        for number, line in enumerate(lines):
            warn(line if number == 0 else f"  {line}", "red" if number == 0 and code else None)
    except (OSError, ValueError):
        # Without standard error only the exit code is left. Python must not try to write the rest
        # of its buffer when it exits.
        _give_up(sys.stderr)
    return code


def _explain(error: BaseException) -> tuple[int, list[str]]:
    notes = getattr(error, "__notes__", [])
    if _is_stop(error):
        return STOPPED, ["; ".join(["stopped", *notes])]
    if isinstance(error, LightMatrixError):
        hint = as_options(error.hint or "")
        return BAD, [f"error: {error.message}", *([hint] if hint else [])]
    if isinstance(error, typer.TyperException):
        message, hint = _usage_error(error)
        return BAD, [f"error: {message}", hint]
    if lacks_memory(error):
        what = "; ".join(["error: not enough memory", *notes])
        return NO_MEMORY, [what, "use a smaller size, or --memory"]
    if isinstance(error, OSError) and str(error).startswith("cannot start"):
        return NO_MEMORY, [f"error: {error}", "free some memory, or lower RAYON_NUM_THREADS"]
    # Errors of a stream, such as a full disk behind standard output, are no bug.
    of_streams = {errno.ENOSPC, errno.EIO, errno.EBADF, errno.EDQUOT, errno.EFBIG}
    if isinstance(error, OSError) and error.filename is None and error.errno in of_streams:
        _give_up(sys.stdout)
        why = error.strerror or str(error)
        hint = "free some space, or redirect the output elsewhere"
        return BAD, [f"error: standard output cannot be written ({why})", hint]
    if isinstance(error, OSError) and error.filename is not None:
        hint = "check the name, its permissions and the free space"
        return BAD, [f"error: {error.filename}: {error.strerror or error}", hint]
    if os.environ.get(DEBUG):
        with suppress(OSError, ValueError):
            traceback.print_exception(error)
    text = " ".join(str(error).split())
    return BUG, [
        f"internal error: {type(error).__name__}: {text}",
        f"this is a bug of lightmatrix; please report it with the command and with {DEBUG}=1 set",
    ]


def _is_stop(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C, which libraries may have turned into one of theirs."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _usage_error(error: typer.TyperException) -> tuple[str, str]:
    """What is wrong with the arguments; and what the user probably meant, or where to look."""
    message = error.format_message().replace("Value error, ", "")
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "lightmatrix"
    # What is required is among the usual options.
    rare = isinstance(getattr(context, "command", None), Command) and "Missing" not in message
    hint = f"see `{path} --help{'-all' if rare else ''}`"
    if path.endswith(" simulate") and message.startswith("No such option: --size"):
        hint = "the size is that of the patterns: `lightmatrix patterns KIND --size ...`"
    if message.startswith("Missing option '--geometry'"):
        hint = "`lightmatrix calibrate` writes one, and `simulate` into its capture: geometry.json"
    choice = re.search(r"'([^']*)' is not one of (.*)", message)
    if choice:
        near = get_close_matches(choice[1], re.findall(r"'([^']*)'", choice[2]), n=1)
        hint = f"did you mean {near[0]}? {hint}" if near else hint
    return message, hint


def _give_up(stream: TextIO) -> None:
    """Drop what the stream still holds, so that Python does not complain when it exits."""
    with suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
