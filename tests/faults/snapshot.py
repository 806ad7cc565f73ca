"""What lies in a folder, bit for bit: to see afterwards what was changed and what is new."""

from __future__ import annotations

import os
import stat
from pathlib import Path

# Path relative to the root -> kind and content.
Snapshot = dict[str, tuple[str, bytes]]


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
    before: Snapshot, after: Snapshot, allowed: tuple[str, ...] = ()
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
