"""ORCA for all robots of a simulation in one call; float32 kernels, equal to RVO2 to the last bit.

    fleet = Fleet(agents, dt_s, walls)         once
    fleet.agents[:, WANT_X : WANT_Y + 1] = ... every step: velocities wanted, m/s
    fleet.step()                               velocities and positions after dt_s

`agents` has one row a robot, columns below, metres and seconds. Neighbours come from a kd-tree
whose permutation is kept from step to step, as in the RVO2 library (Apache-2.0): with equal
distances the order in which neighbours are met decides, so the tree is part of the result.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.half_planes import AT_X, AT_Y, LEFT, NEXT, RIGHT, beside_agent, beside_wall
from agent.linear_program import HALF, ONE, ZERO, solve
from agent.obstacle_tree import NO_WALLS, ObstacleTree

f32 = np.float32
Agents = NDArray[np.float32]  # (robots, AGENT_COLUMNS)
# columns of `agents`
X, Y, VX, VY, WANT_X, WANT_Y, NEW_VX, NEW_VY = range(8)
RADIUS, SPEED_MAX, RANGE, NEIGHBOURS, HORIZON, WALL_HORIZON, AGENT_COLUMNS = range(8, 15)
LEAF = 10  # agents in a leaf of the tree
WALLS_MAX = 256  # walls in reach of one robot; the nearest are kept
LOW_X, HIGH_X, LOW_Y, HIGH_Y = range(4)  # columns of a node's bounds
FIRST, LAST, CHILD_A, CHILD_B = range(4)  # columns of a node's indices


@njit(cache=True, error_model="numpy")
def _split(agents, order, begin, end, column, value):  # type: ignore[no-untyped-def]
    """Agents below the value first; returns where the others begin."""
    left, right = begin, end
    while left < right:
        while left < right and agents[order[left], column] < value:
            left += 1
        while right > left and agents[order[right - 1], column] >= value:
            right -= 1
        if left < right:
            order[left], order[right - 1] = order[right - 1], order[left]
            left += 1
            right -= 1
    return left if left > begin else left + 1


@njit(cache=True, error_model="numpy")
def build(agents, order, bounds, nodes, stack):  # type: ignore[no-untyped-def]
    """The kd-tree over positions; `order` is the permutation that is kept between steps."""
    nodes[0, FIRST], nodes[0, LAST] = 0, order.size
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        begin, end = nodes[node, FIRST], nodes[node, LAST]
        low_x = high_x = agents[order[begin], X]
        low_y = high_y = agents[order[begin], Y]
        for i in range(begin + 1, end):
            x, y = agents[order[i], X], agents[order[i], Y]
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        bounds[node, LOW_X], bounds[node, HIGH_X] = low_x, high_x
        bounds[node, LOW_Y], bounds[node, HIGH_Y] = low_y, high_y
        if end - begin <= LEAF:
            continue
        if high_x - low_x > high_y - low_y:
            middle = _split(agents, order, begin, end, X, HALF * (high_x + low_x))
        else:
            middle = _split(agents, order, begin, end, Y, HALF * (high_y + low_y))
        a, b = node + 1, node + 2 * (middle - begin)
        nodes[node, CHILD_A], nodes[node, CHILD_B] = a, b
        nodes[a, FIRST], nodes[a, LAST] = begin, middle
        nodes[b, FIRST], nodes[b, LAST] = middle, end
        stack[top], stack[top + 1] = b, a
        top += 2


@njit(cache=True, error_model="numpy")
def _to_box(bounds, node, x, y):  # type: ignore[no-untyped-def]
    a, b = max(ZERO, bounds[node, LOW_X] - x), max(ZERO, x - bounds[node, HIGH_X])
    c, d = max(ZERO, bounds[node, LOW_Y] - y), max(ZERO, y - bounds[node, HIGH_Y])
    return a * a + b * b + c * c + d * d


@njit(cache=True, error_model="numpy")
def near_agents(agents, me, order, bounds, nodes, stack, waiting, near, squares):  # type: ignore[no-untyped-def]
    """Fill `near` with the nearest agents in range, nearest first; returns how many."""
    x, y, most = agents[me, X], agents[me, Y], int(agents[me, NEIGHBOURS])
    reach = agents[me, RANGE] * agents[me, RANGE]
    count = 0
    if most == 0:
        return 0
    waiting[0], stack[0], top = ZERO, 0, 1  # how far away each node on the stack is, squared
    while top > 0:
        top -= 1
        node = stack[top]
        if waiting[top] >= reach:
            continue
        begin, end = nodes[node, FIRST], nodes[node, LAST]
        if end - begin > LEAF:
            a, b = nodes[node, CHILD_A], nodes[node, CHILD_B]
            to_a, to_b = _to_box(bounds, a, x, y), _to_box(bounds, b, x, y)
            if to_a < to_b:  # the nearer one is looked at first, the other with what is left
                a, b, to_a, to_b = b, a, to_b, to_a
            if to_a < reach:
                stack[top], waiting[top] = a, to_a
                top += 1
            if to_b < reach:
                stack[top], waiting[top] = b, to_b
                top += 1
            continue
        for i in range(begin, end):
            other = order[i]
            dx, dy = x - agents[other, X], y - agents[other, Y]
            square = dx * dx + dy * dy
            if other == me or square >= reach:
                continue
            if count < most:
                count += 1
            k = count - 1
            while k > 0 and square < squares[k - 1]:
                near[k], squares[k] = near[k - 1], squares[k - 1]
                k -= 1
            near[k], squares[k] = other, square
            if count == most:
                reach = squares[count - 1]
    return count


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
    count, top = 0, 0
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
                k = min(count, WALLS_MAX - 1)
                count = k + 1
                while k > 0 and square < squares[k - 1]:
                    near[k], squares[k] = near[k - 1], squares[k - 1]
                    k -= 1
                near[k], squares[k] = edge, square
        beyond = int(table[edge, RIGHT if side >= ZERO else LEFT])
        if beyond >= 0:
            stack[top] = beyond
            top += 1
    return count


@njit(cache=True, error_model="numpy")
def velocities(agents, table, root, dt, order, bounds, nodes, stack):  # type: ignore[no-untyped-def]
    """Fill NEW_VX and NEW_VY of every agent."""
    near = np.empty(WALLS_MAX, np.int64)
    squares = np.empty(WALLS_MAX, f32)
    waiting = np.empty(stack.size, f32)
    lines, spare = np.empty((2 * WALLS_MAX, 4), f32), np.empty((2 * WALLS_MAX, 4), f32)
    per_step = ONE / dt
    for me in range(agents.shape[0]):
        x, y, vx, vy = agents[me, X], agents[me, Y], agents[me, VX], agents[me, VY]
        radius, speed = agents[me, RADIUS], agents[me, SPEED_MAX]
        hard = 0
        if root >= 0:
            horizon = agents[me, WALL_HORIZON]
            reach = horizon * speed + radius
            count = near_walls(table, root, x, y, reach * reach, stack, near, squares)
            per_horizon = ONE / horizon
            for k in range(count):
                hard += beside_wall(table, near[k], x, y, vx, vy, radius, per_horizon, lines, hard)
        count = near_agents(agents, me, order, bounds, nodes, stack, waiting, near, squares)
        per_horizon = ONE / agents[me, HORIZON]
        for k in range(count):
            other = near[k]
            beside_agent(agents[other, X] - x, agents[other, Y] - y, vx, vy, agents[other, VX],
                         agents[other, VY], radius + agents[other, RADIUS], HALF, per_horizon,
                         per_step, lines, hard + k)  # fmt: skip
        agents[me, NEW_VX], agents[me, NEW_VY] = solve(
            lines, hard + count, hard, speed, agents[me, WANT_X], agents[me, WANT_Y], spare
        )


@njit(cache=True, error_model="numpy")
def fleet_step(agents, order, table, root, dt_s, move):  # type: ignore[no-untyped-def]
    """New velocities of all agents; where `move` is set, take them and move on by `dt_s` (float32).

    `agents`: (n, AGENT_COLUMNS) float32; `order`: (n,) int64, a permutation, kept between calls;
    `table`, `root`: an `ObstacleTree`, root -1 where there are no walls.
    """
    count = agents.shape[0]
    if count == 0:
        return
    bounds, nodes = np.empty((2 * count, 4), f32), np.empty((2 * count, 4), np.int64)
    # Robots in one spot make the tree a list: the deepest it can be. So can walls in a row.
    stack = np.empty(2 * max(count, table.shape[0]) + 8, np.int64)
    build(agents, order, bounds, nodes, stack)
    velocities(agents, table, root, dt_s, order, bounds, nodes, stack)
    if move:
        for me in range(count):
            agents[me, VX], agents[me, VY] = agents[me, NEW_VX], agents[me, NEW_VY]
            agents[me, X] += agents[me, VX] * dt_s
            agents[me, Y] += agents[me, VY] * dt_s


class Fleet:
    """All agents of a simulation, with the permutation that their tree keeps."""

    def __init__(self, agents: Agents, dt_s: float, walls: ObstacleTree = NO_WALLS) -> None:
        """`agents` is held, not copied: write it between steps."""
        assert agents.shape == (len(agents), AGENT_COLUMNS) and agents.dtype == np.float32
        assert np.all((agents[:, NEIGHBOURS] >= 0) & (agents[:, NEIGHBOURS] <= WALLS_MAX))
        self.agents, self.dt_s, self.walls = agents, np.float32(dt_s), walls
        self._order = np.arange(len(agents))

    def step(self, move: bool = True) -> None:
        """Choose all velocities at once, then (with `move`) drive them for one step."""
        fleet_step(self.agents, self._order, self.walls.table, self.walls.root, self.dt_s, move)
