"""Shortest paths over a small grid by brute force, and an exact look at what a segment enters.

Written without the planner's tables: every segment against every blocked cell by separating axes in
integers, every pair of corners, Dijkstra.
"""

import heapq
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]
SCALE = 1 << 18  # integers a cell; points must be multiples of 2**-18 to be exact
MARGIN = 16  # 2**-14 of a cell, what the planner keeps: else lines run between two blocked cells


def entered(blocked: NDArray[np.bool_], a: Point, b: Point, margin: int) -> bool:
    """Whether a segment has a point inside a blocked cell that is larger by `margin` all round.

    What is outside of the grid is blocked.
    """
    cells = np.argwhere(np.pad(blocked, 1, constant_values=True)) - 1
    half = SCALE // 2 + margin
    y0, x0, y1, x1 = (round(v * SCALE) for v in (*a, *b))
    top, bottom = cells[:, 0] * SCALE - half, cells[:, 0] * SCALE + half
    left, right = cells[:, 1] * SCALE - half, cells[:, 1] * SCALE + half
    beside = (max(y0, y1) <= top) | (min(y0, y1) >= bottom)
    beside |= (max(x0, x1) <= left) | (min(x0, x1) >= right)
    if (y0, x0) != (y1, x1):
        sides = np.array(
            [
                (y1 - y0) * (x - x0) - (x1 - x0) * (y - y0)
                for y in (top, bottom)
                for x in (left, right)
            ]
        )
        beside |= (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
    return not bool(beside.all())


def corners(blocked: NDArray[np.bool_]) -> list[Point]:
    """Where a shortest path may bend: off the corners of blocked cells that stand out."""
    solid = np.pad(blocked, 1, constant_values=True).astype(int)
    around = solid[:-1, :-1] + solid[:-1, 1:] + solid[1:, :-1] + solid[1:, 1:]
    found = []
    for i, j in np.argwhere(around == 1).tolist():
        [[down, right]] = (np.argwhere(solid[i : i + 2, j : j + 2]) * 2 - 1).tolist()
        found.append((i - 0.5 - down * MARGIN / SCALE, j - 0.5 - right * MARGIN / SCALE))
    return found


def shortest(blocked: NDArray[np.bool_], start: Point, goal: Point) -> float:
    """Length of the shortest path; infinite where there is none."""
    nodes = [start, goal, *corners(blocked)]
    best = [inf] * len(nodes)
    best[0] = 0.0
    queue, done = [(0.0, 0)], set()
    while queue:
        g, k = heapq.heappop(queue)
        if k == 1:
            return g
        if k in done:
            continue
        done.add(k)
        for n, (y, x) in enumerate(nodes):
            through = g + hypot(y - nodes[k][0], x - nodes[k][1])
            if through < best[n] and not entered(blocked, nodes[k], nodes[n], MARGIN):
                best[n] = through
                heapq.heappush(queue, (through, n))
    return inf
