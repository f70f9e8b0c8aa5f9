"""A robot's requests to its own planner: what cannot wait first, and otherwise one path a control period.

Who is blocked, or has a goal and no path, is answered at once; what is planned ahead waits for a period
in which nothing of that kind was. The next goal's path is asked for while the robot is still `AHEAD_S`
from the one under way, so that it is there when it arrives, and is used if it begins near by then.
"""

from collections.abc import Callable
from math import hypot
from typing import TypeVar

from agent.paths.route import Point

T = TypeVar("T")
AHEAD_S = 10.0
NEAR_M = 0.3
KEPT = 4  # paths planned ahead that are not used go, oldest first


class PathRequests:
    def __init__(self, path: Callable[[Point, Point], tuple[Point, ...]]) -> None:
        """`path`: what plans a way, round all that stands then."""
        self.path = path
        self.planned = self.used = 0  # ahead
        self.at_once = 0  # searches that could not wait
        self._spent = False  # this control period had one
        self._waiting: dict[tuple[Point, Point], None] = {}
        self._ready: dict[Point, tuple[Point, ...]] = {}  # goal: path

    def ask(self, start: Point, goal: Point) -> None:
        """Ahead."""
        if goal not in self._ready:
            self._waiting.setdefault((start, goal))

    def work(self) -> None:
        """Each control period: the first of those that wait."""
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
        """Now: what was planned ahead, or planned here."""
        path = self._ready.pop(goal, None)
        if path is not None and hypot(path[0][0] - start[0], path[0][1] - start[1]) < NEAR_M:
            self.used += 1
            return (start, *path[1:])
        return self.urgent(self.path, start, goal)

    def urgent(self, path: Callable[[Point, Point], T], start: Point, goal: Point) -> T:
        """Before everything that waits."""
        self._spent = True
        self.at_once += 1
        return path(start, goal)
