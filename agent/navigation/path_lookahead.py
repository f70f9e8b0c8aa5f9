"""Plans the path from the next goal onwards before it is reached, so no robot waits for planning."""

from math import hypot

from agent.interface.geometry import Point
from agent.mapping.dynamic_obstacles import DynamicObstacles

NEAR_M = 0.1  # a robot this near to the start of the path has arrived there


class PathLookahead:
    """The one path that a robot has planned beforehand. Places are (x, y) metres."""

    def __init__(self, hazards: DynamicObstacles) -> None:
        self.hazards = hazards
        self.taken = 0  # number of prepared paths that were used
        self._ends: tuple[Point, Point] | None = None
        self._way: tuple[Point, ...] | None = None
        self._changes = 0

    def prepare(self, start: Point, goal: Point) -> None:
        """Plan the path between these two now; a second call for the same does nothing."""
        if self._ends != (start, goal):
            self._ends, self._changes = (start, goal), self.hazards.changes
            self._way = self.hazards.path(start, goal)

    def take(self, at: Point, goal: Point) -> tuple[Point, ...] | None:
        """The prepared path from here to the goal, and forget it.

        None if none was prepared for them, or if obstacles have changed since.
        """
        ends, way = self._ends, self._way
        self._ends = self._way = None
        if ends is None or way is None or self._changes != self.hazards.changes:
            return None
        if ends[1] != goal or hypot(at[0] - way[0][0], at[1] - way[0][1]) > NEAR_M:
            return None
        self.taken += 1
        return way
