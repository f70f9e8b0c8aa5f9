"""Files that are for their user alone, as the memory of a robot, which may hold the fleet's secrets.

Windows has no modes: there the folders of a user's profile are closed to others by their access
lists, so nothing is done. File systems as FAT keep none either, and show the same ones for all files.
"""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

OWNER: Final = 0o600
OTHERS: Final = 0o077
MODES: Final = hasattr(os, "geteuid")


class Narrowed(NamedTuple):
    """Files that others could use, and can or cannot any more."""

    closed: tuple[Path, ...]  # others could read or write them until now
    open: tuple[Path, ...]  # others still can: the file system keeps no modes

    def __str__(self) -> str:
        """For a person; empty if there is nothing to say."""
        said = []
        if self.closed:
            said.append(f"{_named(self.closed)}: others could read it; now only its user can")
        if self.open:
            said.append(f"{_named(self.open)}: others may read it: this file system keeps no modes")
        return "; ".join(said)


def _named(paths: tuple[Path, ...]) -> str:
    more = len(paths) - 1
    return f"{paths[0]} and {more} more" if more else str(paths[0])


def make_private(path: Path) -> None:
    """Make the file if there is none, also where a link leads, so that no byte of it is ever readable by
    others. What cannot be made is found by who opens it."""
    with suppress(OSError):
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        os.close(os.open(os.path.realpath(path), flags, OWNER))


def narrow(paths: Iterable[Path]) -> Narrowed:
    """Take the rights of others from those of these files that there are.

    Raises OSError for a file of another user whose rights cannot be changed."""
    closed: list[Path] = []
    still_open: list[Path] = []
    for path in paths if MODES else ():
        with suppress(FileNotFoundError):
            if not path.stat().st_mode & OTHERS:
                continue
            with suppress(PermissionError):
                path.chmod(OWNER)
            found = path.stat()
            if not found.st_mode & OTHERS:
                closed.append(path)
            elif found.st_uid == os.geteuid():
                still_open.append(path)
            else:
                raise OSError(
                    f"{path}: others may read it, and it is another user's: chmod 600 {path}"
                )
    return Narrowed(tuple(closed), tuple(still_open))
