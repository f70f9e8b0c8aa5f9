"""A team of robots that covers a known grid together: the state every peer holds, and its next step.

    team = Team(walls, starts)          the same at every peer, from the map and the places alone
    while team.remaining(): places = team.advance()

Each room (connected free region) is walked and cut by itself. A death or a join cuts what is not yet
covered again among the live robots; covered cells stay covered.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.coverage.room_plan import Costing, Costs, cut_room
from agent.coverage.team_state import NONE, Numbers, Walked, new_grid, new_robots
from agent.coverage.team_step import FAR, fill_field, step
from agent.coverage.work_sharing import choose_goals
from agent.interface.geometry import Cell

Walls = NDArray[np.bool_]
TURN_PARTS = 4  # a turn's cost is kept in quarters of a step
TURN_COST_MAX = 100.0  # steps; a greater cost would mean that robots cannot turn


class Team:
    """All robots of one grid, their runs, and what is covered. Equal inputs give equal teams.

    Callers use rows and columns; inside, cells are numbers into the padded grid.
    """

    def __init__(
        self,
        walls: Walls,
        starts: Sequence[Cell],
        turn_cost: float = 0.0,
        covered: Walls | None = None,
    ) -> None:
        """`walls`: (rows, columns), True for blocked cells. `turn_cost`: steps a quarter turn.
        `covered`: what need not be covered (any more)."""
        assert walls.ndim == 2 and 0.0 <= turn_cost <= TURN_COST_MAX
        free = np.ascontiguousarray(np.pad(~walls, 1).astype(np.uint8).ravel())
        self.grid = new_grid(free, walls.shape[1] + 2)
        if covered is not None:
            self.grid.covered[:] = np.pad(covered, 1).ravel()
        self.unit = TURN_PARTS if turn_cost else 1
        self.turn = round(turn_cost * self.unit)
        self.now = 0
        self.bound = 0  # the bound of the latest cut, in steps from then on, turns included
        places = np.array([self.number(cell) for cell in starts], np.int64)
        self._recut(places)

    def number(self, cell: Cell) -> int:
        """The number of a cell in the padded grid."""
        return (cell[0] + 1) * self.grid.width + cell[1] + 1

    def cell(self, number: int) -> Cell:
        """The row and column of a number in the padded grid."""
        return number // self.grid.width - 1, number % self.grid.width - 1

    def _settle(self, places: Numbers) -> None:
        there = np.flatnonzero(places != NONE)
        cells = places[there]
        assert len(set(cells.tolist())) == cells.size and self.grid.free[cells].all()
        self.robots = new_robots(places, self.grid.free.size)
        self.grid.covered[cells] = 1
        self.grid.here[cells] = there

    def die(self, robot: int) -> None:
        """A robot cannot move any more: it blocks its cell, and its work is cut among the others."""
        place = self.robots.place[robot]
        assert place != NONE
        self.grid.free[place], self.grid.here[place] = 0, NONE
        self.robots.place[robot] = NONE
        self._recut(self.robots.place)

    def join(self, cell: Cell) -> int:
        """Add a robot in a free, unoccupied cell; returns its number."""
        self._recut(np.append(self.robots.place, self.number(cell)))
        return self.robots.place.size - 1

    def _recut(self, places: Numbers) -> None:
        """Cut all that is not covered among the robots that are there, from where they are."""
        self._settle(places)
        orders, alongs = [np.empty(0, np.int32)], [np.empty(0, np.int32)]
        unseen = set(np.flatnonzero(self.robots.place != NONE).tolist())
        base = self.bound = 0
        while unseen:
            room = self._ways(min(unseen))
            mates = [robot for robot in sorted(unseen) if room[self.robots.place[robot]] != NONE]
            unseen -= set(mates)
            share = cut_room(
                self.grid, (room != NONE).astype(np.uint8), self.robots.place[mates],
                Costing(self.unit, self.turn),
            )  # fmt: skip
            if share is None:
                continue
            self.bound = max(self.bound, share.bound // self.unit)
            self.robots.low[mates] = base + np.array(share.cuts[:-1])
            self.robots.high[mates] = base + np.array(share.cuts[1:])
            orders.append(share.order)
            alongs.append(share.along)
            base += share.order.size
        self.walked = Walked(np.concatenate(orders), np.concatenate(alongs), self.unit)
        self._remaining = base

    def _ways(self, robot: int) -> Costs:
        """Steps from a robot's place to every cell, -1 where there is no way."""
        field = np.full(self.grid.free.size, NONE, np.int32)
        place = self.robots.place[robot]
        fill_field(self.grid.free, self.grid.width, field, place, NONE, FAR, self.grid.queue)
        return field

    def remaining(self) -> int:
        """Cells still to be covered."""
        return self._remaining

    def advance(self) -> list[int]:
        """The place of each robot after one more step: numbers in the padded grid, -1 for dead
        robots."""
        choose_goals(self.grid, self.walked, self.robots, self.now)
        self._remaining -= step(self.grid, self.robots)
        self.now += 1
        places: list[int] = self.robots.place.tolist()
        return places
