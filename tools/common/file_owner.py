"""Whose a file is. What another user may have written is not believed, and what others may read is no
secret."""

import os
import stat
from pathlib import Path

# Windows has no numbers of users, and modes there say nothing: no file is then private.
USER = os.getuid() if hasattr(os, "getuid") else -1


def is_private(path: Path, user: int | None = None) -> bool:
    """Whether a file or folder is this user's, and nobody else may read or write it."""
    try:
        found = path.stat()
    except OSError:
        return False
    return found.st_uid == (USER if user is None else user) and not found.st_mode & 0o077


def is_own(path: Path) -> bool:
    """Whether a file is this user's, and not everybody may write it. A file that is not there is
    nobody's. On Windows all are."""
    try:
        found = path.stat()
    except OSError:
        return False
    return USER < 0 or (found.st_uid == USER and not found.st_mode & stat.S_IWOTH)
