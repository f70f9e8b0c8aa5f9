"""Which process wrote a file, and whether it still lives: a number alone may belong to another by now."""

import os
from pathlib import Path


def started(pid: int) -> str:
    """When the process was started, as the system counts; empty where it does not live or tell.

    Clock ticks since boot: field 22 of Linux's /proc/PID/stat.
    """
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


def identity() -> dict[str, object]:
    """Of this process, for a file that others read."""
    return {"pid": os.getpid(), "started": started(os.getpid())}


def lives(pid: int, since: str) -> bool:
    """The process that was started then. `since` empty: any of this number."""
    if os.name == "nt":  # there, asking with a signal would end it
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):  # another user's
        return not since or started(pid) == since
    return not since or started(pid) in ("", since)
