"""A case: the fault, the command, and what must hold; and the judgement on a run."""

from __future__ import annotations

import os
import re
import shlex
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from .run import Limits, Ran, SkipError, run

# Exit codes of the command line.
REFUSED, OUT_OF_MEMORY, INTERRUPTED = 2, 3, 130

# Puts a fault into the work folder; its result is ignored.
Prepare = Callable[[Path], object]
# Checks the work folder after the run: what is wrong, or None.
Check = Callable[[Path, Ran], str | None]
# Runs commands in the work folder.
Scenario = Callable[[Path], Ran]
# Path relative to the root -> kind and content.
Snapshot = dict[str, tuple[str, bytes]]


@dataclass(frozen=True)
class Case:
    """One fault, in unique words, and the command line after `lightmatrix` that must bear it."""

    name: str
    command: str = ""
    # Words that the message must hold, in any case; all of several. A `|` separates alternatives.
    says: str | tuple[str, ...] = ()
    # Puts the fault into a fresh work folder.
    prepare: Prepare = lambda folder: None
    # Permitted exit codes.
    code: int | tuple[int, ...] = REFUSED
    # What the command may make or change in the work folder unless it is refused; None: its -o or
    # --output (or second word, for export). And what may be new even then, such as finished tiles.
    makes: tuple[str, ...] | None = None
    leaves: tuple[str, ...] = ()
    # What else must hold, and a command that must work afterwards.
    check: Check | None = None
    then: str | None = None
    # What runs in place of the command, and what the system gives it.
    scenario: Scenario | None = None
    limits: Limits | None = None

    def __str__(self) -> str:
        return self.name

    @property
    def codes(self) -> tuple[int, ...]:
        """Permitted exit codes."""
        return (self.code,) if isinstance(self.code, int) else self.code

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


def bear(case: Case, place: Path) -> None:
    """Put a case's fault into a work folder, run its command there, and judge."""
    if complaint := complaint_of(case, place):
        # Where in this file it was noticed is of no interest.
        pytest.fail(f"{case.name}; `{case.command}`: {complaint}", pytrace=False)


def complaint_of(case: Case, place: Path) -> str | None:
    """What is wrong with how a command bears a fault, or None."""
    try:
        case.prepare(place)
        before = snapshot(place.parents[1])
        ran = case.scenario(place) if case.scenario else run(case.command, place, case.limits)
    except SkipError as reason:
        pytest.skip(str(reason))
    complaint = judge(case, ran, before, snapshot(place.parents[1]))
    if complaint is None and case.check is not None:
        complaint = case.check(place, ran)
    if complaint is None and case.then is not None:
        second = run(case.then, place)
        if second.code != 0:
            complaint = f"afterwards `{case.then}`: exit {second.code}, {second.err}"
    return complaint


def judge(case: Case, ran: Ran, before: Snapshot, after: Snapshot) -> str | None:
    """What is wrong with a run, or None."""
    refused = ran.code in (REFUSED, OUT_OF_MEMORY)
    may_make = not refused and (ran.code in case.codes or 0 in case.codes)
    allowed = tuple(
        f"outer/work/{name}" for name in (*case.leaves, *(case.made if may_make else ()))
    )
    changed, new = differences(before, after, allowed)
    did = f"(exit {ran.code}, out {ran.out.strip()[:200]!r})\n{ran.err.strip()[:2000]}"
    if changed:
        return f"changed or gone: {', '.join(changed[:4])} {did}"
    if ran.code is None:
        return f"it hangs {did}"
    # The command line prints an unforeseen exception in one line.
    signs = ("Traceback (most", "Exception ignored", "panicked at", "internal error: ")
    if any(sign in ran.err for sign in signs):
        return f"it crashes {did}"
    if ran.code not in case.codes:
        return f"another exit code than {case.codes} {did}"
    if new:
        return f"left over: {', '.join(new[:4])} {did}"
    flat = " ".join(ran.err.split()).casefold()
    for phrase in (case.says,) if isinstance(case.says, str) else case.says:
        if not any(part.casefold() in flat for part in phrase.split("|")):
            return f"says nothing of {phrase!r} {did}"
    if refused:
        if ran.err.count("error: ") != 1:
            return f"{ran.err.count('error: ')} messages {did}"
        if not re.search(r"error: .*\n(.*\n)*?  \S", f"{ran.err}\n"):
            return f"no hint {did}"
    return None


def snapshot(root: Path) -> Snapshot:
    """Every file, folder, link, pipe, socket and device below a folder."""
    entries: Snapshot = {}
    pending = [root]
    while pending:
        for entry in os.scandir(pending.pop()):
            state = entry.stat(follow_symlinks=False)
            path = Path(entry.path)
            name = str(path.relative_to(root))
            if stat.S_ISDIR(state.st_mode):
                entries[name] = ("folder", b"")
                pending.append(path)
            elif stat.S_ISLNK(state.st_mode):
                entries[name] = ("link", os.fsencode(os.readlink(path)))
            elif stat.S_ISREG(state.st_mode):
                # The start tells bombs apart as well as the whole does.
                with path.open("rb") as opened:
                    entries[name] = ("file", opened.read(1 << 20) + state.st_size.to_bytes(8))
            else:
                entries[name] = (oct(stat.S_IFMT(state.st_mode)), str(state.st_rdev).encode())
    return entries


def differences(
    before: Snapshot, after: Snapshot, allowed: tuple[str, ...]
) -> tuple[list[str], list[str]]:
    """Names that were changed or are gone, and names that are new; those allowed left out.

    A folder that is allowed covers what is in it, a new parent of something allowed is allowed.
    """
    covered = [os.path.normpath(name) for name in allowed]

    def free(name: str) -> bool:
        return any(
            name == one or name.startswith(one + "/") or one.startswith(name + "/")
            for one in covered
        )

    changed = [n for n, what in before.items() if after.get(n) != what and not free(n)]
    new = [n for n in after if n not in before and not free(n)]
    return sorted(changed), sorted(new)
