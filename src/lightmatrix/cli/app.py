"""All commands, in the order and under the headings of `lightmatrix --help`; and how they run."""

from __future__ import annotations

import functools
import io
import os
import re
import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import lightmatrix as lm
from lightmatrix.cli.calibrate import calibrate
from lightmatrix.cli.capture import capture
from lightmatrix.cli.check import check
from lightmatrix.cli.claims import outputs
from lightmatrix.cli.compensate import compensate
from lightmatrix.cli.convert import convert
from lightmatrix.cli.decode import decode
from lightmatrix.cli.demo import demo
from lightmatrix.cli.estimate import estimate
from lightmatrix.cli.evaluate import evaluate
from lightmatrix.cli.export import export
from lightmatrix.cli.failures import as_options, report
from lightmatrix.cli.info import info
from lightmatrix.cli.pack import pack
from lightmatrix.cli.patterns import patterns
from lightmatrix.cli.plan import plan
from lightmatrix.cli.relight import relight
from lightmatrix.cli.render import render
from lightmatrix.cli.response import response
from lightmatrix.cli.rig import app as rig
from lightmatrix.cli.scenes import scenes
from lightmatrix.cli.separate import separate
from lightmatrix.cli.show import show
from lightmatrix.cli.simulate import simulate
from lightmatrix.cli.terminal import say, warn
from lightmatrix.cli.triangulate import triangulate
from lightmatrix.cli.view import view
from lightmatrix.errors import LightMatrixWarning

# A shell sets this variable to ask for the words that can come next.
COMPLETION = "_LIGHTMATRIX_COMPLETE"
# Commands by stage of the work.
STAGES: dict[str, tuple[Callable[..., None], ...]] = {
    "Prepare": (plan, patterns),
    "Photograph": (capture, convert, response, calibrate),
    "Measure and use": (
        check,
        pack,
        estimate,
        decode,
        info,
        show,
        view,
        relight,
        separate,
        compensate,
        triangulate,
        evaluate,
        export,
    ),
    "Simulate": (scenes, render, simulate),
    "Show": (demo,),
}
# Commands with commands of their own, by stage of the work.
GROUPS: dict[str, dict[str, typer.Typer]] = {"Photograph": {"rig": rig}}


class _Group(TyperGroup):
    """Lists the commands under the headings of `STAGES`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = max(map(len, self.commands))
        for stage, members in STAGES.items():
            with formatter.section(stage):
                lines = []
                for name in (*(member.__name__ for member in members), *GROUPS.get(stage, {})):
                    short = self.commands[name].get_short_help_str(formatter.width - width - 6)
                    # Padded, so that all stages share one column.
                    lines.append((f"{name:<{width}}", short))
                formatter.write_dl(lines)


class _Command(TyperCommand):
    """Lists the options under their headings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for heading, records in help_sections(self, ctx).items():
            with formatter.section(heading):
                formatter.write_dl(records)


def help_sections(command: TyperCommand, context: Any) -> dict[str, list[tuple[str, str]]]:
    """The headings of a command's help (`rich_help_panel`), each with names and meanings."""
    sections: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            words, meaning = record
            # Typer puts a default that is text into brackets of its own.
            meaning = re.sub(r"\[default: \((.*)\)(;.*)?\]$", r"[default: \1\2]", meaning)
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            heading = getattr(parameter, "rich_help_panel", None) or usual
            sections.setdefault(heading, []).append((words, meaning))
    # Options without a heading are those that most commands have: they come last.
    rest = sections.pop("Options", None)
    return sections | ({"Options": rest} if rest else {})


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
    app.command(command.__name__, cls=_Command)(command)
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
        with outputs, command.make_context("lightmatrix", list(arguments)) as context:
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
