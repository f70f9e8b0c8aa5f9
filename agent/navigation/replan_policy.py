"""When a robot plans another path, and when it does not.

A path is kept until the goal changes or something stands on it within the decision horizon for more
than `TICKS` control periods. So a box that appears and leaves again costs nothing. Neither does a
box that is still far away, because it may be gone before we are there. The path that was left is
kept for `KEPT_US`. It is taken up again without a search once the map has nothing on it. The rays
alone do not decide that: a robot that has turned round sees nothing of what stands behind it.
"""

from collections.abc import Callable
from math import hypot

from agent.interface.config import S
from agent.interface.geometry import Point
from agent.interface.observation import Observation
from agent.mapping.dynamic_obstacles import DynamicObstacles
from agent.motion.path_tracker import SAMPLE_M, PathTracker

TICKS = 2  # a path counts as blocked after more than this many control periods
KEPT_US = 5 * S  # how long the path that was left is kept
# The horizon is this time at full speed, or the braking distance plus `BEYOND_M` if that is longer.
HORIZON_S = 2.0
BEYOND_M = 1.0
GRAZE_M = 0.05  # an echo nearer to the path than the radius plus this is on the path
AGAIN_US = 2 * S  # between two searches for the same goal: there may be no way round at present
NEAR_M = 0.7  # a robot this near to its kept path may go back to it; further off it is lost


class Replanning:
    """One robot's decision to leave its path, and to return to it. Places are (x, y) metres."""

    def __init__(
        self, hazards: DynamicObstacles, speed_m_s: float, deceleration_m_s2: float
    ) -> None:
        self.hazards, self.radius_m = hazards, hazards.floor.radius_m
        self.path: Callable[[Point, Point], tuple[Point, ...] | None] = hazards.path
        self.horizon_m = max(
            speed_m_s**2 / (2 * deceleration_m_s2) + BEYOND_M, HORIZON_S * speed_m_s
        )
        self._near: list[Point] = []  # what stands near by and is neither wall nor robot
        self._ticks = 0
        self._clear = 0  # control periods in which nothing stood on the kept path
        # The path that was left, until when it is kept, and the arc length by which the obstacle on
        # it was at the latest.
        self._kept: tuple[PathTracker, int, float] | None = None
        self._allowed_at_us = 0

    def observe(self, here: Observation, tracker: PathTracker) -> None:
        """Once each control period, after `hazards.look`: what stands on the path, by our rays and
        by reports.
        """
        reach_m = self.horizon_m + self.radius_m
        self._near = self.hazards.hits + [
            (x_m, y_m)
            for x_m, y_m in self.hazards.reported()
            if hypot(x_m - here.x_m, y_m - here.y_m) < reach_m
        ]
        self._ticks = self._ticks + 1 if self._stands_on(tracker) else 0
        if self._kept is not None:
            self._clear = 0 if self._kept_is_blocked() else self._clear + 1

    def _kept_is_blocked(self) -> bool:
        """Whether an echo is on the kept path, or an obstacle of the map."""
        assert self._kept is not None
        tracker, _, beyond_m = self._kept
        if self._stands_on(tracker):
            return True
        # Its last sample may fall short.
        ahead = tracker.ahead(beyond_m + SAMPLE_M - tracker.along_m)
        return self.hazards.stands_near([(x, y) for x, y, _, _ in ahead], self.radius_m + GRAZE_M)

    def _stands_on(self, tracker: PathTracker) -> bool:
        if not self._near:
            return False
        reach_m = self.radius_m + GRAZE_M
        return any(
            hypot(x_m - hit_x_m, y_m - hit_y_m) < reach_m
            for x_m, y_m, _, _ in tracker.ahead(self.horizon_m)
            for hit_x_m, hit_y_m in self._near
        )

    @property
    def blocked(self) -> bool:
        """Whether something that is seen or reported stands on the path ahead."""
        return self._ticks > 0

    def due(self, now_us: int) -> bool:
        """Whether it is time to search for a detour."""
        return self._ticks > TICKS and now_us >= self._allowed_at_us

    def detour(
        self, at: Point, goal: Point, left: PathTracker, now_us: int
    ) -> tuple[Point, ...] | None:
        """Another path round all current obstacles; None if there is none, so wait on the old one.

        `left`: the path that we are on; it is kept for `KEPT_US`.
        """
        self._ticks, self._allowed_at_us = 0, now_us + AGAIN_US
        path = self.path(at, goal)
        if path is None:
            return None
        self._kept, self._clear = (left, now_us + KEPT_US, left.along_m + self.horizon_m), 0
        return path

    def restored(self, here: Observation, now_us: int) -> PathTracker | None:
        """The path that was left, if nothing stands on it any more; otherwise None."""
        if self._kept is None:
            return None
        tracker, end_at_us, beyond_m = self._kept
        if now_us > end_at_us:
            self._kept = None
            return None
        tracker.locate(here.x_m, here.y_m)
        beside_it = tracker.along_m + self.horizon_m / 2 > beyond_m  # then it is not seen ahead
        if self._clear <= TICKS or abs(tracker.off_m) > NEAR_M or beside_it:
            return None
        self._kept = None
        return tracker

    def forget(self) -> None:
        """There is another goal or another path: forget the old ones."""
        self._ticks, self._kept, self._allowed_at_us = 0, None, 0
