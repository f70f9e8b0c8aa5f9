"""ORCA for all robots of a simulation in one call; float32 kernels, equal to RVO2 to the last bit.

    fleet = Fleet(agents, dt_s, walls)         once
    fleet.agents[:, WANT_X : WANT_Y + 1] = ... every step: velocities wanted, m/s
    fleet.step()                               velocities and positions after dt_s

`agents` is a table of `tools.bench.kernels.agent_table`. Neighbours come from the last step's
(`tools.bench.kernels.neighbourhood`), and are those that the kd-tree of the RVO2 library
(Apache-2.0) finds, in its order.
"""

import numpy as np
from numba import njit

from agent.avoidance.half_planes import beside_agent, beside_wall
from agent.avoidance.linear_program import HALF, ONE, solve
from agent.avoidance.obstacle_tree import NO_WALLS, WALLS_MAX, ObstacleTree, near_walls
from tools.bench.kernels.agent_table import (
    AGENT_COLUMNS,
    HORIZON,
    NEIGHBOURS,
    NEW_VX,
    NEW_VY,
    RADIUS,
    SPEED_MAX,
    VX,
    VY,
    WALL_HORIZON,
    WANT_X,
    WANT_Y,
    Agents,
    X,
    Y,
)  # fmt: skip
from tools.bench.kernels.kd_tree import build
from tools.bench.kernels.neighbourhood import neighbours

f32 = np.float32


@njit(cache=True, error_model="numpy")
def velocities(agents, table, root, dt, known, counts, stack):  # type: ignore[no-untyped-def]
    """Fill NEW_VX and NEW_VY of every agent, among its neighbours.

    `agents` (n, columns), `table` (walls, columns) with the tree of walls that begins at number
    `root`, `dt` seconds a step, `known` (n, most) and `counts` (n,) from `neighbours`, `stack` (2 n
    + 8,) as working memory.
    """
    near = np.empty(WALLS_MAX, np.int64)
    squares = np.empty(WALLS_MAX, f32)
    lines, spare = np.empty((2 * WALLS_MAX, 4), f32), np.empty((2 * WALLS_MAX, 4), f32)
    per_step = ONE / dt
    for me in range(agents.shape[0]):
        x, y, vx, vy = agents[me, X], agents[me, Y], agents[me, VX], agents[me, VY]
        radius, speed = agents[me, RADIUS], agents[me, SPEED_MAX]
        hard = np.int64(0)  # a literal is a type of its own: compiled twice
        if root >= 0:
            horizon = agents[me, WALL_HORIZON]
            reach = horizon * speed + radius
            count = near_walls(table, root, x, y, reach * reach, stack, near, squares)
            per_horizon = ONE / horizon
            for k in range(count):
                hard += beside_wall(table, near[k], x, y, vx, vy, radius, per_horizon, lines, hard)
        count = counts[me]
        per_horizon = ONE / agents[me, HORIZON]
        for k in range(count):
            other = known[me, k]
            beside_agent(agents[other, X] - x, agents[other, Y] - y, vx, vy, agents[other, VX],
                         agents[other, VY], radius + agents[other, RADIUS], HALF, per_horizon,
                         per_step, lines, hard + k)  # fmt: skip
        agents[me, NEW_VX], agents[me, NEW_VY] = solve(
            lines, hard + count, hard, speed, agents[me, WANT_X], agents[me, WANT_Y], spare
        )


@njit(cache=True, error_model="numpy")
def fleet_step(agents, order, known, counts, table, root, dt_s, move):  # type: ignore[no-untyped-def]
    """New velocities of all agents; where `move` is set, take them and move on by `dt_s` (float32).

    `agents`: (n, AGENT_COLUMNS) float32; `order`: (n,) int64, a permutation, `known`: (n, most)
    int64, neighbours, and `counts`: (n,) int64, how many, are kept between calls;
    `table`, `root`: an `ObstacleTree`, root -1 where there are no walls.
    """
    count = agents.shape[0]
    if count == 0:
        return
    bounds, nodes = np.empty((2 * count, 4), f32), np.empty((2 * count, 4), np.int64)
    # Robots in one spot make the tree a list: the deepest it can be. So can walls in a row.
    stack = np.empty(2 * max(count, table.shape[0]) + 8, np.int64)
    build(agents, order, bounds, nodes, stack)
    neighbours(agents, order, bounds, nodes, stack, known, counts)
    velocities(agents, table, root, dt_s, known, counts, stack)
    if move:
        for me in range(count):
            agents[me, VX], agents[me, VY] = agents[me, NEW_VX], agents[me, NEW_VY]
            agents[me, X] += agents[me, VX] * dt_s
            agents[me, Y] += agents[me, VY] * dt_s


class OrcaFleet:
    """All agents of a simulation, with what is kept from step to step."""

    def __init__(self, agents: Agents, dt_s: float, walls: ObstacleTree = NO_WALLS) -> None:
        """`agents` is held, not copied: write it between steps. None may get more neighbours."""
        assert agents.shape == (len(agents), AGENT_COLUMNS) and agents.dtype == np.float32
        assert np.all((agents[:, NEIGHBOURS] >= 0) & (agents[:, NEIGHBOURS] <= WALLS_MAX))
        self.agents, self.dt_s, self.walls = agents, np.float32(dt_s), walls
        self._order = np.arange(len(agents))
        most = int(agents[:, NEIGHBOURS].max(initial=1))
        self._known = np.zeros((len(agents), most), dtype=np.int64)
        self._counts = np.zeros(len(agents), dtype=np.int64)

    def step(self, move: bool = True) -> None:
        """Choose all velocities at once, then (with `move`) drive them for one step."""
        fleet_step(self.agents, self._order, self._known, self._counts, self.walls.table,
                   self.walls.root, self.dt_s, move)  # fmt: skip
