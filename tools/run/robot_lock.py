"""The lock that a robot of a launch holds until its process ends.

Robots of a launch that was killed brake, say farewell and end by themselves. Until then their journals
are open, and no second process can open them.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from agent.interface.config import LEAVES_WITHIN_US, S
from agent.runtime.files.file_lock import lock
from tools.common.run_folder import FolderError

# A robot without a body leaves after `LEAVES_WITHIN_US`; the rest is for a machine that is busy.
LEFT_WITHIN_S = LEAVES_WITHIN_US / S + 10.0
LOOK_S = 0.05


def hold(folder: Path, slot: int) -> IO[str]:
    """The lock of one robot, held until the file is closed or the process has ended.

    Raises OSError where the file cannot be written."""
    file = (folder / f"robot{slot}.lock").open("w")
    lock(file, wait=False)
    return file


def until_left(folder: Path, told: Callable[[str], object]) -> None:
    """Wait for the robots of an earlier launch in this folder; `told` gets a line if there are any.

    Raises FolderError if one has not ended after `LEFT_WITHIN_S`, and OSError."""
    if not (running := _running(folder)):
        return
    told(f"waits for robots {running} of the launch before, which was killed")
    end_s = time.monotonic() + LEFT_WITHIN_S
    while running := _running(folder):
        if time.monotonic() >= end_s:
            raise FolderError(
                f"robots {running} of an earlier launch in {folder} have not ended: end their "
                "processes, or choose another folder with --out"
            )
        time.sleep(LOOK_S)


def _running(folder: Path) -> str:
    """Slots of robots that still run, with blanks between them."""
    slots = []
    for path in folder.glob("robot*.lock"):
        with path.open("r+") as file:
            if not lock(file, wait=False):
                slots.append(path.stem.removeprefix("robot"))
    return " ".join(sorted(slots, key=int))
