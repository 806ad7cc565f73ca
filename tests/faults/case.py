"""A case of the table: the fault, the command, and what must hold; and the verdict on a run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from .snapshot import Snapshot, differences

# Seconds after which a command counts as hanging. None needs a tenth of that.
USUAL_SECONDS = 20.0
# Exit codes of the command line.
REFUSED, OUT_OF_MEMORY, INTERRUPTED = 2, 3, 130


class Outcome(StrEnum):
    """What became of a case."""

    REFUSED_WELL = "refused well"
    FINE = "fine"
    SKIPPED = "skipped"
    TRACEBACK = "traceback"
    CRASH = "crash"
    HANG = "hang"
    DESTROYED = "destroyed"
    ACCEPTED_WRONGLY = "accepted wrongly"
    REFUSED_WRONGLY = "refused wrongly"
    LEFT_OVER = "left-over"
    UNCLEAR = "unclear message"


GOOD = frozenset({Outcome.REFUSED_WELL, Outcome.FINE, Outcome.SKIPPED})


class SkipError(Exception):
    """The system cannot make this fault, with the reason."""


@dataclass(frozen=True)
class Ran:
    """What a command did: exit code (negative for a signal, None for a hang) and words."""

    code: int | None
    out: str = ""
    err: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Limits:
    """What the system gives a command.

    Parameters
    ----------
    memory : int, optional
        Bytes of address space beyond what the interpreter already has.
    file_size : int, optional
        Bytes that a file may grow to, as a full disk would have it.
    mount : (str, int), optional
        A folder of the work folder that becomes a small disk of its own, and its bytes.
    environment : mapping
        Variables set.
    """

    memory: int | None = None
    file_size: int | None = None
    mount: tuple[str, int] | None = None
    environment: tuple[tuple[str, str], ...] = ()


# Puts a fault into the work folder; its result is ignored.
Prepare = Callable[[Path], object]
# Checks the work folder after the run: what is wrong, or None.
Check = Callable[[Path, Ran], str | None]
# Runs commands in the work folder, through a runner of one command.
Command = Callable[[str], Ran]
Scenario = Callable[[Path, Command], Ran]


def nothing(folder: Path) -> None:
    """The fault is in the command."""


@dataclass(frozen=True)
class Case:
    """One fault.

    Parameters
    ----------
    name : str
        The fault, in unique words.
    command : str
        The command line after `lightmatrix`, split as a shell does.
    says : str or tuple of str
        Words that the message must hold, in any case; all of several. A `|` separates alternatives.
    prepare : callable
        Puts the fault into a fresh work folder.
    code : int or tuple of int
        Permitted exit codes.
    makes : tuple of str
        Paths, relative to the work folder, that the command may make or change when it is not
        refused; None means its -o or --output (or second word, for export).
    leaves : tuple of str
        Paths that may be new or changed even if it is refused, such as finished tiles.
    check : callable, optional
        What else must hold.
    then : str, optional
        A command that must work afterwards.
    scenario : callable, optional
        Run in place of the command.
    limits, seconds : Limits, float
        What it gets.
    needs : tuple of str
        What it needs of the work folder, besides what its subject needs.
    """

    name: str
    command: str = ""
    says: str | tuple[str, ...] = ()
    prepare: Prepare = nothing
    code: int | tuple[int, ...] = REFUSED
    makes: tuple[str, ...] | None = None
    leaves: tuple[str, ...] = ()
    check: Check | None = None
    then: str | None = None
    scenario: Scenario | None = None
    limits: Limits = field(default_factory=Limits)
    seconds: float = USUAL_SECONDS
    needs: tuple[str, ...] = ()

    @property
    def codes(self) -> tuple[int, ...]:
        """Permitted exit codes."""
        return (self.code,) if isinstance(self.code, int) else self.code

    @property
    def phrases(self) -> tuple[str, ...]:
        """What the message must hold."""
        return (self.says,) if isinstance(self.says, str) else self.says

    @property
    def made(self) -> tuple[str, ...]:
        """What the command may make."""
        if self.makes is not None:
            return self.makes
        words = shlex.split(self.command)
        outputs = [words[i + 1] for i, word in enumerate(words[:-1]) if word in ("-o", "--output")]
        if outputs:
            return tuple(outputs)
        if words[:1] == ["export"]:
            return tuple(words[2:3])
        return ("scene.zarr",) if words[:1] == ["estimate"] else ()


def judge(case: Case, ran: Ran, before: Snapshot, after: Snapshot) -> tuple[Outcome, str]:
    """What became of a case, and why."""
    accepted = ran.code == 0
    refused = ran.code in (REFUSED, OUT_OF_MEMORY)
    may_make = not refused and (ran.code in case.codes or 0 in case.codes)
    allowed = tuple(
        f"outer/work/{name}" for name in (*case.leaves, *(case.made if may_make else ()))
    )
    changed, new = differences(before, after, allowed)
    words = ran.err.strip().splitlines()
    tail = words[-1][:200] if words else "(no words)"
    if changed:
        return Outcome.DESTROYED, f"changed or gone: {', '.join(changed[:4])} (exit {ran.code})"
    if ran.code is None:
        return Outcome.HANG, f"not done after {case.seconds:g} s"
    if ran.code not in case.codes and (ran.code < 0 or "panicked at" in ran.err):
        return Outcome.CRASH, f"exit {ran.code}: {tail}"
    if _has_traceback(ran.err):
        return Outcome.TRACEBACK, " / ".join(words[-2:])[:300]
    if ran.code not in case.codes:
        if accepted:
            return Outcome.ACCEPTED_WRONGLY, f"exit 0: {ran.out.strip()[:120]!r}"
        if 0 in case.codes:
            return Outcome.REFUSED_WRONGLY, f"exit {ran.code}: {' / '.join(words)[:300]}"
        return Outcome.UNCLEAR, f"exit {ran.code}, expected {case.codes}: {tail}"
    if new:
        return Outcome.LEFT_OVER, f"new: {', '.join(new[:4])} (exit {ran.code})"
    missing = [phrase for phrase in case.phrases if not _said(phrase, ran.err)]
    if missing:
        if accepted:
            return Outcome.ACCEPTED_WRONGLY, f"without a word of {missing}: {tail}"
        return Outcome.UNCLEAR, f"says nothing of {missing}: {' / '.join(words)[:300]}"
    if refused:
        complaint = _message_fault(ran.err)
        if complaint:
            return Outcome.UNCLEAR, f"{complaint}: {' / '.join(words)[:300]}"
    return (Outcome.FINE if accepted else Outcome.REFUSED_WELL), tail if words else ""


def _said(phrase: str, words: str) -> bool:
    flat = " ".join(words.split()).casefold()
    return any(part.casefold() in flat for part in phrase.split("|"))


def _has_traceback(err: str) -> bool:
    # The command line prints an unforeseen exception in one line.
    signs = ("Traceback (most", "Exception ignored", "panicked at", "internal error: ")
    return any(sign in err for sign in signs)


def _message_fault(err: str) -> str | None:
    """What is wrong with the words of a refusal: one error, and a line with a hint."""
    if err.count("error: ") != 1:
        return f"{err.count('error: ')} messages"
    after = err[err.index("error: ") :].splitlines()[1:]
    if not any(re.match(r"\s{2}\S", line) for line in after):
        return "no hint"
    return None
