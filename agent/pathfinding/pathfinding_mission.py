"""A mission: drive to a goal cell of our own on a grid full of robots, by plans agreed with all.

It drives as coverage does (`agent/coverage/coverage_mission.py`). There is one section for each
robot, and its only unit of work is that the robot stands on its goal with its plan at an end.
"""

from collections.abc import Mapping
from random import Random

from agent.coverage.cell_map import CellMap
from agent.coverage.coverage_mission import COVERED, GridWork
from agent.interface.mission import ClaimRequest, FleetView, MotionRequest
from agent.pathfinding.goal_agreement import GoalAgreement
from crdt import Phase


class GoalWork(GridWork):
    """One robot's way to its goal."""

    def __init__(
        self, slot: int, ground: CellMap, speed_m_s: float, rng: Random, goal: int, robots: int
    ) -> None:
        """`goal`: a number of a cell. `robots`: how many the fleet has; each has a section."""
        super().__init__(slot, ground, speed_m_s, rng)
        self.agreement = GoalAgreement(slot, ground, goal)
        self.goal, self._sections = goal, dict.fromkeys(range(robots), 1)

    @property
    def section_units(self) -> Mapping[int, int]:
        return self._sections

    def _sweep(self, view: FleetView) -> None:
        """Mark our own section as done when we stand on the goal and do not leave it any more."""
        unit = (self.slot, 0)
        if not self.over or view.progress.has(*unit) or self.slot in self._told:
            return
        if self._off_m(view, self.goal) <= COVERED * self.ground.cell_m:
            self._told.add(self.slot)
            self._news.append(unit)

    def _forget_told(self, view: FleetView) -> None:
        self._told = {slot for slot in self._told if not view.progress.has(slot, 0)}

    def _tell_of_silent(self, view: FleetView) -> None:
        """Nothing is known to be done by a robot that fell silent."""

    def choose(self, view: FleetView) -> ClaimRequest | None:
        """Our own section; nobody else's, because a goal is one robot's."""
        if not self.agreement.going or view.allocation.phase_of(self.slot) is not Phase.FREE:
            return None
        return ClaimRequest(self.slot, 0)

    def work(self, view: FleetView) -> MotionRequest:
        wish = self.idle(view)
        return wish._replace(finished=True) if view.progress.complete(self.slot) else wish
