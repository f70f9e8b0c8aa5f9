"""The keys that a launch makes for its own fleet, and tools that use them without being told.

A launch with neither `--keys` nor `--no-keys` keeps both key files in the folder of its fleet. Tools
on the bus of that launch take them if the person who calls them owns both the launch and the folder,
and nobody else can open that folder. All other people hold no key of that fleet.
"""

import contextlib
import shlex
import stat
from errno import ELOOP
from pathlib import Path
from typing import Any

from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_json
from agent.runtime.files.key_file import DEVICE, FLEET, NAMES, OPERATOR, fresh, write
from tools.common.bus_address import LAUNCH, is_at
from tools.common.file_owner import is_own, is_private
from tools.common.run_folder import FolderError

KEYS = "keys"  # the folder in that of a fleet, and its name in bus.json
MADE = "made_by_launch"  # a file beside the keys that a launch made: a later one may replace them


def fleet_keys(folder: Path, goes_on: bool, robots: int = 0) -> Path:
    """The folder of a fleet's own key files: those that it had, or new ones, one for each robot.

    `goes_on`: whether the fleet was launched before and keeps what it has. Keys that no launch has made
    are those of machines, and nothing else can release these: they are never replaced.
    Raises FolderError where such keys are there, and OSError.
    """
    keys = folder / KEYS
    if keys.is_symlink():  # what is behind it is not ours to empty
        raise OSError(ELOOP, f"{keys} is a link", str(keys))
    files = [keys / NAMES[kind] for kind in (FLEET, OPERATOR)]
    keys.mkdir(mode=0o700, exist_ok=True)
    if goes_on and all(file.exists() for file in files):
        keys.chmod(0o700)
        return keys
    if any(keys.iterdir()) and not (keys / MADE).exists():
        raise FolderError(
            f"{keys} holds keys that no launch has made; choose another folder with --out, or let this "
            f"fleet have them with --keys {shlex.quote(str(keys))}"
        )
    keys.chmod(0o700)
    (keys / MADE).touch()
    for old in keys.iterdir():  # of a fleet whose work is done
        if old.name != MADE:
            old.unlink()
    write(files[0], files[1], fresh(), DEVICE, range(robots))
    return keys


def keys_in(launch: Path, where: dict[str, Any]) -> Path | None:
    """The folder of keys that a running launch names; None where it has none, or not for this user.

    `launch`: the file in which it says where its bus is. `where`: what is in it.
    """
    named = where.get(KEYS)
    if not isinstance(named, str):
        return None
    with contextlib.suppress(OSError):
        ours = is_own(launch) and not launch.stat().st_mode & stat.S_IWGRP
        if ours and is_private(Path(named)):
            return Path(named)
    return None


def own_keys(interface: str, host: str, port: int) -> Path | None:
    """The keys of the newest launch here, if this is its bus. None: it is another bus, or `keys_in`
    finds none."""
    try:
        where = dict(read_json(LAUNCH, SETTINGS_BYTES_MAX))
        same = port == 0 or is_at(where, host, port)
    except (GivenFileError, KeyError, TypeError, ValueError):
        return None
    return keys_in(LAUNCH, where) if interface == "socketcand" and same else None
