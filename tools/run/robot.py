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

from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_file import RobotError, RobotFile
from agent.runtime.robot_process import WRONG, run_robot


async def run(order: dict[str, Any]) -> None:
    """Run until the launcher ends it. Raises RobotError."""
    robot = RobotFile.of(order["robot"], "robot", Path())
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    loop.add_signal_handler(signal.SIGTERM, end.set)
    loop.add_signal_handler(signal.SIGINT, lambda: None)  # the launcher decides
    loop.add_reader(sys.stdin, end.set)  # nothing more is ever written: readable means the end

    def started(runner: PeerRunner) -> None:
        print(f"robot {runner.peer.slot} is up", flush=True)

    await run_robot(robot, end, first_boot=bool(order["first_boot"]), started=started)


def main() -> None:
    """Exit code `WRONG` with one line on stderr if the robot cannot start."""
    order = json.loads(sys.stdin.readline())
    try:
        asyncio.run(run(order))
    except RobotError as problem:
        print(problem, file=sys.stderr)
        sys.exit(WRONG)


if __name__ == "__main__":
    main()
