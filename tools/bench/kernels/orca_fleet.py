"""ORCA for all robots of a simulation in one call; float32 kernels, equal to RVO2 to the last bit.

    fleet = Fleet(agents, dt_s, walls)         once
    fleet.agents[:, WANT_X : WANT_Y + 1] = ... every step: velocities wanted, m/s
    fleet.step()                               velocities and positions after dt_s

`agents` is a table of `tools.bench.kernels.agent_table`. Neighbours come from the last step's (`tools.bench.kernels.neighbourhood`),
and are those that the kd-tree of the RVO2 library (Apache-2.0) finds, in its order.
"""

import numpy as np
from numba import njit

from agent.avoidance.half_planes import AT_X, AT_Y, LEFT, NEXT, RIGHT, beside_agent, beside_wall
from agent.avoidance.k_nearest import insert
from agent.avoidance.linear_program import HALF, ONE, ZERO, solve
from agent.avoidance.obstacle_tree import NO_WALLS, ObstacleTree
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
WALLS_MAX = 256  # walls in reach of one robot; the nearest are kept


@njit(cache=True, error_model="numpy")
def _to_edge(table, a, b, x, y):  # type: ignore[no-untyped-def]
    """Square of the distance from a point to an edge."""
    ax, ay = x - table[a, AT_X], y - table[a, AT_Y]
    ex, ey = table[b, AT_X] - table[a, AT_X], table[b, AT_Y] - table[a, AT_Y]
    r = (ax * ex + ay * ey) / (ex * ex + ey * ey)
    if r > ONE:
        ax, ay = x - table[b, AT_X], y - table[b, AT_Y]
    elif r >= ZERO:
        ax, ay = x - (table[a, AT_X] + r * ex), y - (table[a, AT_Y] + r * ey)
    return ax * ax + ay * ay


@njit(cache=True, error_model="numpy")
def near_walls(table, root, x, y, reach, stack, near, squares):  # type: ignore[no-untyped-def]
    """Fill `near` with the edges that face (x, y) within the square root of `reach`, nearest first.

    The tree is walked in its own order: the side of the partition on which we are, the edge of the
    partition itself, the other side. A node that waits for its turn is on the stack as -2 - node.
    """
    count, top, most = int(np.int64(0)), 0, int(np.int64(WALLS_MAX))  # not literals
    if root >= 0:
        stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        entered = node >= 0
        edge = node if entered else -2 - node
        b = int(table[edge, NEXT])
        ex, ey = table[b, AT_X] - table[edge, AT_X], table[b, AT_Y] - table[edge, AT_Y]
        side = (table[edge, AT_X] - x) * ey - (table[edge, AT_Y] - y) * ex
        ours = int(table[edge, LEFT if side >= ZERO else RIGHT])
        if entered:
            stack[top] = -2 - edge
            top += 1
            if ours >= 0:
                stack[top] = ours
                top += 1
            continue
        if not side * side / (ex * ex + ey * ey) < reach:
            continue
        if side < ZERO:
            square = _to_edge(table, edge, b, x, y)
            if square < reach and (count < WALLS_MAX or square < squares[count - 1]):
                insert(near, squares, count, most, edge, square)
                count = min(count + 1, WALLS_MAX)
        beyond = int(table[edge, RIGHT if side >= ZERO else LEFT])
        if beyond >= 0:
            stack[top] = beyond
            top += 1
    return count


@njit(cache=True, error_model="numpy")
def velocities(agents, table, root, dt, known, counts, stack):  # type: ignore[no-untyped-def]
    """Fill NEW_VX and NEW_VY of every agent, among its neighbours."""
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


class Fleet:
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
