"""Whether a carrier makes headway with the task that it has begun; if not, it gives the task back.

A parcel aboard stays aboard, so only a task before its pickup, or the visit of a bay, is given back.
A carrier that gave one back and has not moved since takes no further tasks for a while, or it would
hold up one after the other.
"""

from math import dist
from typing import Final

from agent.claims.claim_headway import Headway
from agent.interface.config import S
from agent.interface.geometry import Point

# In one place for this long: a round of agreement may begin four times (2, 4, 8 and 16 s apart).
STANDSTILL_US: Final = 30 * S
# Under way without getting nearer for this long: at 1 m/s twice across the largest building that ships.
HEADWAY_US: Final = 120 * S
GOT_ON_M: Final = 1.0  # a carrier that has moved this far does not stand
AGAIN_US: Final = 30 * S  # until it takes tasks again without having moved; doubled each time
AGAIN_TIMES: Final = 5  # doublings at most, to 16 minutes


class TaskHeadway:
    """One carrier's headway. Only time in which it may drive counts."""

    def __init__(self) -> None:
        self._standing, self._under_way = Headway(STANDSTILL_US), Headway(HEADWAY_US)
        self._at: Point = (0.0, 0.0)  # where it was when it last got on
        self._goal: Point | None = None
        # Where it gave a task back, until when it takes no other there, and how often so far.
        self._gave: tuple[Point, int, int] | None = None

    def observe(self, at: Point, goal: Point, left_m: float, now_us: int) -> None:
        """Once each control period under way. `at`: its place. `goal`: of the task. `left_m`: of the
        path; inf in a round of agreement, whose way out of a jam may lead away from the goal.
        """
        if goal != self._goal:
            self._goal, self._at = goal, at
            self._standing.begin()
            self._under_way.begin()
        moved = dist(at, self._at) > GOT_ON_M
        if moved:
            self._at = at
        self._standing.observe(moved, 0.0, now_us)
        self._under_way.observe(False, left_m, now_us)

    def handles(self) -> None:
        """It loads, unloads or charges: that is headway."""
        self._goal = None

    @property
    def lost(self) -> str:
        """Why the task has to be given back, for the trace; empty while there is headway."""
        if self._standing.lost:
            return f"no headway: stands for {STANDSTILL_US // S} s"
        if self._under_way.lost:
            return f"no headway: gets no nearer for {HEADWAY_US // S} s"
        return ""

    def gave_back(self, at: Point, now_us: int) -> None:
        """Note where and when a task was given back, for `holds_back`."""
        times = 0 if self._gave is None or dist(at, self._gave[0]) > GOT_ON_M else self._gave[2]
        self._gave = at, now_us + (AGAIN_US << min(times, AGAIN_TIMES)), times + 1
        self._goal = None

    def holds_back(self, at: Point, now_us: int) -> bool:
        """Whether it takes no tasks: it gave one back here a short while ago."""
        return (
            self._gave is not None
            and now_us < self._gave[1]
            and dist(at, self._gave[0]) <= GOT_ON_M
        )
