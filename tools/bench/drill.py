"""Peers without a world, on asyncio's loop, for figures about the bus.

Real peers on the real wire model, with continuous work at the pace of a field robot, whatever the
fleet size, and no physics.
"""

import asyncio
import itertools
from collections.abc import Mapping
from math import cos, sin
from random import Random

import numpy as np

from agent.interface.effects import Drive
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from agent.runtime.peer_runner import PeerRunner
from crdt import Phase
from protocol.links.bus import CanBus
from sim.can.simulated_bus import FieldBus, Segment, forget, segment
from sim.fleet.simulated_disk import MemoryJournal
from sim.world.protocol_world import SPACING_M, SPEED_M_S

UNIT_M = 5.0
UNIT_S = UNIT_M / SPEED_M_S
SECTION_UNITS = 40  # 200 m of swath: a row of a field, worked in 80 s
NO_FENCES = np.zeros((0, 4))

_numbers = itertools.count()


class Drill(Mission):
    """Takes the next free section from its own start, and works it at a steady pace."""

    def __init__(self, slot: int, robots: int, sections: int) -> None:
        self.slot = slot
        self._order = [(slot * sections // robots + k) % sections for k in range(sections)]
        self._units = dict.fromkeys(range(sections), SECTION_UNITS)
        # Spread out, so that robots do not all finish at the same time.
        self._done = SECTION_UNITS * slot // robots
        self._next_us = 0

    @property
    def section_units(self) -> Mapping[int, int]:
        return self._units

    def choose(self, view: FleetView) -> ClaimRequest | None:
        for section in self._order:
            if view.allocation.phase_of(section) is Phase.FREE:
                return ClaimRequest(section, 3)
        return None

    def begin(self, section: int, view: FleetView) -> None:
        self._next_us = view.now_us + round(UNIT_S * 1e6)

    def work(self, view: FleetView) -> MotionRequest:
        covered: tuple[int, ...] = ()
        if view.now_us >= self._next_us:
            covered, self._done = (self._done,), self._done + 1
            self._next_us += round(UNIT_S * 1e6)
        finished = self._done >= SECTION_UNITS
        near = self._done >= SECTION_UNITS - 2
        self._done = 0 if finished else self._done
        return MotionRequest(SPEED_M_S, 0.0, 0.0, True, covered, finished=finished, near_end=near)


class Place:
    """A body at a fixed position, with small random motion so that frames differ."""

    def __init__(self, slot: int) -> None:
        self.x_m, self.y_m = SPACING_M * (slot % 12), SPACING_M * (slot // 12)
        self.slot = slot
        self._moving_us, self._stood_us = -1, -1  # newest command to move; first to stand after it

    def sense(self, now_us: int) -> Observation:
        """A position that circles within a metre, so that no two frames are equal."""
        angle = now_us * 1e-6 + self.slot
        return Observation(
            self.x_m + cos(angle), self.y_m + sin(angle), angle % 6.28, -sin(angle), cos(angle),
            sensed_at_us=now_us,
        )  # fmt: skip

    def drive(self, command: Drive, now_us: int) -> None:
        """Record since when the command is to stand, or when it was last to move."""
        if command.vx_m_s or command.vy_m_s or command.turn_rad_s:
            self._moving_us, self._stood_us = now_us, -1
        elif self._stood_us < 0:
            self._stood_us = now_us

    def moved_until_us(self, expiry_at_us: int) -> int:
        """The end of the latest command to move."""
        expires_at_us = self._moving_us + expiry_at_us
        return expires_at_us if self._stood_us < 0 else min(self._stood_us, expires_at_us)


class ProtocolFleet:
    """N such peers in one virtual loop. Make it inside of `run_virtual`."""

    def __init__(self, robots: int, seed: int, sections: int | None = None) -> None:
        self.channel = f"drill {next(_numbers)}"
        self.segment: Segment = segment(self.channel, seed=seed)
        self.bodies = [Place(slot) for slot in range(robots)]
        self.runners: list[PeerRunner] = []
        sections = sections or 8 * robots
        for slot, body in enumerate(self.bodies):
            identity = identity_of("drill", slot, robots, 1, first_boot=True)
            motion = HolonomicMotion(slot, BodyLimits(0.5, SPEED_M_S, 1.0), NO_FENCES)
            mission = Drill(slot, robots, sections)
            rng = Random(f"{seed}/drill/{slot}")
            parts = MissionParts(mission, motion)
            peer = make_peer(identity, rng, PeerRunner.now_us(), parts=parts)
            self.runners.append(
                PeerRunner(peer, CanBus(FieldBus(self.channel)), body, MemoryJournal())
            )
        self.tasks = [asyncio.create_task(runner.run()) for runner in self.runners]

    async def until_working(self, limit_s: float = 60.0) -> bool:
        """Whether all peers are WORKING within `limit_s` of virtual time."""
        loop = asyncio.get_running_loop()
        while loop.time() < limit_s:
            await asyncio.sleep(0.5)
            if all(runner.peer.state.name == "WORKING" for runner in self.runners):
                return True
        return False

    def node_of(self, slot: int) -> int:
        """The number of a peer's controller on the wire."""
        bus = self.runners[slot].bus
        assert isinstance(bus, CanBus) and isinstance(bus.bus, FieldBus)
        return bus.bus.node

    async def close(self) -> None:
        """Cancel all peers, wait for their ends, and forget the channel."""
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        for runner in self.runners:
            runner.bus.close()
        forget(self.channel)
