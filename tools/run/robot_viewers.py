"""`--metrics` and `--foxglove` of one robot: served by a process beside it, which only listens.

A robot decides in time or stands. So nothing that people ask for is computed in its own process: a
viewer of everything, and a program that fails while it serves, cost the robot nothing. The process has
a lower priority, opens the bus a second time, sends nothing there, and ends with the robot.

    {"bus": {...}, "slot": 2, "robot": 4711, "metrics": "9464", "foxglove": 8765}   # on stdin
"""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

from agent.runtime.end_signals import on_closed_input, on_end
from agent.runtime.robot_file import RobotBusTable, RobotError, RobotFile
from agent.runtime.robot_process import opened_bus
from protocol.frames.frame import Frame
from tools.common.child_process import module_command, politely
from tools.common.exit_codes import wrong
from tools.inspect.metrics_address import MetricsError, metrics_address
from tools.livemap.foxglove_port import PortTaken, check_port

NICE = 5  # the robot goes first
END_FOR_S = 5.0


def check_viewers(metrics: str | None, foxglove: int | None) -> None:
    """Raises RobotError where a port is taken, or a package is not installed."""
    try:
        if metrics is not None:
            metrics_address(metrics)
        if foxglove is not None:
            check_port(foxglove)
    except (MetricsError, PortTaken) as problem:
        raise RobotError(str(problem)) from None


@contextlib.contextmanager
def viewers_beside(
    declared: RobotFile, metrics: str | None, foxglove: int | None
) -> Iterator[None]:
    """The process that serves them, as long as the robot runs; none where neither is asked for."""
    if metrics is None and foxglove is None:
        yield
        return
    told = {
        "bus": declared.bus.model_dump(), "slot": declared.robot.slot, "robot": os.getpid(),
        "metrics": metrics, "foxglove": foxglove,
    }  # fmt: skip
    process = subprocess.Popen(
        module_command("tools.run.robot_viewers"), stdin=subprocess.PIPE, text=True,
        start_new_session=True,  # the terminal's Ctrl-C is for the robot, which says farewell first
        preexec_fn=politely(NICE),
    )  # fmt: skip
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # it has ended, and has said why
        process.stdin.write(json.dumps(told) + "\n")
        process.stdin.flush()
    try:
        yield
    finally:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(END_FOR_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


async def serve(told: dict[str, Any]) -> None:
    """Until the robot is gone: then the pipe on stdin is at its end. Raises RobotError, MetricsError
    and PortTaken."""
    slot, robot = int(told["slot"]), int(told["robot"])
    end, loop = asyncio.Event(), asyncio.get_running_loop()
    on_end(loop, end.set)
    on_closed_input(loop, end.set)
    hearing: list[Callable[[float, Frame], None]] = []
    with contextlib.ExitStack() as stack:
        if told["metrics"] is not None:
            from tools.inspect.measured_inspector import MeasuredInspector
            from tools.inspect.prometheus_metrics import (
                FleetCollector,
                MetricsServer,
                RobotProcesses,
            )

            inspector = MeasuredInspector(frozenset(), int(told["bus"]["bitrate"]))
            server = MetricsServer(metrics_address(told["metrics"]))
            FleetCollector(inspector, loop.time, server.registry)
            RobotProcesses(lambda: [slot], lambda: {slot: robot}, server.registry)
            print(f"metrics: {server.start()}", flush=True)
            stack.callback(server.close)
            hearing.append(inspector.hear)
        if told["foxglove"] is not None:
            from tools.livemap.foxglove_live import start_feed

            feed = start_feed(None, told["foxglove"], ())
            print(f"foxglove: {feed.url}", flush=True)
            stack.callback(feed.close)
            hearing.append(feed.hear)
        bus = await opened_bus(RobotBusTable.model_validate(told["bus"]), slot)
        stack.callback(bus.close)

        def heard(frame: Frame) -> None:
            for hear in hearing:
                hear(loop.time(), frame)

        bus.subscribe(heard)
        await end.wait()


def main() -> None:
    """Read what to serve from the first line of input. What is wrong is one line, and an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    told = json.loads(sys.stdin.readline())
    try:
        asyncio.run(serve(told))
    except (RobotError, MetricsError, PortTaken) as problem:
        sys.exit(wrong(problem))


if __name__ == "__main__":
    main()
