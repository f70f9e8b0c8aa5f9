"""A robot's requests to its own planner: one path a control period, who is blocked first.

The next goal's path is asked for while the robot is still `AHEAD_S` from the one under way, so that it
is there when it arrives. A path that was planned ahead is used if it begins near where the robot is then.
"""

from collections.abc import Callable
from enum import IntEnum
from math import hypot

from agent.route import Point

AHEAD_S = 10.0
NEAR_M = 0.3
KEPT = 4  # paths planned ahead that are not used go, oldest first


class Urgency(IntEnum):
    BLOCKED = 0
    NEXT = 1
    AHEAD = 2


class PathRequests:
    def __init__(self, path: Callable[[Point, Point], tuple[Point, ...]]) -> None:
        """`path`: what plans a way, round all that stands then."""
        self.path = path
        self.planned = self.used = 0  # ahead
        self._waiting: dict[tuple[Point, Point], Urgency] = {}
        self._ready: dict[Point, tuple[Point, ...]] = {}  # goal: path

    def ask(self, start: Point, goal: Point, urgency: Urgency) -> None:
        if goal not in self._ready:
            known = self._waiting.get((start, goal), urgency)
            self._waiting[start, goal] = min(known, urgency)

    def work(self) -> None:
        """Each control period: the most urgent one, the first of equals."""
        if not self._waiting:
            return
        request = min(self._waiting, key=lambda asked: self._waiting[asked])
        del self._waiting[request]
        self._ready[request[1]] = self.path(*request)
        self.planned += 1
        while len(self._ready) > KEPT:
            del self._ready[next(iter(self._ready))]

    def take(self, start: Point, goal: Point) -> tuple[Point, ...]:
        """Now: what was planned ahead, or planned here."""
        path = self._ready.pop(goal, None)
        if path is not None and hypot(path[0][0] - start[0], path[0][1] - start[1]) < NEAR_M:
            self.used += 1
            return (start, *path[1:])
        return self.path(start, goal)
