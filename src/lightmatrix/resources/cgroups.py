"""What Linux's control groups leave a process of memory, as containers and schedulers limit it."""

from __future__ import annotations

from pathlib import Path

# Of the groups of this process, and where their files lie; a container often sees its own group
# as the root of them, whatever name the first file has for it.
_MINE, _MOUNTED = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def memory_left() -> int | None:
    """Bytes that the tightest of the groups around this process leaves it.

    What files are cached in counts as free, as the kernel drops it first.

    Returns
    -------
    int or None
        None where nothing is limited, or no such groups are known.
    """
    try:
        lines = _MINE.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    left = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            place, names = _MOUNTED, ("memory.max", "memory.current", "")
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_")
            place = _MOUNTED / "memory"
        else:
            continue
        own = Path(path.lstrip("/"))
        for group in (own, *own.parents):
            found = _left(place / group, *names)
            if found is not None:
                left.append(found)
    return min(left, default=None)


def _left(group: Path, limit: str, used: str, prefix: str) -> int | None:
    """What one group leaves; None if it does not say, or has no limit."""
    try:
        # The second version's word for no limit, 'max', is no number either.
        most, now = (int((group / name).read_text()) for name in (limit, used))
        told = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
        cached = sum(int(told[f"{prefix}{kind}_file"]) for kind in ("inactive", "active"))
    except (OSError, ValueError, KeyError):
        return None
    return max(0, most - max(0, now - cached))
