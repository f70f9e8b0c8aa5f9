"""A robot of a launch: `agent/runtime/robot_process.py`, told what it is by one line of JSON on stdin.

It ends on SIGTERM (with a graceful leave), and when the launcher is gone for any reason, because then
the pipe on its stdin is at its end.

    {"robot": {...}, "first_boot": true}        # the values of agent.runtime.robot_file.RobotFile
"""

import asyncio
import json
import signal
import sys
from pathlib import Path
from typing import Any

from agent.runtime.ready_kernels import use_ready_kernels

use_ready_kernels()  # before anything is imported that has kernels

from agent.runtime.end_signals import on_closed_input, on_end
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_file import DriverError, RobotError, RobotFile
from agent.runtime.robot_process import WRONG, run_robot
from tools.run.robot_lock import hold


async def run(order: dict[str, Any]) -> None:
    """Run one robot as the order describes it, until the process is told to end. Raises RobotError
    if its lock or its journal cannot be opened."""
    robot = RobotFile.of(order["robot"], "robot", Path())
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    on_end(loop, end.set, (signal.SIGTERM,))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the launcher decides
    on_closed_input(loop, end.set)

    def started(runner: PeerRunner) -> None:
        print(f"robot {runner.peer.slot} is up", flush=True)

    slot = robot.robot.slot
    try:
        held = hold(robot.folder / robot.robot.journal, slot)
    except OSError as problem:
        raise RobotError(f"robot {slot}: its journal cannot be opened: {problem}") from None
    with held:
        await run_robot(robot, end, first_boot=bool(order["first_boot"]), started=started)


def main() -> None:
    """Read the order from the first line of input and run the robot. A RobotError is one line, and
    an exit code."""
    order = json.loads(sys.stdin.readline())
    try:
        asyncio.run(run(order))
    except DriverError:
        raise  # of our own body: the log of the launch has its traceback
    except RobotError as problem:
        print(problem, file=sys.stderr)
        sys.exit(WRONG)


if __name__ == "__main__":
    main()
