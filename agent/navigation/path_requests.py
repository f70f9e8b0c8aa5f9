"""A robot's requests to its own planner: urgent ones first, otherwise one path each control period.

A robot that is blocked, or that has a goal and no path, gets its path without delay. Paths planned
ahead wait for a control period without such a request. The path to the next goal is requested while
the robot is still `AHEAD_S` from the current one. It is used if it begins near the place where the
robot is then.
"""

from collections.abc import Callable
from math import hypot
from typing import TypeVar

from agent.interface.geometry import Point

T = TypeVar("T")
AHEAD_S = 10.0  # driving time to the goal at which the path after it is requested
NEAR_M = 0.3  # a prepared path is used if it begins this near to the robot
KEPT = 4  # number of prepared paths that are kept, the newest ones


class PathRequests:
    """The requests of one robot, and the paths planned ahead. Places are (x, y) metres."""

    def __init__(self, path: Callable[[Point, Point], tuple[Point, ...]]) -> None:
        """`path`: plans a path from a start to a goal round all current obstacles."""
        self.path = path
        self.planned = self.used = 0  # numbers of paths planned ahead, and of those that were used
        self.at_once = 0  # number of urgent searches
        self._spent = False  # an urgent search was made in this control period
        self._waiting: dict[tuple[Point, Point], None] = {}
        self._ready: dict[Point, tuple[Point, ...]] = {}  # goal: path

    def ask(self, start: Point, goal: Point) -> None:
        """Request a path ahead of time; it is planned in a later control period."""
        if goal not in self._ready:
            self._waiting.setdefault((start, goal))

    def work(self) -> None:
        """Once each control period: plan one waiting request, unless there was an urgent one."""
        spent, self._spent = self._spent, False
        if spent or not self._waiting:
            return
        request = next(iter(self._waiting))
        del self._waiting[request]
        self._ready[request[1]] = self.path(*request)
        self.planned += 1
        while len(self._ready) > KEPT:
            del self._ready[next(iter(self._ready))]

    def take(self, start: Point, goal: Point) -> tuple[Point, ...]:
        """A path from start to goal now: the one that was planned ahead, or a new one."""
        path = self._ready.pop(goal, None)
        if path is not None and hypot(path[0][0] - start[0], path[0][1] - start[1]) < NEAR_M:
            self.used += 1
            return (start, *path[1:])
        return self.urgent(self.path, start, goal)

    def urgent(self, path: Callable[[Point, Point], T], start: Point, goal: Point) -> T:
        """Plan now with `path`; requests that wait get no search in this control period."""
        self._spent = True
        self.at_once += 1
        return path(start, goal)
