"""A world of cells: bodies that drive straight from cell to cell, and the truth about them.

It is simpler than `sim/world/world.py`, so that a hundred robots can cover a large map. A body
follows its command at once, sees others within two cells, and stands still when its commands stop.
Contacts, coverage and the positions of robots are judged from true positions every `LOOK_US`,
without any knowledge of agents.
"""

from dataclasses import dataclass, field
from math import inf

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE, CellMap
from agent.interface.config import ACTUATOR_TTL_US, MS
from agent.interface.effects import Drive
from agent.interface.observation import Observation
from sim.world.drive_trains import Chassis
from sim.world.robot_body import SimulatedBody
from sim.world.world import World

LOOK_US = 50 * MS
SIGHT = 2.0  # cells
COVERED = 0.1  # of a cell, the same as a robot's own criterion


class GridBody(SimulatedBody):
    """One robot's position, its command, and the time of the command."""

    def __init__(self, world: "GridWorld", slot: int, row: int) -> None:
        super().__init__(world, slot, row, world.radius_m, Chassis())
        self.grid = world

    @property
    def position(self) -> tuple[float, float]:
        """Metres east and north, at the time of the last command."""
        x_m, y_m = self.grid.positions[self.index].tolist()
        return x_m, y_m

    def sense(self, now_us: int) -> Observation:
        """What the robot senses now: its place, its speed while a command is valid, and other
        bodies in sight."""
        world, row = self.grid, self.index
        world.advance(now_us)
        x_m, y_m = world.now(row, now_us)
        vx, vy = world.speeds[row].tolist() if now_us < world.drive_ends_at_us[row] else (0.0, 0.0)
        return Observation(x_m, y_m, 0.0, vx, vy, bodies=world.seen(row, x_m, y_m, now_us),
                           sensed_at_us=now_us)  # fmt: skip

    def drive(self, command: Drive, now_us: int) -> None:
        """Follow a velocity from now on, without delay, until the command expires."""
        world, row = self.grid, self.index
        world.positions[row] = world.now(row, now_us)
        world.placed_at_us[row] = now_us
        world.speeds[row] = command.vx_m_s, command.vy_m_s
        world.drive_ends_at_us[row] = now_us + ACTUATOR_TTL_US


@dataclass
class GridTruth:
    """What was really covered, and by which robot; how near bodies came, and what they drove into."""

    first_at_us: NDArray[np.int64]  # by cell number: when it was covered, -1: not yet
    by: NDArray[np.int16]  # the robot that covered it first
    contacts: set[tuple[int, int]] = field(default_factory=set)
    through_walls: int = 0  # checks at which a centre was in a wall
    closest_m: float = inf
    steps: int = 0  # cells entered
    at: dict[int, int] = field(default_factory=dict)  # slot -> the cell that it covered last
    # Each time that a robot came to the middle of another cell: when, the slot, the cell.
    visits: list[tuple[int, int, int]] = field(default_factory=list)
    # Each time that a robot crossed the border into another cell, in the same form.
    crossings: list[tuple[int, int, int]] = field(default_factory=list)


class GridWorld(World):
    """Positions and speeds of all bodies as arrays with a row for each robot, moved exactly between
    commands, and the truth about what they covered."""

    def __init__(self, ground: CellMap, radius_m: float) -> None:
        super().__init__([])
        self.ground, self.radius_m = ground, radius_m
        self.positions = np.empty((0, 2))  # at `placed_at_us`
        self.speeds = np.empty((0, 2))
        self.placed_at_us = np.empty(0, dtype=np.int64)
        self.drive_ends_at_us = np.empty(0, dtype=np.int64)
        count = len(ground)
        self.truth = GridTruth(np.full(count, NONE, np.int64), np.full(count, NONE, np.int16))
        self._inside = np.empty(
            0, dtype=np.int64
        )  # the cell of each body when that was last judged
        self._looked_at_us = 0
        self._centres = np.array([ground.centre(n) for n in range(count)]).reshape(-1, 2)

    def guard(self) -> None:
        """Does nothing: steps are not fine enough here to check robots that must stand."""

    def put_robot(self, slot: int, number: int, now_us: int) -> None:
        """Put a robot into the middle of a cell."""
        assert slot not in self.robots
        self.robots[slot] = GridBody(self, slot, len(self.robots))
        self.positions = np.vstack((self.positions, self._centres[number]))
        self.speeds = np.vstack((self.speeds, (0.0, 0.0)))
        self.placed_at_us = np.append(self.placed_at_us, now_us)
        self.drive_ends_at_us = np.append(self.drive_ends_at_us, now_us)
        self._inside = np.append(self._inside, NONE)

    def now(self, row: int, now_us: int) -> tuple[float, float]:
        """Where the body in that row is at `now_us`, metres east and north. It stands from the end
        of its command on."""
        seconds = (min(now_us, int(self.drive_ends_at_us[row])) - int(self.placed_at_us[row])) / 1e6
        (x_m, y_m), (vx, vy) = self.positions[row].tolist(), self.speeds[row].tolist()
        return x_m + vx * seconds, y_m + vy * seconds

    def _all(self, now_us: int) -> NDArray[np.float64]:
        seconds = (np.minimum(now_us, self.drive_ends_at_us) - self.placed_at_us) / 1e6
        places: NDArray[np.float64] = self.positions + self.speeds * seconds[:, None]
        return places

    def seen(
        self, row: int, x_m: float, y_m: float, now_us: int
    ) -> tuple[tuple[float, float], ...]:
        """Other robots within sight, as metres east and north of the position."""
        sight_m = SIGHT * self.ground.cell_m
        # Positions at the command; a cell of margin covers the motion since.
        spare_m = sight_m + self.ground.cell_m
        beside = np.abs(self.positions[:, 0] - x_m) < spare_m
        beside &= np.abs(self.positions[:, 1] - y_m) < spare_m
        near = beside.nonzero()[0].tolist()
        found = []
        for other in near:
            if other != row:
                bx, by = self.now(other, now_us)
                if (bx - x_m) ** 2 + (by - y_m) ** 2 < sight_m**2:
                    found.append((bx - x_m, by - y_m))
        return tuple(found)

    def is_empty(self, number: int, now_us: int) -> bool:
        """Whether a new robot can be put into a cell."""
        gaps = self._all(now_us) - self._centres[number]
        return not (np.hypot(gaps[:, 0], gaps[:, 1]) < self.ground.cell_m).any()

    def advance(self, now_us: int) -> None:
        """Judge everything up to now."""
        while self._looked_at_us + LOOK_US <= now_us:
            self._looked_at_us += LOOK_US
            self._look(self._looked_at_us)

    def _look(self, now_us: int) -> None:
        """Judge contacts and covered cells from the exact positions at this instant."""
        if not self.robots:
            return
        truth, places = self.truth, self._all(now_us)
        gaps = places[:, None, :] - places[None, :, :]
        away_m = np.hypot(gaps[..., 0], gaps[..., 1])
        np.fill_diagonal(away_m, inf)
        closest_m = float(away_m.min())
        truth.closest_m = min(truth.closest_m, closest_m)
        slots = list(self.robots)
        if closest_m < 2 * self.radius_m:
            for a, b in np.argwhere(away_m < 2 * self.radius_m).tolist():
                if a < b:
                    truth.contacts.add((slots[a], slots[b]))
        self._judge_cells(slots, places, now_us)

    def _judge_cells(self, slots: list[int], places: NDArray[np.float64], now_us: int) -> None:
        truth, ground = self.truth, self.ground
        columns = np.rint(places[:, 0] / ground.cell_m + (ground.columns - 1) / 2).astype(np.int64)
        rows = np.rint((ground.rows - 1) / 2 - places[:, 1] / ground.cell_m).astype(np.int64)
        numbers = ground.number_of[(rows + 1) * ground.width + columns + 1]
        truth.through_walls += int(np.count_nonzero(numbers == NONE))
        for row in np.flatnonzero((numbers != self._inside) & (numbers != NONE)).tolist():
            truth.crossings.append((now_us, slots[row], int(numbers[row])))
            self._inside[row] = numbers[row]
        off = places - self._centres[numbers]
        middle = (np.hypot(off[:, 0], off[:, 1]) <= COVERED * ground.cell_m) & (numbers != NONE)
        for row in np.flatnonzero(middle).tolist():
            slot, number = slots[row], int(numbers[row])
            if truth.at.get(slot) == number:
                continue
            truth.at[slot] = number
            truth.visits.append((now_us, slot, number))
            truth.steps += 1
            if truth.first_at_us[number] == NONE:
                truth.first_at_us[number], truth.by[number] = now_us, slot
