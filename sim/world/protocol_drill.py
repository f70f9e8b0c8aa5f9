"""Peers without a world: they claim, work and finish sections by the clock.

For figures and campaigns about the protocol: real peers on the real wire model, with continuous
work at the pace of a field robot, whatever the fleet size, and no physics.
"""

from collections.abc import Mapping
from math import cos, sin

from agent.interface.effects import Drive
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.ports import Observation
from crdt import Phase

UNIT_M = 5.0
SPEED_M_S = 2.5
UNIT_S = UNIT_M / SPEED_M_S
SECTION_UNITS = 40  # 200 m of swath: a row of a field, worked in 80 s
SPACING_M = 12.0  # far enough apart that no robot gives way


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
        """Units of each section: all have the same number."""
        return self._units

    def choose(self, view: FleetView) -> ClaimRequest | None:
        """The next free section from its own start on, at a fixed bid; None if none is free."""
        for section in self._order:
            if view.allocation.phase_of(section) is Phase.FREE:
                return ClaimRequest(section, 3)
        return None

    def begin(self, section: int, view: FleetView) -> None:
        """Start the clock of the first unit."""
        self._next_us = view.now_us + round(UNIT_S * 1e6)

    def work(self, view: FleetView) -> MotionRequest:
        """A unit is covered whenever its time is over; the section is finished after the last."""
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

    def moved_until_us(self, expiry_us: int) -> int:
        """The end of the latest command to move."""
        expires_us = self._moving_us + expiry_us
        return expires_us if self._stood_us < 0 else min(self._stood_us, expires_us)
