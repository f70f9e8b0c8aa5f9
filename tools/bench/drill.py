"""A squad of drilling peers (`sim/world/protocol_drill.py`) on asyncio's loop, for figures about
the bus."""

import asyncio
import itertools
from random import Random

import numpy as np

from agent.interface.motion_controller import BodyLimits
from agent.motion.holonomic_motion import HolonomicMotion
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, Segment, forget, segment
from sim.fleet.simulated_disk import MemoryJournal
from sim.world.protocol_drill import SPEED_M_S, Drill, Place

NO_FENCES = np.zeros((0, 4))

_numbers = itertools.count()


class ProtocolFleet:
    """N such peers in one virtual loop. Make it inside of `run_virtual`."""

    def __init__(self, robots: int, seed: int, sections: int | None = None) -> None:
        self.channel = f"drill {next(_numbers)}"
        self.segment: Segment = segment(self.channel, seed=seed)
        self.bodies = [Place(slot) for slot in range(robots)]
        self.shells: list[PeerRunner] = []
        sections = sections or 8 * robots
        for slot, body in enumerate(self.bodies):
            identity = identity_of("drill", slot, robots, 1, first_boot=True)
            motion = HolonomicMotion(slot, BodyLimits(0.5, SPEED_M_S, 1.0), NO_FENCES)
            mission = Drill(slot, robots, sections)
            rng = Random(f"{seed}/drill/{slot}")
            parts = MissionParts(mission, motion)
            peer = make_peer(identity, rng, PeerRunner.now_us(), parts=parts)
            self.shells.append(
                PeerRunner(peer, CanBus(FieldBus(self.channel)), body, MemoryJournal())
            )
        self.tasks = [asyncio.create_task(shell.run()) for shell in self.shells]

    async def until_working(self, limit_s: float = 60.0) -> bool:
        """Whether all peers are WORKING within `limit_s` of virtual time."""
        loop = asyncio.get_running_loop()
        while loop.time() < limit_s:
            await asyncio.sleep(0.5)
            if all(shell.peer.state.name == "WORKING" for shell in self.shells):
                return True
        return False

    def node_of(self, slot: int) -> int:
        """The number of a peer's controller on the wire."""
        bus = self.shells[slot].bus
        assert isinstance(bus, CanBus) and isinstance(bus.bus, FieldBus)
        return bus.bus.node

    async def close(self) -> None:
        """Cancel all peers, wait for their ends, and forget the channel."""
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        for shell in self.shells:
            shell.bus.close()
        forget(self.channel)
