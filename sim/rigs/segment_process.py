"""One segment of a fleet as a process: a server and its robots in real time, orders as lines of
JSON.

For tests and benches with real gateways between real processes: `headland bridge` attaches to the
server as to any bus. The robots are whole peers without bodies, and their zero commands are timed.
All times are microseconds of the machine's monotonic clock, which all processes of one machine
share.

    -> {"do": "press", "slot": 0}        <- {"pressed_us": ...}
    -> {"do": "halts"}                   <- {"halts": {"0": ...}}, first zero command since "arm"
    -> {"do": "state"}                   <- robots that stand or are alone, and the sections
"""

import asyncio
import json
import sys
from random import Random
from typing import Any

from agent.interface.effects import Drive, Effect
from agent.peer.inputs import ClaimSection, Finish, Press
from agent.runtime.gc_tuning import freeze_gc
from agent.runtime.peer_factory import identity_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from agent.segments.segment_area import Area
from agent.segments.segment_parts import remote_segments_of
from protocol.frames.safety_frames import Reason
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, segment
from sim.can.socketcand_server import Hub
from sim.rigs.segments_rig import FIELD_HASH, ring_area

CHANNEL = "can0"


class SegmentHost:
    """A segment with its hub and robots, which obeys orders as lines of JSON on its standard input."""

    def __init__(self, area: Area, robots: int, seed: int) -> None:
        self.area, self.seed = area, seed
        name = f"segment {area.segment}"
        self.hub = Hub(segment(name, seed=seed), CHANNEL)
        self.halts: dict[int, int] = {}
        self.runners = [self._robot(name, slot, robots) for slot in range(robots)]
        self.tasks: list[asyncio.Task[None]] = []

    def _robot(self, name: str, slot: int, robots: int) -> PeerRunner:
        identity = identity_of(name, slot, robots, FIELD_HASH, first_boot=True)
        rng = Random(f"{self.seed}/{name}/{slot}")
        peer = make_peer(identity, rng, PeerRunner.now_us(), area=self.area)

        def watch(now_us: int, effect: Effect) -> None:
            if type(effect) is Drive:
                self.halts.setdefault(slot, now_us)

        return PeerRunner(peer, CanBus(FieldBus(name)), None, None, watch)

    async def run(self, port: int) -> None:
        """Serve on `port` (0: any free one, which is printed), and answer each line of input until
        it ends."""
        await self.hub.start("0.0.0.0", port)
        freeze_gc()
        self.tasks = [asyncio.create_task(runner.run()) for runner in self.runners]
        print(json.dumps({"port": self.hub.port}), flush=True)
        reader = asyncio.StreamReader()
        loop = asyncio.get_running_loop()
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            print(json.dumps(self.obey(json.loads(line))), flush=True)
            for task in self.tasks:
                if task.done():
                    task.result()
        await self.hub.stop()

    def obey(self, order: dict[str, Any]) -> dict[str, Any]:
        """Carry out one order, named by `do`, and return what is printed as its answer. Raises
        KeyError for an order without its arguments."""
        match order["do"]:
            case "press":
                pressed_at_us = PeerRunner.now_us()
                runner = self.runners[order["slot"]]
                runner.operate(Press(Reason.PERSON_IN_FIELD))
                return {"pressed_us": pressed_at_us}
            case (
                "arm"
            ):  # every robot moves again: its stops are cleared, and it is reset and started
                self.halts.clear()
                for runner in self.runners:
                    _release(runner)
                return {}
            case "halts":
                return {"halts": self.halts}
            case "claim":
                section = int(order["section"])
                self.runners[order["slot"]].operate(ClaimSection(section, 3))
                return {}
            case "finish":
                section = int(order["section"])
                self.runners[order["slot"]].operate(Finish(section))
                return {}
        return self.state()

    def state(self) -> dict[str, Any]:
        """How many robots joined, stopped, are alone and reach other segments, and the phases of
        sections."""
        peers = [runner.peer for runner in self.runners]
        remote = [remote_segments_of(peer) for peer in peers]
        return {
            "joined": all(peer.joining.joined for peer in peers),
            "stopped": sum(peer.safety.latched for peer in peers),
            "alone": [segments.alone for segments in remote],
            "reached": remote[0].reached,
            "sections": {
                section: peers[0].allocation.phase_of(section).name
                for section in peers[0].allocation.sections()
            },
            "equal": len({peer.allocation.serialize() for peer in peers}) == 1,
        }


def _release(runner: PeerRunner) -> None:
    """Between two presses of a bench: reset immediately, without the rejoin that follows a person's
    reset."""
    safety = runner.peer.safety
    for dot in safety.stops.active:
        safety.clear_near(dot, "a bench", runner.clock())
    for far in safety.far.active:
        safety.clear_far(far)
    safety.manual_reset(runner.clock())
    safety.start(runner.clock())


def main() -> None:
    """Read the description of a segment from the first line of input, and run it until the input
    ends."""
    order = json.loads(sys.stdin.readline())
    area = ring_area(order["segment"], order["segments"], order["home"], order["shared"])

    async def run() -> None:
        await SegmentHost(area, order["robots"], order["seed"]).run(order.get("port", 0))

    asyncio.run(run())


if __name__ == "__main__":
    main()
