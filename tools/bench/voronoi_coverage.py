"""The coverage planner of the project brief, to compare with: Voronoi, DFS with hops, reservations.

Written after `grid-coverage-planner.md`, stages A to C and their sketches. Stage C as it stands there
(`strict=False`) gives a cell to the lowest index among the robots that propose it, even if another
robot stands in it and does not leave. So robots collide. With `strict=True` no robot enters a cell
that is not being left. Then robots stop for good where two wait for each other. The judge of `sim/`
counts both.
"""

from collections import deque

import numpy as np

from agent.interface.geometry import Cell
from sim.files.coverage_plan_file import STEPS, Plan
from sim.files.grid_map import Instance, Walls

STILL_MAX = 3  # steps without any move after which a strict schedule is stuck: nothing else changes


def voronoi(walls: Walls, starts: list[Cell]) -> dict[Cell, int]:
    """Stage A: the nearest start of every reachable cell; ties to the smaller index."""
    owner = {cell: robot for robot, cell in enumerate(starts)}
    queue = deque(starts)
    while queue:
        cell = queue.popleft()
        for near in _neighbours(walls, cell):
            if near not in owner:
                owner[near] = owner[cell]
                queue.append(near)
    return owner


def _neighbours(walls: Walls, cell: Cell) -> list[Cell]:
    rows, columns = walls.shape
    near = [(cell[0] + dr, cell[1] + dc) for dr, dc in STEPS[1:]]
    return [(r, c) for r, c in near if 0 <= r < rows and 0 <= c < columns and not walls[r, c]]


def dfs_with_hops(walls: Walls, start: Cell, region: set[Cell]) -> list[Cell]:
    """Stage B: step to an unvisited neighbour, else hop to the nearest unvisited cell."""
    path, left = [start], region - {start}
    while left:
        near = next((cell for cell in _neighbours(walls, path[-1]) if cell in left), None)
        hop = [near] if near is not None else _hop(walls, path[-1], left)
        if not hop:
            break  # the rest of the region cannot be reached
        path += hop
        left -= set(hop)
    return path


def _hop(walls: Walls, start: Cell, goals: set[Cell]) -> list[Cell]:
    by: dict[Cell, Cell] = {start: start}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell in goals:
            way = [cell]
            while by[way[-1]] != start:
                way.append(by[way[-1]])
            return way[::-1]
        for near in _neighbours(walls, cell):
            if near not in by:
                by[near] = cell
                queue.append(near)
    return []


def reservations(paths: list[list[Cell]], strict: bool) -> tuple[list[list[Cell]], bool]:
    """Stage C: places step by step, and whether all reached their ends."""
    index, places = [0] * len(paths), [path[0] for path in paths]
    schedule, still = [list(places)], 0
    while any(i < len(path) - 1 for i, path in zip(index, paths, strict=True)):
        wishes = [
            path[i + 1] if i < len(path) - 1 else path[-1]
            for i, path in zip(index, paths, strict=True)
        ]
        moves = _granted(places, wishes, strict)
        for robot in moves:
            index[robot] += 1
            places[robot] = wishes[robot]
        schedule.append(list(places))
        still = 0 if moves else still + 1
        if still >= STILL_MAX:
            return schedule, False
    return schedule, True


def _granted(places: list[Cell], wishes: list[Cell], strict: bool) -> set[int]:
    """Robots that move: the lowest index that wants a cell, and only one of two that would swap."""
    winner: dict[Cell, int] = {}
    for robot, wish in enumerate(wishes):
        winner.setdefault(wish, robot)
    moves = {r for r, wish in enumerate(wishes) if winner[wish] == r and wish != places[r]}
    at = {place: robot for robot, place in enumerate(places)}
    for robot in sorted(moves):
        other = at.get(wishes[robot])
        if other in moves and wishes[other] == places[robot] and robot in moves:
            moves.discard(max(robot, other))
    while strict:  # nobody enters a cell that is not being left
        blocked = {r for r in moves if at.get(wishes[r], r) != r and at[wishes[r]] not in moves}
        if not blocked:
            break
        moves -= blocked
    return moves


def baseline(instance: Instance, strict: bool) -> tuple[Plan, bool]:
    """The whole planner as a plan for the judge; False where its schedule never ends."""
    owner = voronoi(instance.walls, instance.starts)
    regions: list[set[Cell]] = [set() for _ in instance.starts]
    for cell, robot in owner.items():
        regions[robot].add(cell)
    paths = [
        dfs_with_hops(instance.walls, start, region)
        for start, region in zip(instance.starts, regions, strict=True)
    ]
    schedule, ended = reservations(paths, strict)
    codes = {step: code for code, step in enumerate(STEPS)}
    moves = np.diff(np.array(schedule), axis=0)  # (steps, robots, 2)
    actions = [[codes[int(dr), int(dc)] for dr, dc in moves[:, r]] for r in range(len(paths))]
    return Plan(instance.walls, instance.starts, actions, ~instance.walls), ended
