"""Files that are for their user alone: key files, and the memory of a robot, which may hold the secrets.

Windows has no modes: there the folders of a user's profile are closed to others by their access
lists, so nothing is done. File systems as FAT keep none either, and show the same ones for all files.
"""

import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

try:
    import grp
    import pwd
except ImportError:  # Windows
    pass

OWNER: Final = 0o600
OTHERS: Final = 0o077
MODES: Final = hasattr(os, "geteuid")


def trusted_users() -> frozenset[int]:
    """The users whose files may steer this program, as for ssh: its own user and root, which can do
    anything; under sudo also those of the user that called it."""
    user = os.geteuid()
    called_by = os.environ.get("SUDO_UID", "") if user == 0 else ""
    return frozenset((0, user, int(called_by) if called_by.isdecimal() else user))


def weakness(path: Path) -> str:
    """Why others may read or replace this file, and what to do about it; empty: only its user can.

    A link is as weak as its own place and the place that it leads to. Raises OSError."""
    found = path.stat()
    if found.st_mode & OTHERS:
        return f"others may read it: chmod 600 {path}, and consider new keys"
    if not MODES:
        return ""
    users = trusted_users()
    if found.st_uid not in users:
        return f"it belongs to user {found.st_uid}: give it to the user of this program with chown"
    for start in dict.fromkeys((path.absolute(), path.resolve())):
        for folder in start.parents:
            above = folder.stat()
            if above.st_uid not in users:
                return (
                    f"user {above.st_uid} owns {folder} and may replace it: move it, or use chown"
                )
            writers = above.st_mode & 0o022
            if folder != start.parent and writers == stat.S_IWGRP and _is_own_group(above.st_gid):
                continue
            if writers and not above.st_mode & stat.S_ISVTX:
                return f"others may replace it: chmod go-w {folder}"
    return ""


def _is_own_group(group: int) -> bool:
    """Whether it is the group that a user has alone, as Debian and Fedora make them: folders of such
    users are often writable by it."""
    try:
        user, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return user.pw_gid == group and found.gr_name == user.pw_name and not found.gr_mem


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
    others. What cannot be made is found when it is opened."""
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
