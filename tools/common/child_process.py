"""A process of ours that is started as a module of this very installation.

`python -m` searches the working folder first, where a person may have a `tools` or an `agent` of their
own. `-P` excludes that folder.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Final

PREFIX = __name__.removesuffix("tools.common.child_process")  # in a wheel: `headland.`
AGAIN_S: Final = (
    5.0  # from one signal to end to the next; a process that ends takes a second or two
)
ROOT = Path(__file__).resolve().parents[__name__.count(".")]  # the folder that imports begin at


def module_command(module: str) -> list[str]:
    """The words that start it; its own arguments follow. `module`: named as in a checkout."""
    start = (
        f"import runpy, sys; sys.path.append({str(ROOT)!r}); "
        f"runpy.run_module({PREFIX + module!r}, run_name='__main__', alter_sys=True)"
    )
    return [sys.executable, "-P", "-c", start]


def politely(nice: int) -> Callable[[], object] | None:
    """What a child does before it begins, so that others go first. None on Windows, which has neither
    niceness nor a moment between fork and exec."""
    return (lambda: os.nice(nice)) if hasattr(os, "nice") else None


def end_with_input() -> None:
    """End this process by SIGTERM when the process that started it closes the pipe of its input, or is
    gone. Nothing may be written into that pipe."""

    def wait() -> None:
        os.read(sys.stdin.fileno(), 1)
        while True:  # a signal that comes while its handlers change may end nothing
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(AGAIN_S)

    Thread(target=wait, daemon=True).start()
