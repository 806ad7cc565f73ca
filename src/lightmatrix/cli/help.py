"""The help of a command: the usual options, or all of them after --help-all."""

import re
from typing import Any

from typer.core import TyperCommand

# The headings of every command. Other options are rarely needed.
_USUAL = ("Arguments", "Options")
# What a reader writes for a type, as the help names it.
_WORDS = {"int": "N", "int range": "N", "float": "X", "float range": "X", "str": "TEXT"}
_WORDS |= {"path": "PATH", "list[Path]": "PATH"}
# What the values of options that are text look like, the same for all commands.
_VALUES = dict.fromkeys(("--size", "--projector-size", "--block"), "ROWSxCOLS")
_VALUES |= dict.fromkeys(("--response", "--projector-response"), "NAME|FILE")
_VALUES |= dict.fromkeys(("--bin-camera", "--bin-projector"), "N|NxN")
_VALUES |= dict.fromkeys(("--projector", "--camera"), "ADDRESS")
_VALUES |= dict.fromkeys(("--exposure", "--levels", "--clip", "--black-level"), "X,...")
_VALUES |= {"--black": "FILE|LEVEL", "--regularization": "auto|X", "--mix": "CELLS:SHARE,..."}
_VALUES |= {"--truth": "T.npz|CAPTURE|SCENE", "--memory": "SIZE"}


class Command(TyperCommand):
    """Lists the usual options; those under headings of their own after --help-all."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        sections = help_sections(self, ctx)
        shown = [name for name in sections if ctx.find_root().obj or name in _USUAL]
        for heading in shown:
            with formatter.section(heading):
                formatter.write_dl(sections[heading])
        if len(shown) < len(sections):
            formatter.write_paragraph()
            formatter.write_text(f"More options: {ctx.command_path} --help-all")


def help_sections(command: TyperCommand, context: Any) -> dict[str, list[tuple[str, str]]]:
    """The headings of a command's help (`rich_help_panel`), each with names and meanings."""
    sections: dict[str, list[tuple[str, str]]] = {name: [] for name in _USUAL}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            words, meaning = record
            words = re.sub("<([^<>]*)>", lambda found: _WORDS.get(found[1], found[1]), words)
            words = re.sub(
                r"(--\S+) TEXT$", lambda it: f"{it[1]} {_VALUES.get(it[1], 'TEXT')}", words
            )
            # Limits are left to the messages; and Typer puts a default that is text into brackets.
            meaning = re.sub(r"(; |\[)[^\]\[;]*x[<>]=?[^\]\[;]*\]$", r"\1]", meaning)
            meaning = meaning.replace("; ]", "]").removesuffix("[]").rstrip()
            meaning = re.sub(r"\[default: \((.*)\)\]$", r"[default: \1]", meaning)
            usual = _USUAL[parameter.param_type_name != "argument"]
            if usual == "Arguments":
                words = words.removesuffix(" PATH").removesuffix(" TEXT")
            heading = getattr(parameter, "rich_help_panel", None) or usual
            sections.setdefault(heading, []).append((words, meaning))
    return {heading: records for heading, records in sections.items() if records}
