"""Run as a script by `test_robot_process.py`: robots in one process, with a body that is written here.

    python robots_without_simulator.py FOLDER INTERFACE CHANNEL ROBOTS SLOT...

Prints what they have reached as JSON: addresses, members, finished sections, modules of the simulator.
"""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from agent.interface.config import ACTUATOR_TTL_US
from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation
from agent.runtime.peer_runner import PeerRunner
from agent.runtime.robot_body import RobotBody
from agent.runtime.robot_file import RobotFile
from agent.runtime.robot_process import run_robot
from crdt import Phase

LIMIT_S, LOOK_S = 90.0, 0.1
STARTS_M = ((-7.0, -5.0), (-6.0, -5.0), (-5.0, -5.0))  # in the headland, in nobody's way


class PointBody(RobotBody):
    """A point that moves exactly as it is told."""

    def __init__(self, slot: int, x_m: float, y_m: float) -> None:
        self.x_m, self.y_m, self.command, self.since_us, self.until_us = x_m, y_m, HALT, 0, 0

    def _move(self, now_us: int) -> None:
        for_s = max(0, min(now_us, self.until_us) - self.since_us) / 1e6
        self.x_m += self.command.vx_m_s * for_s
        self.y_m += self.command.vy_m_s * for_s
        self.since_us = now_us
        if now_us >= self.until_us:
            self.command = HALT

    def sense(self, now_us: int) -> Observation | None:
        self._move(now_us)
        vx_m_s, vy_m_s = self.command.vx_m_s, self.command.vy_m_s
        return Observation(self.x_m, self.y_m, 0.0, vx_m_s, vy_m_s, sensed_at_us=now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        self._move(now_us)
        self.command, self.until_us = command, now_us + ACTUATOR_TTL_US


def document(slot: int, robots: int, interface: str, channel: str) -> dict[str, Any]:
    x_m, y_m = STARTS_M[slot]
    return {
        "name": "tiny", "robot": {"slot": slot}, "fleet": {"robots": robots, "radius_m": 0.3},
        "field": {"file": "tiny.geojson"}, "bus": {"interface": interface, "channel": channel},
        "body": {"factory": "__main__:PointBody", "options": {"x_m": x_m, "y_m": y_m}},
    }  # fmt: skip


async def work(folder: Path, interface: str, channel: str, robots: int, slots: list[int]) -> Any:
    end, runners = asyncio.Event(), list[PeerRunner]()
    loop = asyncio.get_running_loop()

    members = dict.fromkeys(slots, 0)  # slot -> most live members that it has seen

    def look() -> None:
        peers = [runner.peer for runner in runners]
        for peer in peers:
            members[peer.slot] = max(members[peer.slot], len(peer.membership.live))
        if set(members.values()) == {robots} and all(
            all(peer.allocation.phase_of(s) is Phase.DONE for s in peer.progress.units)
            for peer in peers
        ):
            end.set()
        else:
            loop.call_later(LOOK_S, look)

    files = [
        RobotFile.of(document(slot, robots, interface, channel), "tiny", folder) for slot in slots
    ]
    look()
    try:
        async with asyncio.timeout(LIMIT_S):
            await asyncio.gather(
                *(run_robot(file, end, first_boot=True, started=runners.append) for file in files)
            )
    except TimeoutError:
        for runner in runners:
            print(runner.peer.slot, runner.peer.state, members, file=sys.stderr)
        raise
    return {
        "addresses": [runner.peer.address for runner in runners],
        "members": [*members.values()],
        "done": [runner.peer.allocation.done_count() for runner in runners],
        "foreign": sorted(
            name for name in sys.modules if name.split(".")[0] in ("sim", "tools", "pymunk")
        ),
    }


if __name__ == "__main__":
    where, kind, place, count, *own = sys.argv[1:]
    print(json.dumps(asyncio.run(work(Path(where), kind, place, int(count), [*map(int, own)]))))
