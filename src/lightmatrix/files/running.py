"""Running results: finished parts of an output, kept in a folder beside it until it is whole.

The tiles of an estimate, the frames of a live capture and the cases of a figure are kept this way,
so that a run that was stopped continues. The folder has a marker of lines: the first says what the
folder is, each further one is the name of a file that was kept in it. Only those files are ever
replaced or removed.
"""

import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from lightmatrix.errors import OutputError, warn
from lightmatrix.files.kinds import MARKER, printable, read_object
from lightmatrix.files.writing import RUNNING, as_output_error, check_running

# The name of a file that is being written: eight random digits and its final ending.
_PART_NAME = re.compile(r"\.[0-9a-f]{8}\.part(\.[^.]*)?")


class RunningResults:
    """Files kept while an output is made, whose lock (`claimed`) the caller holds."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = []
        if (path / MARKER).is_file():
            lines = (path / MARKER).read_text(encoding="utf-8", errors="replace").split("\n")
        # The marker may come from anywhere, so names that lead out of the folder are passed over.
        names = [name for name in dict.fromkeys(lines[1:]) if name and name.isprintable()]
        self._names = [name for name in names if name == Path(name).name and name != MARKER]

    @classmethod
    def open(cls, target: Path, ending: str) -> Self:
        """Begin, or continue, the running results of an output, as `claimed` yields it.

        The folder's name is the output's and the `ending`. An OutputError says that it is not ours.
        """
        folder = check_running(target, ending)
        with as_output_error(folder):
            folder.mkdir(exist_ok=True)
            if not (folder / MARKER).exists() or not (folder / MARKER).stat().st_size:
                try:
                    (folder / MARKER).write_text(RUNNING)
                except OSError:
                    # A full disk leaves nothing behind.
                    (folder / MARKER).unlink(missing_ok=True)
                    folder.rmdir()
                    raise
        running = cls(folder)
        running._sweep()
        return running

    @classmethod
    def resume(
        cls,
        target: Path,
        ending: str,
        settings: Mapping[str, Any],
        *,
        file: str,
        key: str = "",
        contents: str,
        overwrite: bool = False,
    ) -> Self:
        """Continue results that were kept under the same settings, or begin anew.

        `settings` are all that the results depend on, as JSON. The JSON `file` keeps them under
        `key` ("": they are all of it). It is missing when results begin anew, and the caller keeps
        it before any other. Messages call the results `contents`. An OutputError refuses results of
        other settings, unless `overwrite` throws them away.
        """
        running = cls.open(target, ending)
        before: Any = running.read_object(file)
        if before is not None and key:
            before = before.get(key)
        if before == settings:
            return running
        if not overwrite and any(name != file for name in running.names):
            differences = "unknown settings"
            if isinstance(before, Mapping):
                differences = setting_differences(before, settings)
            raise OutputError(
                f"{running.path}: holds {contents} ({differences})",
                hint="continue with those settings, pass overwrite=True to begin anew, or choose "
                "another output",
            )
        running.discard()
        return cls.open(target, ending)

    @property
    def names(self) -> list[str]:
        """Names of the files that are kept, in the order in which they were listed."""
        return [name for name in self._names if self.file(name).is_file()]

    def file(self, name: str) -> Path:
        """Where a kept file lies, or would lie."""
        return self.path / name

    def has(self, name: str) -> bool:
        """Whether a file of that name is kept."""
        return name in self._names and self.file(name).is_file()

    def read_object(self, name: str) -> dict[str, Any] | None:
        """The JSON object of a kept file; None if there is none that can be read."""
        return read_object(self.file(name)) if self.has(name) else None

    @contextmanager
    def keep(self, name: str) -> Iterator[Path]:
        """Write a file at a temporary path with the same ending, kept as `name` on success."""
        file = self.file(name)
        with as_output_error(file):
            if name not in self._names:
                if os.path.lexists(file):
                    hint = "move it elsewhere"
                    raise OutputError(f"{file}: was not written by lightmatrix", hint=hint)
                with (self.path / MARKER).open("a", encoding="utf-8") as marker:
                    # The line break comes first, so that a line that a full disk cut off spoils no
                    # other.
                    marker.write(f"\n{name}")
                self._names.append(name)
            part = file.with_name(f".{secrets.token_hex(4)}.part{file.suffix}")
            try:
                yield part
                with part.open("rb+") as written:
                    os.fsync(written.fileno())
                os.replace(part, file)
            finally:
                part.unlink(missing_ok=True)

    def forget(self, name: str) -> None:
        """Remove a kept file, if it is there."""
        if name in self._names:
            self.file(name).unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove what was kept, and the folder if nothing else is in it."""
        with suppress(OSError):
            for name in self._names:
                self.file(name).unlink(missing_ok=True)
            self._sweep()
            foreign = sorted(set(os.listdir(self.path)) - {MARKER})
            if not foreign:
                (self.path / MARKER).unlink()
                self.path.rmdir()
                return
            warn(
                f"{self.path}: not removed, it holds {printable(foreign[0])}, "
                "which was not written by lightmatrix"
            )

    def _sweep(self) -> None:
        """Remove files that killed processes left half-written."""
        for entry in os.listdir(self.path):
            if _PART_NAME.fullmatch(entry):
                (self.path / entry).unlink(missing_ok=True)


def setting_differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What differs between two sets of settings, such as "exposure was 0.01, is 0.02"."""
    words = []
    for key in sorted({*before, *now}):
        old, new = before.get(key), now.get(key)
        if old == new:
            continue
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            words.append(f"the {key}: {setting_differences(old, new)}")
        elif any(re.fullmatch(r"[0-9a-f]{16,}", str(value)) for value in (old, new)):
            # Digests tell a reader nothing.
            words.append(f"different {key}")
        else:
            old, new = ("not given" if value is None else value for value in (old, new))
            words.append(f"{key} was {old}, is {new}")
    return "; ".join(words)
