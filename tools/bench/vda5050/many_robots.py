"""Robots of one fleet in one process, each with a VDA 5050 vehicle as its body.

    python -m tools.bench.vda5050.many_robots SCENARIO PORT BROKER FOLDER

A robot on a machine is a process of its own. Here many share one, so that a small computer can run them.
"""

import asyncio
import sys
from pathlib import Path
from typing import Any

from agent.runtime.robot_file import RobotFile
from agent.runtime.robot_process import run_robot
from tools.run.launch_setup import robot_document, setting_of

MANUFACTURER = "Independent"
PARAMETERS: dict[str, Any] = {"stationType": "floor", "loadType": "EPAL", "duration": 0.5}


async def run(scenario: str, port: int, broker: str, folder: Path, slots: list[int]) -> None:
    """Run these robots until the process ends."""
    setting, end = setting_of(scenario, None, None, None), asyncio.Event()
    bus = {
        "interface": "socketcand", "channel": "can0",
        "options": {"host": "127.0.0.1", "port": port},
    }  # fmt: skip
    robots = []
    for slot in slots:
        document = robot_document(setting, slot, bus, folder, folder)
        options = {
            "broker": broker, "manufacturer": MANUFACTURER, "serial": f"v{slot}",
            "map": setting.scenario.name, "parameters": PARAMETERS,
        }  # fmt: skip
        document["body"] = {"plugin": "vda5050", "options": options}
        first = not (folder / f"robot{slot}.sqlite").exists()
        robots.append((RobotFile.model_validate(document), first))
    await asyncio.gather(
        *(
            run_robot(
                robot, end, first_boot=first,
                started=lambda runner: print(f"up {runner.peer.slot}", flush=True),
            )
            for robot, first in robots
        )
    )  # fmt: skip


def main() -> None:
    """The command line."""
    scenario, port, broker, folder, slots = sys.argv[1:6]
    asyncio.run(run(scenario, int(port), broker, Path(folder), [int(s) for s in slots.split(",")]))


if __name__ == "__main__":
    main()
