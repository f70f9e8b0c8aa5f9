"""The fleets of `GridWorld`: whole peers that cover its cells together, or go to a goal each.

They are apart from their runs, because `headland compile` compiles them and not the runs.
"""

from collections import deque
from typing import Any

import numpy as np

from agent.coverage.cell_map import NONE
from agent.coverage.coverage_mission import GridWork
from agent.interface.lifecycle import State
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.scenarios.coverage_setup import CoverageSetup
from sim.world.grid_world import GridWorld
from sim.world.plan_judge import steps_from


class CoverageFleet(Cluster):
    """A cluster in the world of cells. It knows which robots never died, because only these are
    asked for equal replicas."""

    def __init__(self, setting: CoverageSetup, channel: str, record: Record, host: Host) -> None:
        super().__init__(setting, channel, record, host)
        self.place = setting
        assert isinstance(self.world, GridWorld)
        self.grid_world = self.world
        self.never_died = set(range(len(setting.starts)))

    def boot(self, slot: int) -> Robot:
        """Boot a robot; a new one is put into the free cell next to its start."""
        if self.boots[slot]:
            self.never_died.discard(slot)
        if slot not in self.grid_world.robots:
            number = self._room_for(slot)
            assert number is not None, "no room"
            self.grid_world.put_robot(slot, number, self.host.now_us())
        return super().boot(slot)

    def kill(self, slot: int) -> None:
        self.never_died.discard(slot)
        super().kill(slot)

    def has_room(self, slot: int) -> bool:
        """Whether a cell that can be reached from the robot's start is empty, or the robot is there."""
        return slot in self.grid_world.robots or self._room_for(slot) is not None

    def _room_for(self, slot: int) -> int | None:
        """The empty cell nearest to a robot's start; None while others are in all of them."""
        ground, start = self.place.ground, self.place.cells[slot]
        seen, queue = {start}, deque([start])
        while queue:
            number = queue.popleft()
            if self.grid_world.is_empty(number, self.host.now_us()):
                return number
            row, column = ground.cell(number)
            for cell in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                near = ground.number(cell)
                if near != NONE and near not in seen:
                    seen.add(near)
                    queue.append(near)
        return None

    def mission(self, robot: Robot) -> GridWork:
        """The coverage mission of a robot."""
        mission = robot.peer.mission
        assert isinstance(mission, GridWork)
        return mission

    @property
    def finished(self) -> bool:
        """Whether every running robot is at the end of its plan, and covered cells are done. One that is
        off the bus reports nothing."""
        return any(self.mission(robot).agreement.going for robot in self.running) and all(
            robot.peer.state is not State.DISCONNECTED
            and self.mission(robot).over
            and self._in_order(robot)
            for robot in self.running
        )

    @property
    def waits_for_nobody(self) -> bool:
        """Whether each running robot has a part in its plan, or stands until a person comes."""
        return all(
            self.mission(robot).agreement.going or robot.peer.state is State.EMERGENCY_STOP
            for robot in self.running
        )

    def _in_order(self, robot: Robot) -> bool:
        peer = robot.peer
        complete = sum(peer.progress.complete(s) for s in self.place.ground.section_units)
        return peer.allocation.done_count() >= complete

    def reachable(self) -> set[int]:
        """Cells that some running robot can reach; bodies of the others block their cells
        permanently. If none runs: cells that the robots could have reached."""
        ground = self.place.ground
        walls = ground.walls.copy()
        runs = [robot.slot for robot in self.running]
        for slot, body in self.grid_world.robots.items():
            if runs and not self.is_up(slot):
                for number in np.flatnonzero(self._near(body.position)).tolist():
                    walls[ground.cell(number)] = True
        bodies = [self.grid_world.body(slot) for slot in runs or self.grid_world.robots]
        sources = [ground.cell_at(*body.position) for body in bodies]
        found = steps_from(walls.tolist(), [s for s in sources if not walls[s]])
        return {ground.number(cell) for cell in found}

    def _near(self, at: tuple[float, float]) -> Any:
        """Cells without room beside a body, or possibly without. Others know its position by its
        last beat; how far it moved after that is known to 0.1 of a cell."""
        off = np.abs(self.grid_world._centres - at)
        return (off < 0.8 * self.place.ground.cell_m).all(axis=1)


class MapfFleet(CoverageFleet):
    """A cluster on a map where each robot has a goal."""

    def _in_order(self, robot: Robot) -> bool:
        """Whether all that the robot knows as arrived is also marked as done, but of dead robots."""
        peer = robot.peer
        return all(
            not peer.progress.complete(other.slot) or peer.allocation.done_count() > 0
            for other in self.running
        )
