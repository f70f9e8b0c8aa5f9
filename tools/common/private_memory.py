"""The memory of a robot is for its user alone: after `headland keys rotate --running` or `revoke` it
holds the fleet's secrets, as a key file does."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

OWNER: Final = 0o600


def keep_private(memory: Path) -> None:
    """Call it before the memory is opened. A new file is for its user alone, and SQLite gives its logs
    the mode of the file. Files that an earlier version has left become so; those of another user stay."""
    with suppress(OSError):
        os.close(os.open(memory, os.O_WRONLY | os.O_CREAT | os.O_EXCL, OWNER))
    for path in memory.parent.glob(f"{memory.name}*"):
        with suppress(OSError):
            if path.is_file() and not path.is_symlink():
                path.chmod(OWNER)
