"""The command line; `main` turns errors into one clear message and exit code 2."""

from __future__ import annotations

import re
import sys
import warnings
from difflib import get_close_matches
from typing import Annotated

import typer

import lightmatrix
from lightmatrix.cli import experiment, make, measure, plan, use
from lightmatrix.cli.common import err, out, outputs
from lightmatrix.errors import LightMatrixError, LightMatrixWarning

app = typer.Typer(
    name="lightmatrix",
    help="Measure the light transport matrix of a projector-camera system, c = T p.",
    epilog="Start with `lightmatrix demo`.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for module in (make, plan, measure, use, experiment):
    module.register(app)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        out.print(f"lightmatrix {lightmatrix.__version__}")
        raise typer.Exit


def main(argv: list[str] | None = None) -> int:
    """Run the command line.

    Returns
    -------
    int
        0, 2 on bad input (with one message on standard error), 130 on Ctrl-C.
    """
    arguments = (sys.argv[1:] if argv is None else argv) or ["--help"]
    with warnings.catch_warnings():
        warnings.simplefilter("always", LightMatrixWarning)
        warnings.showwarning = _show_warning
        try:
            with outputs:
                code = typer.main.get_command(app).main(
                    args=arguments, prog_name="lightmatrix", standalone_mode=False
                )
            return code if isinstance(code, int) else 0
        except LightMatrixError as error:
            err.print(f"error: {error.message}", style="red", markup=False, highlight=False)
            if error.hint:
                err.print(f"  {error.hint}", markup=False, highlight=False)
            return 2
        except typer.TyperException as error:
            message, hint = _usage_error(error)
            err.print(f"error: {message}", style="red", markup=False, highlight=False)
            err.print(f"  {hint}", markup=False, highlight=False)
            return 2
        except (KeyboardInterrupt, typer.Abort):
            err.print("stopped; finished tiles are kept, run again to go on", markup=False)
            return 130
        except MemoryError:
            err.print("error: not enough memory\n  use a smaller size or --tile-rows")
            return 2


def _usage_error(error: typer.TyperException) -> tuple[str, str]:
    """What was wrong with the words given, and where to look or what was probably meant."""
    message = error.format_message().replace("Value error, ", "")
    context = getattr(error, "ctx", None)
    hint = f"see `{context.command_path if context else 'lightmatrix'} --help`"
    choice = re.search(r"'([^']*)' is not one of (.*)", message)
    if choice:
        near = get_close_matches(choice[1], re.findall(r"'([^']*)'", choice[2]), n=1)
        hint = f"did you mean {near[0]}? {hint}" if near else hint
    return message, hint


def _show_warning(
    message: Warning | str, category: type[Warning], *_: object, **__: object
) -> None:
    if issubclass(category, LightMatrixWarning):
        err.print(f"warning: {message}", style="yellow", markup=False, highlight=False)


def console() -> None:
    """Entry point of the installed command."""
    sys.exit(main())
