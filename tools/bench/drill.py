"""Peers with everything but a world: they claim, work and finish sections by the clock.

For figures about the bus: real peers on the real wire model in virtual time, with work going on all
the time at the pace of a field robot, whatever the size of the fleet.
"""

import asyncio
import itertools
from collections.abc import Mapping
from math import cos, sin
from random import Random

import numpy as np

from agent.core import Peer
from agent.effects import Drive
from agent.identity import Identity
from agent.mission import STILL, Choice, FleetView, Wish
from agent.motion import Limits, Motion
from agent.ports import Observation
from agent.shell import Shell
from crdt import Phase
from protocol.bus import CanBus
from protocol.name import fleet_name
from sim.disk import MemoryJournal
from sim.fieldbus import FieldBus, Segment, forget, segment

UNIT_M = 5.0
SPEED_M_S = 2.5
UNIT_S = UNIT_M / SPEED_M_S
SECTION_UNITS = 40  # 200 m of swath: a row of a field, worked in 80 s
SPACING_M = 12.0  # far enough apart that nobody gives way
NO_FENCES = np.zeros((0, 4))

_numbers = itertools.count()


class Drill:
    """The next free section from a place of one's own, worked at a steady pace."""

    def __init__(self, slot: int, robots: int, sections: int) -> None:
        self.slot = slot
        self._order = [(slot * sections // robots + k) % sections for k in range(sections)]
        self._units = dict.fromkeys(range(sections), SECTION_UNITS)
        self._done = SECTION_UNITS * slot // robots  # not everybody finishes at once
        self._next_us = 0

    @property
    def section_units(self) -> Mapping[int, int]:
        return self._units

    def choose(self, view: FleetView) -> Choice | None:
        for section in self._order:
            if view.allocation.phase_of(section) is Phase.FREE:
                return Choice(section, 3)
        return None

    def approach(self, section: int, view: FleetView) -> Wish:
        return STILL

    def begin(self, section: int, view: FleetView) -> None:
        self._next_us = view.now_us + round(UNIT_S * 1e6)

    def work(self, view: FleetView) -> Wish:
        covered: tuple[int, ...] = ()
        if view.now_us >= self._next_us:
            covered, self._done = (self._done,), self._done + 1
            self._next_us += round(UNIT_S * 1e6)
        finished = self._done >= SECTION_UNITS
        near = self._done >= SECTION_UNITS - 2
        self._done = 0 if finished else self._done
        return Wish(SPEED_M_S, 0.0, 0.0, True, covered, finished=finished, near_end=near)

    def abandon(self) -> None: ...
    def admits(self, goal: tuple[float, float]) -> bool:
        return False

    def travel(self, goal: tuple[float, float], view: FleetView) -> Wish:
        return STILL

    def interrupted(self) -> None: ...

    def rest(self, view: FleetView) -> Wish:
        return STILL


class Place:
    """A body that is where it is, a little restless so that frames differ."""

    def __init__(self, slot: int) -> None:
        self.x_m, self.y_m = SPACING_M * (slot % 12), SPACING_M * (slot // 12)
        self.slot = slot
        self._moving_us, self._stood_us = -1, -1  # newest command to move; first to stand after it

    def sense(self, now_us: int) -> Observation:
        angle = now_us * 1e-6 + self.slot
        return Observation(
            self.x_m + cos(angle), self.y_m + sin(angle), angle % 6.28, -sin(angle), cos(angle)
        )

    def drive(self, command: Drive, now_us: int) -> None:
        if command.vx_m_s or command.vy_m_s or command.turn_rad_s:
            self._moving_us, self._stood_us = now_us, -1
        elif self._stood_us < 0:
            self._stood_us = now_us

    def moved_until_us(self, expiry_us: int) -> int:
        """Until when a command to move was in force."""
        expires_us = self._moving_us + expiry_us
        return expires_us if self._stood_us < 0 else min(self._stood_us, expires_us)


class Squad:
    """N such peers in one virtual loop. Make it inside of `run_virtual`."""

    def __init__(self, robots: int, seed: int, sections: int | None = None) -> None:
        self.channel = f"drill {next(_numbers)}"
        self.segment: Segment = segment(self.channel, seed=seed)
        self.bodies = [Place(slot) for slot in range(robots)]
        self.shells: list[Shell] = []
        sections = sections or 8 * robots
        for slot, body in enumerate(self.bodies):
            identity = Identity(
                slot,
                frozenset(range(robots)),
                fleet_name("drill", slot),
                1,
                started=True,
                first_boot=True,
            )
            motion = Motion(slot, Limits(0.5, SPEED_M_S, 1.0), NO_FENCES)
            mission = Drill(slot, robots, sections)
            rng = Random(f"{seed}/drill/{slot}")
            peer = Peer(identity, rng, Shell.now_us(), {}, mission, motion)
            self.shells.append(Shell(peer, CanBus(FieldBus(self.channel)), body, MemoryJournal()))
        self.tasks = [asyncio.create_task(shell.run()) for shell in self.shells]

    async def until_working(self, limit_s: float = 60.0) -> bool:
        loop = asyncio.get_running_loop()
        while loop.time() < limit_s:
            await asyncio.sleep(0.5)
            if all(shell.peer.state.name == "WORKING" for shell in self.shells):
                return True
        return False

    def node_of(self, slot: int) -> int:
        bus = self.shells[slot].bus
        assert isinstance(bus, CanBus) and isinstance(bus.bus, FieldBus)
        return bus.bus.node

    async def close(self) -> None:
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        for shell in self.shells:
            shell.bus.close()
        forget(self.channel)
