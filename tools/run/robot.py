"""A robot of a launch: `agent/runtime/robot_process.py`, told what it is by one line of JSON on stdin.

It ends on SIGTERM (with a graceful leave), and when the launcher is gone for any reason, because then
the pipe on its stdin is at its end.

    {"robot": {...}, "first_boot": true}        # the values of agent.runtime.robot_file.RobotFile
"""

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

from agent.runtime.ready_kernels import use_ready_kernels

use_ready_kernels()  # before anything is imported that has kernels

from agent.runtime.end_signals import on_end
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_file import RobotError, RobotFile
from agent.runtime.robot_process import WRONG, run_robot


async def run(order: dict[str, Any]) -> None:
    """Run one robot as the order describes it, until the process is told to end. Raises RobotError
    if its journal cannot be opened."""
    robot = RobotFile.of(order["robot"], "robot", Path())
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    on_end(loop, end.set, (signal.SIGTERM,))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the launcher decides
    _on_closed_input(loop, end.set)

    def started(runner: PeerRunner) -> None:
        print(f"robot {runner.peer.slot} is up", flush=True)

    await run_robot(robot, end, first_boot=bool(order["first_boot"]), started=started)


def _on_closed_input(loop: asyncio.AbstractEventLoop, end: Callable[[], object]) -> None:
    """Call `end` when the launch is gone: it writes no more, so a readable pipe is a closed one."""
    try:
        loop.add_reader(sys.stdin, end)
    except NotImplementedError:  # the loop of Windows reads no pipes

        def wait() -> None:
            os.read(sys.stdin.fileno(), 1)
            with contextlib.suppress(RuntimeError):  # the loop is closed: the robot has ended
                loop.call_soon_threadsafe(end)

        Thread(target=wait, daemon=True).start()


def main() -> None:
    """Read the order from the first line of input and run the robot. A RobotError is one line, and
    an exit code."""
    order = json.loads(sys.stdin.readline())
    try:
        asyncio.run(run(order))
    except RobotError as problem:
        print(problem, file=sys.stderr)
        sys.exit(WRONG)


if __name__ == "__main__":
    main()
